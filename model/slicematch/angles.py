"""Angles on the circle of headings."""

from typing import TYPE_CHECKING, TypeVar

import numpy as np

if TYPE_CHECKING:
    from torch import Tensor

Angles = TypeVar("Angles", np.ndarray, "Tensor")


def angle_difference_deg(headings: Angles, origin: Angles | float) -> Angles:
    """Headings minus the origin, clockwise, the short way round.

    Parameters
    ----------
    headings : float array or tensor
        Degrees clockwise from north, of any range.
    origin : the same, or a number
        Degrees, likewise.

    Returns
    -------
    difference_deg : array or tensor
        Degrees in [-180, 180).

    Examples
    --------
    >>> angle_difference_deg(np.array([350.0, 20.0]), 10.0)
    array([-20.,  10.])
    """
    return (headings - origin + 180.0) % 360.0 - 180.0
