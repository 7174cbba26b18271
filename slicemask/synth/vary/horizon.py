"""What closes the view beyond a place's edge: lines of trees, and hills."""

import numpy as np
from numpy.typing import NDArray

from slicemask.synth.layout.elements import Backdrop, Colour
from slicemask.synth.layout.palette import vary_colour

WOODED: tuple[Colour, ...] = ((0.22, 0.30, 0.15), (0.30, 0.34, 0.18), (0.34, 0.33, 0.22))
STEPS = 720  # around the horizon


def draw_horizon(half_extent_m: float, rng: np.random.Generator) -> tuple[Backdrop, ...]:
    """Draw the lines of trees and hills around a place, or none."""
    backdrops = []
    for near, far, height, rough, chance in (
        (2.0, 3.0, 11.0, 1.0, 0.6),  # trees
        (3.0, 5.0, 16.0, 0.6, 0.5),
        (6.0, 9.0, 90.0, 0.06, 0.4),  # hills
    ):
        if rng.random() < chance:
            radius = half_extent_m * rng.uniform(near, far)
            share = rng.uniform(0.3, 1.2)
            size = height * rng.uniform(0.4, 1.2)
            profile = tuple((size * _profile(share, rough, rng)).tolist())
            backdrops.append(Backdrop(float(radius), profile, vary_colour(rng, WOODED, 0.15)))
    return tuple(backdrops)


def _profile(share: float, rough: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Heights, about 0 to 1, around the horizon; 0 where nothing stands."""
    angle = np.arange(STEPS) / STEPS * 2 * np.pi
    waves = np.arange(1, 7)
    wide = (np.sin(angle[:, None] * waves + rng.uniform(0, 6.3, 6)) / waves**0.5).sum(axis=1) / 2.2
    fine = rng.uniform(0, 1, STEPS)
    there = np.clip(wide + 2 * share - 1, 0, 1)
    return np.asarray(there * (1 - rough / 2 + rough / 2 * fine))
