"""Recoloured samples: other colours, the same picture."""

import numpy as np
import torch
from slicematch.data.augmentation import recolour
from slicematch.normalisation import IMAGENET_MEAN, IMAGENET_STD

MEAN, STD = (torch.tensor(values)[:, None, None] for values in (IMAGENET_MEAN, IMAGENET_STD))


def paint(colour):
    """A normalised image [3, 4, 6] of one colour."""
    return ((torch.tensor(colour)[:, None, None] - MEAN) / STD).expand(3, 4, 6)


def recoloured(ground, aerial, seed):
    images = recolour(paint(ground), paint(aerial), np.random.default_rng(seed))
    return [image * STD + MEAN for image in images]


def hue_of(image):
    red, green, blue = image[:, 0, 0].double().numpy()
    return np.arctan2(np.sqrt(3) * (green - blue), 2 * red - green - blue)


def test_colours_depend_on_the_random_numbers_alone():
    first, again, other = (recoloured((0.7, 0.3, 0.2), (0.2, 0.6, 0.3), seed) for seed in (0, 0, 1))
    for k in (0, 1):
        assert torch.equal(first[k], again[k])
        assert (first[k] - other[k]).abs().max() > 0.02


def test_both_images_turn_around_the_colour_circle_together():
    turns = []
    for seed in range(50):
        ground, aerial = recoloured((0.6, 0.3, 0.2), (0.6, 0.3, 0.2), seed)
        apart = np.angle(np.exp(1j * (hue_of(ground) - hue_of(aerial))))
        assert abs(np.degrees(apart)) < 30
        before = hue_of(torch.tensor((0.6, 0.3, 0.2))[:, None, None])
        turns.append(np.degrees(np.angle(np.exp(1j * (hue_of(ground) - before)))))
    assert np.min(turns) < -30
    assert np.max(turns) > 30


def test_grey_stays_grey_and_nothing_leaves_the_range_of_pixels():
    for seed in range(20):
        grey, bright = recoloured((0.5, 0.5, 0.5), (1.0, 1.0, 0.9), seed)
        assert grey.std(dim=0).max() < 1e-5
        assert (bright.min() >= -1e-6) & (bright.max() <= 1 + 1e-6)
