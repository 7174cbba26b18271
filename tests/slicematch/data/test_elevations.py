"""Ground images cut to a part of their elevations."""

import numpy as np
import pytest
from PIL import Image
from slicematch.data.elevations import (
    check_elevations,
    crop_elevations,
    frame_ground,
    image_elevations,
)
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
def test_settings_for_what_the_images_do_not_show_are_refused(elevations):
    with pytest.raises(DatasetError, match="shows -45 to 45: choose a part of them"):
        check_elevations(elevations, "pinhole", 90.0, 1.0)


def test_rows_that_an_image_does_not_show_are_black():
    image = Image.fromarray(np.full((100, 100), 200, np.uint8))
    # 45 degrees are 50 rows, 63.43 degrees 100.
    cropped = np.asarray(crop_elevations(image, (-45.0, 63.43494882), "pinhole", 90.0))
    assert cropped[:, 0].tolist() == [0] * 50 + [200] * 100
    cropped = np.asarray(crop_elevations(image, (-63.43494882, 0.0), "pinhole", 90.0))
    assert cropped[:, 0].tolist() == [200] * 50 + [0] * 50


def test_the_horizon_is_where_the_principal_point_is():
    assert image_elevations("pinhole", 90.0, 1.0, None, 0.25) == pytest.approx(
        (-56.30993247, 26.56505118)
    )
    # Of a camera that sees 0 to 45 degrees across, the image is one focal length wide and high.
    low, high = image_elevations("pinhole", 45.0, 1.0, 0.0, 0.5)
    assert (low, high) == pytest.approx((-26.56505118, 26.56505118))
    cropped = crop_elevations(rows_of(200, 200), (0.0, 26.56505118), "pinhole", 90.0, None, 0.25)
    assert np.asarray(cropped)[:, 0].tolist() == list(range(50))


@pytest.mark.parametrize(("height", "rows"), [(100, list(range(25, 75))), (30, None)])
def test_images_of_other_proportions_are_cut_about_the_horizon(height, rows):
    framed = np.asarray(frame_ground(rows_of(height, 100), 2.0, "crop", None, 90.0))
    assert framed.shape == (50, 100)
    expected = rows or [0] * 10 + list(range(30)) + [0] * 10
    assert framed[:, 0].tolist() == expected


def test_images_of_other_proportions_are_resized_if_the_settings_say_so():
    framed = np.asarray(frame_ground(rows_of(100, 100), 2.0, "resize", None, 90.0))
    assert framed.shape == (50, 100)
    assert framed[[0, -1], 0].tolist() == pytest.approx([0.5, 98.5], abs=1.5)
    # Elevations are then those of an image of the expected proportions.
    half = np.asarray(frame_ground(rows_of(100, 100), 2.0, "resize", (-26.56505118, 0.0), 90.0))
    assert half.shape == (25, 100)


def test_elevations_of_kitti():
    low, high = image_elevations("pinhole", 81.5, 1242 / 375)
    assert (low, high) == pytest.approx((-14.59, 14.59), abs=0.01)
