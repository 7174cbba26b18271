"""Azimuths in degrees and the directions they name, exact where they can be."""

import math
from types import ModuleType
from typing import Any


def direction(azimuth_deg: Any, xp: ModuleType) -> tuple[Any, Any]:
    """Unit vectors of azimuths, in the aerial frame.

    Parameters
    ----------
    azimuth_deg : array of any shape
        Degrees clockwise from north; any finite value.
    xp : module
        The array's own namespace (array API standard), so that torch tensors keep their gradients.

    Returns
    -------
    du, dv : arrays of the same shape
        (sin, -cos) of the azimuth: u grows to the east, v to the south. Multiples of 45 degrees
        come out exact (zeros are zeros, diagonals have equal parts), which keeps slices that run
        along the lattice free of rounding noise.
    """
    turns = xp.round(azimuth_deg / 90.0)
    rest_deg = azimuth_deg - 90.0 * turns  # in [-45, 45]
    rest = rest_deg * (math.pi / 180.0)
    diagonal = xp.abs(rest_deg) == 45.0
    sine = xp.sin(rest)
    # On a diagonal the cosine is taken as the sine of the other 45 degrees: the same number, and
    # with the right derivative.
    other = (90.0 - xp.abs(rest_deg)) * (math.pi / 180.0)
    cosine = xp.where(diagonal, xp.sin(other), xp.cos(rest))
    quadrant = turns - 4.0 * xp.floor(turns / 4.0)
    sideways = (quadrant == 1.0) | (quadrant == 3.0)
    sin_sign = xp.where(quadrant >= 2.0, -xp.ones_like(rest), xp.ones_like(rest))
    cos_sign = xp.where(
        (quadrant == 1.0) | (quadrant == 2.0), -xp.ones_like(rest), xp.ones_like(rest)
    )
    sin_azimuth = sin_sign * xp.where(sideways, cosine, sine)
    cos_azimuth = cos_sign * xp.where(sideways, sine, cosine)
    return sin_azimuth, -cos_azimuth
