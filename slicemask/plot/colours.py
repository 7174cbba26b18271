"""Colours of slices and bands."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

INK, MUTED, FRAME, PAPER = "#17212b", "#5b6874", "#c9d0d6", "#f1f3f5"
# A wheel of hues, so that the last slice of a panorama goes over into the first.
_WHEEL = (
    "#3f74d1", "#7d5fd3", "#b954b6", "#e0527c", "#e9683f", "#f0932b",
    "#ecc02f", "#a3bf3f", "#4fae62", "#22a3a0", "#3596d3",
)  # fmt: skip
# How far the farthest band is lighter than the nearest, towards white.
_LIGHTEST = 0.6


def slice_colours(slices: int) -> Array:
    """Colours of slices 0..N-1, of which neighbours differ.

    Hues run once around a wheel, since slices run around the camera; where there are many, every
    other one is lighter.

    Parameters
    ----------
    slices : int
        N, at least 1.

    Returns
    -------
    float64 [N, 3]
        Red, green, blue in [0, 1].
    """
    from matplotlib.colors import LinearSegmentedColormap

    wheel = LinearSegmentedColormap.from_list("slices", [*_WHEEL, _WHEEL[0]])
    number = np.arange(slices)
    colours = wheel(number / slices)[:, :3]
    if slices <= 8:
        return np.asarray(colours)
    lighter = np.where(number % 2 == 1, 0.36, 0.0)
    if slices % 2 == 1:  # slice 0 is a neighbour of the last one
        lighter[-1] = 0.18
    return np.asarray(colours + lighter[:, None] * (1.0 - colours))


def band_colours(colours: Array, bands: int) -> Array:
    """Shades of slices' colours for their bands: the nearest full, farther ones lighter.

    Parameters
    ----------
    colours : float64 [N, 3]
        Of the slices.
    bands : int
        B, at least 1.

    Returns
    -------
    float64 [N, B, 3]
        Red, green, blue in [0, 1].
    """
    lighter = _LIGHTEST * np.arange(bands) / max(bands - 1, 1)
    shades = colours[:, None] + lighter[:, None] * (1.0 - colours[:, None])
    return np.asarray(shades)


def blend(masks: Array, colours: Array, opacity: float) -> Array:
    """Cells in their slices' colours: float64 [L, L, 4], colours weighted by the fractions."""
    covered = masks.sum(axis=0)
    colour = np.einsum("nij,nc->ijc", masks, colours) / np.maximum(covered, 1e-12)[..., None]
    return np.dstack([np.clip(colour, 0.0, 1.0), opacity * np.clip(covered, 0.0, 1.0)])
