"""Tiles of another size on the ground than those of training."""

import numpy as np
import pytest
from PIL import Image
from slicematch.errors import ConfigError
from slicematch.localization.localizer import Localizer
from slicematch.localization.tiles import Window, trained_window

# Of the tree's tiles.
PIXELS, METRES = 80, 0.9


@pytest.fixture
def trained(run, cache):
    """A localizer of a run that remembers its tiles' side on the ground."""
    localizer = Localizer.load(run, cache=cache, device="cpu")
    localizer.tile_side_m = PIXELS * METRES
    return localizer


@pytest.fixture
def larger(images):
    """A tile of half again the side, with the tree's in its middle."""
    picture = np.full((120, 120, 3), 90, np.uint8)
    picture[20:100, 20:100] = np.asarray(Image.open(images[1]).convert("RGB"))
    return picture


@pytest.mark.parametrize("refine", ["none", "mean", "fine"])
def test_of_a_larger_tile_the_middle_is_searched(trained, images, larger, caplog, refine):
    expected = trained.localize(*images, refine=refine, metres_per_pixel=METRES)
    assert not caplog.records
    found = trained.localize(images[0], larger, refine=refine, metres_per_pixel=METRES)
    assert "the tile is 108 m wide (120 pixels of 0.9 m)" in caplog.text
    assert "only its middle of that size is searched" in caplog.text
    np.testing.assert_array_equal(found.scores, expected.scores)
    for mode, other in zip(found.modes, expected.modes, strict=True):
        np.testing.assert_allclose(mode.pose[:2], (20 + 80 * other.pose[:2]) / 120, atol=1e-12)
        assert (mode.pose[2], mode.probability) == (other.pose[2], other.probability)
    # In metres from the centre, which the two tiles share, nothing has changed.
    assert found.offset_m(METRES) == pytest.approx(expected.offset_m(METRES))
    np.testing.assert_allclose(found.covariance(METRES), expected.covariance(METRES))
    np.testing.assert_allclose(found.grid.u, (20 + 80 * expected.grid.u) / 120)


def test_a_place_prior_is_in_the_frame_of_the_whole_tile(trained, images, larger):
    tile = trained.encode_aerial(larger, metres_per_pixel=METRES)
    prior = (28 / 120, 30 / 120, 0.05)  # about the first candidate, at (0.1, 0.125) of the middle
    found = trained.localize(images[0], tile, place_prior=prior, refine="none")
    np.testing.assert_allclose(found.pose[:2], [28 / 120, 30 / 120])
    assert np.isfinite(found.heat_map).sum() == 1


def test_a_smaller_tile_is_warned_about(trained, images, caplog):
    small = Image.open(images[1]).convert("RGB").crop((10, 10, 60, 60))
    found = trained.localize(images[0], small, metres_per_pixel=METRES)
    assert "45 m" in caplog.text
    assert "answers are less reliable" in caplog.text
    assert found.searched == 1.0


@pytest.mark.parametrize(("pixels", "metres"), [(80, 5), (80, 72), (64, 0.111), (80, 0.3)])
def test_a_tile_of_quite_another_size_is_refused(trained, images, pixels, metres):
    tile = Image.open(images[1]).convert("RGB").resize((pixels, pixels))
    with pytest.raises(ConfigError, match=r"they may differ 2 times at most: check the metres"):
        trained.localize(images[0], tile, metres_per_pixel=metres)
    known = trained.encode_aerial(tile)
    with pytest.raises(ConfigError, match=r"they may differ 2 times at most"):
        trained.localize(images[0], known, metres_per_pixel=metres)


def test_a_tile_that_is_encoded_already_is_not_cropped(trained, images, larger, caplog):
    tile = trained.encode_aerial(larger)
    assert not caplog.records
    found = trained.localize(images[0], tile, metres_per_pixel=METRES)
    assert "answers are less reliable" in caplog.text
    assert found.searched == 1.0
    told = trained.encode_aerial(larger, metres_per_pixel=METRES)
    assert trained.localize(images[0], told).metres_per_pixel == METRES


def test_small_differences_and_what_is_unknown_are_no_matter(caplog):
    for pixels in (73, 80, 87):  # VIGOR's cities differ as much
        assert trained_window(pixels, METRES, 72.0) == Window()
    assert trained_window(80, None, 72.0) == Window()
    assert trained_window(80, 55.0, None) == Window()
    assert not caplog.records
    with pytest.raises(ConfigError, match="metres per pixel is 0"):
        trained_window(80, 0, None)
