"""Patterns that textures are made of: noise and stripes, averaged over a pixel's width."""

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float32]


def as_float32(values: ArrayLike) -> Floats:
    """An array of float32, in which all shading is done."""
    return np.asarray(values, dtype=np.float32)


@cache
def _lattice() -> Floats:
    return np.random.default_rng(20230101).uniform(-1, 1, (256, 256)).astype(np.float32)


def noise(x: Floats, y: Floats, wavelength_m: float, footprint_m: Floats) -> Floats:
    """Smooth noise in [-1, 1] of a wavelength; it fades where pixels are wider than that."""
    table = _lattice()
    x, y = x / wavelength_m, y / wavelength_m
    column, row = np.floor(x), np.floor(y)
    fx, fy = x - column, y - row
    i, j = row.astype(np.int32) & 255, column.astype(np.int32) & 255
    i1, j1 = (i + 1) & 255, (j + 1) & 255
    fx, fy = fx * fx * (3 - 2 * fx), fy * fy * (3 - 2 * fy)
    a, b = table[i, j], table[i1, j]
    top = a + (table[i, j1] - a) * fx
    bottom = b + (table[i1, j1] - b) * fx
    fade = np.clip(1.5 - footprint_m / wavelength_m, 0, 1)
    return as_float32((top + (bottom - top) * fy) * fade)


def pulse(x: Floats, period: Floats | float, duty: Floats | float, width: Floats) -> Floats:
    """Fraction of [x - width/2, x + width/2] in stripes that fill [0, duty) of each period."""
    half = np.maximum(width / period, 1e-3) / 2

    def filled(y: Floats) -> Floats:
        whole = np.floor(y)
        return as_float32(whole * duty + np.minimum(y - whole, duty))

    x = as_float32(x / period)
    return as_float32((filled(as_float32(x + half)) - filled(as_float32(x - half))) / (2 * half))
