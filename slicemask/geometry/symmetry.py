"""Equality of slices, and the eight symmetries of the tile.

A square tile of L x L cells looks the same after a mirroring or a quarter turn about its centre,
so the mask of a slice's image is the slice's mask with its cells permuted. To decide what is
equal, places and azimuths get whole-number codes on which the symmetries act exactly: floating
point noise is settled once, when the codes are given, and never met again.
"""

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Codes = NDArray[np.int64]

# Values closer than this are equal. It is far above the rounding of the arithmetic that makes
# them (1e-13 degrees, 1e-16 of the tile) and too small to move a fraction by 1e-9.
_SAME_DEG = 1e-11
_SAME_PLACE = 1e-13


@dataclass(frozen=True)
class Symmetry:
    """A symmetry of the tile: a transposition (u and v change places) or not, then mirrorings.

    Parameters
    ----------
    transpose, flip_u, flip_v : bool
        Whether to swap u with v, and then to mirror u and v about the tile's centre.
    """

    transpose: bool = False
    flip_u: bool = False
    flip_v: bool = False

    @property
    def inverse(self) -> "Symmetry":
        """The symmetry that undoes this one."""
        if self.transpose:
            return Symmetry(True, self.flip_v, self.flip_u)
        return self

    @property
    def azimuth_map(self) -> tuple[int, int]:
        """(sign, quarters): an azimuth a goes to sign * a + quarters * 90 degrees."""
        sign, quarters = 1, 0
        for applies, constant in ((self.transpose, 3), (self.flip_u, 0), (self.flip_v, 2)):
            if applies:  # each step mirrors: a goes to constant * 90 - a
                sign, quarters = -sign, constant - quarters
        return sign, quarters % 4

    def places(self, p: Any, q: Any) -> tuple[Any, Any]:
        """Images of places, given by their offsets p, q from the centre in u and v."""
        if self.transpose:
            p, q = q, p
        return (-p if self.flip_u else p), (-q if self.flip_v else q)

    def pose(self, pose: Array) -> Array:
        """Image of a pose: float64 [3] of u, v, heading_deg, the heading in [0, 360)."""
        p, q = self.places(pose[0] - 0.5, pose[1] - 0.5)
        return np.array([p + 0.5, q + 0.5, self.azimuth(pose[2], 90.0) % 360.0])

    def azimuth(self, azimuth: Any, quarter: Any) -> Any:
        """Images of azimuths, in any unit of which ``quarter`` make 90 degrees; not wrapped."""
        sign, quarters = self.azimuth_map
        return sign * azimuth + quarters * quarter

    def slices(self, left: Any, right: Any, quarter: Any) -> tuple[Any, Any]:
        """Images of slices' edge azimuths, in any unit of which ``quarter`` make 90 degrees.

        A mirroring swaps the edges, so that a slice still runs clockwise from left to right.
        The images are not wrapped to one turn.
        """
        if self.azimuth_map[0] < 0:
            left, right = right, left
        return self.azimuth(left, quarter), self.azimuth(right, quarter)

    def masks(self, masks: NDArray[Any]) -> NDArray[Any]:
        """Masks of the slices' images, a view: [..., L, L] with rows of v and columns of u."""
        if self.transpose:
            masks = np.swapaxes(masks, -1, -2)
        rows = slice(None, None, -1 if self.flip_v else 1)
        columns = slice(None, None, -1 if self.flip_u else 1)
        return masks[..., rows, columns]


SYMMETRIES = tuple(Symmetry(*flags) for flags in product((False, True), repeat=3))


def cluster(values: Array, tolerance: float) -> Codes:
    """Number values from 0 in ascending order; those within tolerance of a neighbour share one.

    A chain of neighbours that is longer than the tolerance is cut into parts that are not.
    """
    order = np.argsort(values)
    ascending = values[order]
    start = np.concatenate([[True], np.diff(ascending) > tolerance])
    first = np.maximum.accumulate(np.where(start, np.arange(len(values)), 0))
    part = np.floor((ascending - ascending[first]) / (2.0 * tolerance))
    start[1:] |= np.diff(part) != 0
    labels = np.empty(len(values), dtype=np.int64)
    labels[order] = np.cumsum(start) - 1
    return labels


def offset_codes(u: Array, v: Array) -> tuple[Codes, Codes, int]:
    """Code places by their offsets from the tile's centre.

    Parameters
    ----------
    u, v : float64 [P]
        Places in the aerial frame, in [0, 1].

    Returns
    -------
    p, q : int64 [P]
        Equal for equal coordinates, opposite for mirrored ones, ascending; 0 at the centre.
    edge : int
        The code of the tile's edge: places with p or q at +-edge stand on it.
    """
    centred = np.concatenate([u, v]) - 0.5
    labels = cluster(np.concatenate([[0.0, 0.5], np.abs(centred)]), _SAME_PLACE)
    codes = np.where(centred < 0.0, -labels[2:], labels[2:])
    return codes[: len(u)], codes[len(u) :], int(labels[1])


def azimuth_codes(azimuth_deg: Array) -> tuple[Codes, int]:
    """Code azimuths on a circle of 4 * quarter whole numbers.

    Parameters
    ----------
    azimuth_deg : float64, any shape
        Degrees, any finite values.

    Returns
    -------
    codes : int64, the same shape
        In [0, 4 * quarter): equal for equal azimuths, ascending; a quarter turn adds ``quarter``
        and a mirroring changes the sign, modulo the circle.
    quarter : int
        The code of 90 degrees.
    """
    turns = np.floor(azimuth_deg / 90.0)
    rest = azimuth_deg - 90.0 * turns
    beyond = rest > 45.0
    folded = np.where(beyond, 90.0 - rest, rest)
    labels = cluster(np.concatenate([[0.0, 45.0], folded.ravel()]), _SAME_DEG)
    quarter = 2 * int(labels[1])
    label = labels[2:].reshape(folded.shape)
    codes = turns.astype(np.int64) * quarter + np.where(beyond, quarter - label, label)
    return codes % (4 * quarter), quarter


def same_azimuth(first_deg: Any, second_deg: Any) -> Any:
    """Whether two angles are equal, rounding apart; 0 and 360 are not."""
    return np.abs(first_deg - second_deg) <= _SAME_DEG


def offsets_equal(values: Array) -> Codes:
    """Number distances from the tile's centre so that equal ones share a number, int64."""
    return cluster(values, _SAME_PLACE)
