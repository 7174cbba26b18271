"""Ground images cut to a part of their elevations."""

import numpy as np
import pytest
from PIL import Image
from slicematch.data.elevations import crop_elevations, image_elevations
from slicematch.data.errors import DatasetError


def rows_of(height, width):
    """An image whose pixels hold the number of their row."""
    return Image.fromarray(np.repeat(np.arange(height, dtype=np.uint8)[:, None], width, axis=1))


@pytest.mark.parametrize(
    ("elevations", "first", "last"),
    [((-45, 45), 45, 134), ((-90, 0), 90, 179), ((-90, 90), 0, 179)],
)
def test_rows_of_a_panorama_are_its_degrees(elevations, first, last):
    cropped = crop_elevations(rows_of(180, 360), elevations, "equirectangular", 360.0)
    pixels = np.asarray(cropped)
    assert pixels.shape == (last - first + 1, 360)
    assert pixels[:, 0].tolist() == list(range(first, last + 1))


def test_rows_of_a_pinhole_image_are_tangents_about_the_horizon():
    # 90 degrees high as it is wide; 26.565 degrees are half of 45 in tangents.
    cropped = crop_elevations(rows_of(200, 200), (-26.56505118, 45.0), "pinhole", 90.0)
    assert np.asarray(cropped)[:, 0].tolist() == list(range(150))


def test_nothing_is_cut_without_elevations():
    image = rows_of(10, 20)
    assert crop_elevations(image, None, "equirectangular", 360.0) is image


def test_edges_between_two_rows_are_resampled():
    cropped = crop_elevations(rows_of(90, 180), (-45.0, 45.0), "equirectangular", 360.0)
    assert np.asarray(cropped)[:, 0].tolist() == pytest.approx(np.arange(22.5, 67.5), abs=1.0)


@pytest.mark.parametrize("elevations", [(-50.0, 0.0), (0.0, 47.0)])
def test_what_the_image_does_not_show_is_refused(elevations):
    with pytest.raises(DatasetError, match="shows -45 to 45: choose a part of them"):
        crop_elevations(rows_of(100, 100), elevations, "pinhole", 90.0)


def test_elevations_of_kitti():
    low, high = image_elevations("pinhole", 81.5, 1242 / 375)
    assert (low, high) == pytest.approx((-14.59, 14.59), abs=0.01)
