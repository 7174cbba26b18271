"""Panoramas: whole spheres, turned to a heading."""

import numpy as np
import pytest
from PIL import Image
from slicematch.data.panoramas import turn_panorama


def marked_panorama(width, azimuth_deg):
    """A grey panorama, north at the centre, brightest at an azimuth and fading to both sides."""
    azimuth = np.radians(360 * ((np.arange(width) + 0.5) / width - 0.5) - azimuth_deg)
    row = 127 + 127 * np.cos(azimuth)
    return Image.fromarray(
        np.rint(row * np.ones((width // 2, 1)))[..., None].repeat(3, 2).astype("u1")
    )


def brightest_azimuth_deg(image):
    """Where the one wave along the columns peaks, clockwise from the centre of the image."""
    rows = np.asarray(image, dtype=float)[..., 0]
    width = rows.shape[1]
    angle = 2 * np.pi * ((np.arange(width) + 0.5) / width - 0.5)
    return np.degrees(np.angle((rows.mean(axis=0) * np.exp(1j * angle)).sum()))


@pytest.mark.parametrize(("azimuth_deg", "column"), [(-90, 0.25), (0, 0.5), (90, 0.75)])
def test_west_north_and_east_of_a_panorama(azimuth_deg, column):
    row = np.asarray(marked_panorama(512, azimuth_deg))[0, :, 0]
    assert abs(int(row.argmax()) - 512 * column) <= 8  # the peak is flat for some columns


@pytest.mark.parametrize("width", [2048, 640, 514])
@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 360 * 700 / 2048, 200.3, 359.9])
def test_turning_brings_the_heading_to_the_centre(width, heading_deg):
    turned = turn_panorama(marked_panorama(width, heading_deg), heading_deg, (32, 64))
    assert turned.size == (64, 32)
    # A tenth of a column of 640; eight bits a pixel allow no finer reading.
    assert brightest_azimuth_deg(turned) == pytest.approx(0, abs=0.056)


def test_whole_columns_are_rolled_left_and_nothing_else(paint_texture):
    pixels = paint_texture(np.random.default_rng(1), 256)[:128]
    column = 75
    turned = turn_panorama(Image.fromarray(pixels), 360 * column / 256, (128, 256))
    assert np.array_equal(np.asarray(turned), np.roll(pixels, -column, axis=1))


def test_both_edges_of_a_turned_panorama_wrap_round(paint_texture):
    image = Image.fromarray(paint_texture(np.random.default_rng(2), 512)[:256])
    straight = np.asarray(turn_panorama(image, 0.0, (64, 128)), dtype=int)
    half = np.asarray(turn_panorama(image, 180.0, (64, 128)), dtype=int)
    assert np.abs(np.roll(half, 64, axis=1) - straight).max() <= 1
