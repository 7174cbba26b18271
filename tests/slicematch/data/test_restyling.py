"""Restyled images: another look, the same picture."""

import numpy as np
import pytest
import torch
from slicematch.data.images import normalise
from slicematch.data.restyling import restyle

MEAN, STD = (0.5, 0.5, 0.5), (0.5, 0.5, 0.5)


def stripes(height=64, width=128):
    """A picture of edges."""
    pixels = np.zeros((height, width, 3), np.uint8)
    pixels[:, ::16] = pixels[:, 1::16] = pixels[:, 2::16] = (200, 180, 90)
    pixels[height // 2 :, :, 1] += 40
    return normalise(pixels, MEAN, STD)


def test_the_style_depends_on_the_random_numbers_alone():
    image = stripes()
    before = image.clone()
    first, again, other = (
        restyle(image, np.random.default_rng(seed), MEAN, STD) for seed in (0, 0, 1)
    )
    assert torch.equal(first, again)
    assert (first - other).abs().max() > 0.05
    assert torch.equal(image, before)


@pytest.mark.parametrize("size", [(64, 128), (33, 17), (8, 8), (256, 256)])
def test_pixels_stay_finite_in_their_range_and_size(size):
    image = stripes(*size)
    for seed in range(60):
        found = restyle(image, np.random.default_rng(seed), MEAN, STD)
        assert found.shape == image.shape
        assert found.dtype == torch.float32
        assert found.isfinite().all()
        assert found.min() >= -1 - 1e-6
        assert found.max() <= 1 + 1e-6


def test_most_of_the_picture_stays_where_it_is():
    """Edges are where they were: columns of light differ from those between them."""
    image = stripes()
    light = torch.zeros(128, dtype=torch.bool)
    light[1::16] = True
    dark = torch.zeros(128, dtype=torch.bool)
    dark[9::16] = True
    kept = []
    for seed in range(100):
        found = restyle(image, np.random.default_rng(seed), MEAN, STD).mean(dim=(0, 1))
        apart = (found[light].mean() - found[dark].mean()).abs()
        kept.append(apart > 3 * found[dark].std() / 8**0.5)
    assert np.mean(kept) > 0.9


def test_a_plain_picture_gives_no_trouble():
    flat = torch.full((3, 32, 48), -1.0)
    for seed in range(60):
        assert restyle(flat, np.random.default_rng(seed), MEAN, STD).isfinite().all()
