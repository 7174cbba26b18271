"""Which slices of a set of poses are equal, and which are images of others.

Three facts settle it, whatever the poses are:

- Slices of one place are equal if their edge azimuths are.
- A slice whose outline does not turn at the camera says nothing about where the camera stands:
  it is *empty* (all outside the tile), *full* (the whole tile) or a *half-plane* cut off by a
  straight line, and may equal slices of other places. These are the `Loose` ones.
- Any other slice shows its camera as a corner, so it can only equal slices of the same place,
  or be the image of slices of the place's seven mirror images and turns.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slicemask.geometry.azimuths import direction
from slicemask.geometry.frustum import Frustum
from slicemask.geometry.symmetry import (
    SYMMETRIES,
    azimuth_codes,
    offset_codes,
    offsets_equal,
    same_azimuth,
)

Array = NDArray[np.float64]
Codes = NDArray[np.int64]


class Shape(IntEnum):
    """What a slice is within the tile."""

    WEDGE = 0
    EMPTY = 1
    FULL = 2
    HALF = 3


@dataclass(frozen=True)
class Images:
    """Slices as images of sectors: slice s is symmetry ``symmetry[s]`` of sector ``sector[s]``.

    Parameters
    ----------
    u, v, left_deg, right_deg : float64 [R]
        The sectors whose masks are to be computed. One of no width is empty, one of 360 degrees
        full.
    sector : int64 [S]
        Which of them each slice is an image of, ascending.
    symmetry : int64 [S]
        Index into `slicemask.geometry.symmetry.SYMMETRIES`.
    """

    u: Array
    v: Array
    left_deg: Array
    right_deg: Array
    sector: Codes
    symmetry: Codes


@dataclass(frozen=True)
class Loose:
    """Slices that no place is tied to.

    Parameters
    ----------
    shape : int64 [T]
        EMPTY, FULL or HALF.
    left_deg : float64 [T]
        HALF: the half-plane runs clockwise from this azimuth to the one opposite.
    offset : float64 [T]
        HALF: signed distance of the tile's centre from the line, positive inside.
    """

    shape: Codes
    left_deg: Array
    offset: Array

    @classmethod
    def joined(cls, parts: "list[Loose]") -> "Loose":
        """Return those of several sets, one after another."""
        return cls(
            np.concatenate([part.shape for part in parts]),
            np.concatenate([part.left_deg for part in parts]),
            np.concatenate([part.offset for part in parts]),
        )


@dataclass(frozen=True)
class Distinct:
    """The distinct slices of some poses.

    Parameters
    ----------
    wedges : Images
        The distinct slices tied to a place.
    loose : Loose
        The distinct other slices of each place.
    slice_of : int64 [n, N]
        Slice n of each pose: an index into the wedges, or -1 - an index into the loose ones.
    """

    wedges: Images
    loose: Loose
    slice_of: Codes


def distinct_slices(
    u: Array, v: Array, place: Codes, heading_deg: Array, frustum: Frustum
) -> Distinct:
    """Find the distinct slices of poses.

    Parameters
    ----------
    u, v : float64 [P]
        Distinct places, in the aerial frame.
    place, heading_deg : int64 [n], float64 [n]
        The poses: each the index of its place, and its heading.
    frustum : Frustum
        Field of view and slices.
    """
    # Equal slices of one place.
    headings, heading = np.unique(heading_deg, return_inverse=True)
    edges = frustum.edges_deg(headings)
    codes, quarter = azimuth_codes(edges)
    keys = codes[:, :-1] * (4 * quarter) + codes[:, 1:]
    kinds, first, kind = np.unique(keys.ravel(), return_index=True, return_inverse=True)
    kind = kind.reshape(keys.shape)
    pairs, slice_of = _unique(place[:, None] * len(kinds) + kind[heading], len(u) * len(kinds))
    at, kind = np.divmod(pairs, len(kinds))
    left, right = np.divmod(kinds, 4 * quarter)
    left_deg, right_deg = edges[:, :-1].ravel()[first], edges[:, 1:].ravel()[first]

    # Those tied to a place, and the others.
    p, q, edge = offset_codes(u, v)
    shape, half_deg = _shapes(
        p[at], q[at], edge, left[kind], right[kind], quarter, left_deg[kind], right_deg[kind]
    )
    tied = shape == Shape.WEDGE
    wedges, rank = _images(
        (u[at[tied]], v[at[tied]], left_deg[kind[tied]], right_deg[kind[tied]]),
        (p[at[tied]], q[at[tied]], left[kind[tied]], right[kind[tied]]),
        quarter,
    )
    free = ~tied
    du, dv = direction(half_deg[free], np)
    offset = du * (0.5 - v[at[free]]) - dv * (0.5 - u[at[free]])
    loose = Loose(shape[free], half_deg[free], np.where(shape[free] == Shape.HALF, offset, 0.0))
    number = -np.cumsum(free)
    number[tied] = rank
    return Distinct(wedges, loose, number[slice_of].reshape(len(place), frustum.slices))


def distinct_loose(loose: Loose) -> tuple[Images, Codes]:
    """Find the distinct ones of loose slices, across all places.

    Returns
    -------
    images : Images
        The distinct slices; a half-plane's camera is the foot of the perpendicular from the
        tile's centre to its line, which may lie a little outside the tile.
    row : int64 [T]
        Which of them each loose slice is.
    """
    codes, quarter = azimuth_codes(np.where(loose.shape == Shape.HALF, loose.left_deg, 0.0))
    distance = offsets_equal(loose.offset)
    _, first, row = np.unique(
        np.stack([loose.shape, distance, codes]), axis=1, return_index=True, return_inverse=True
    )
    shape, left_deg, offset = loose.shape[first], loose.left_deg[first], loose.offset[first]
    width = np.select([shape == Shape.HALF, shape == Shape.FULL], [180.0, 360.0], 0.0)
    left_deg = np.where(shape == Shape.HALF, left_deg, 0.0)
    du, dv = direction(left_deg, np)
    u, v = 0.5 + offset * dv, 0.5 - offset * du
    # A symmetry keeps a line's distance from the centre, so the distance stands for the place.
    place = distance[first] * len(Shape) + shape
    still = np.zeros_like(place)
    left = codes[first]
    right = (left + np.where(shape == Shape.HALF, 2 * quarter, 0)) % (4 * quarter)
    images, rank = _images(
        (u, v, left_deg, left_deg + width), (still, still, left, right), quarter, place
    )
    return images, rank[row.ravel()]


def _shapes(
    p: Codes,
    q: Codes,
    edge: int,
    left: Codes,
    right: Codes,
    quarter: int,
    left_deg: Array,
    right_deg: Array,
) -> tuple[Codes, Array]:
    """The shape of each slice within the tile, and the left azimuth of those that are HALF."""
    turn = 4 * quarter
    width_deg = right_deg - left_deg
    whole, none = same_azimuth(width_deg, 360.0), same_azimuth(width_deg, 0.0)
    width = np.where(whole, turn, np.where(none, 0, (right - left) % turn))
    straight = same_azimuth(width_deg, 180.0)

    # From the tile's edge only a half turn is in view, from a corner a quarter: [start, start +
    # view]. Inside, everything is.
    west, east, north, south = p == -edge, p == edge, q == -edge, q == edge
    view = np.select([(west | east) & (north | south), west | east | north | south],
                     [quarter, 2 * quarter], turn)  # fmt: skip
    start = np.select(
        [north & west, north & east, south & east, south & west, north, east, south, west],
        [quarter, 2 * quarter, 3 * quarter, 0, quarter, 2 * quarter, 3 * quarter, 0],
        left,
    )
    begin = (left - start) % turn
    end = begin + width
    seen = np.minimum(end, view) - begin  # of the view after the left edge
    around = np.minimum(end - turn, view)  # of the view before it, seen by a slice that wraps
    at_edge = view < turn
    two = at_edge & (seen > 0) & (around > 0)
    nothing = none | (at_edge & (seen <= 0) & (around <= 0))
    # The stretch in view, where it is one: from `low` to `high`.
    low = np.where(seen > 0, begin, 0)
    high = np.where(seen > 0, np.minimum(end, view), around)
    everything = whole | (at_edge & ~two & (low == 0) & (high == view))
    half = straight | (at_edge & ~two & ((low == 0) ^ (high == view)))
    half_deg = np.where(at_edge & ~two & (low == 0), right_deg - 180.0, left_deg)
    shape = np.select(
        [nothing, everything, half], [Shape.EMPTY, Shape.FULL, Shape.HALF], Shape.WEDGE
    )
    return shape.astype(np.int64), half_deg


def _images(
    sectors: tuple[Array, Array, Array, Array],
    codes: tuple[Codes, Codes, Codes, Codes],
    quarter: int,
    place: Any = 0,
) -> tuple[Images, Codes]:
    """Bring slices under the eight symmetries together; give also each slice's number among them.

    Of a slice's eight images, the one with the smallest codes stands for all of them. ``sectors``
    are u, v, left_deg, right_deg [S] and ``codes`` p, q, left, right [S]; ``place`` [S] parts
    slices further, by what no symmetry changes.
    """
    u, v, left_deg, right_deg = sectors
    p, q, left, right = codes
    if len(u) == 0:
        none = np.zeros(0, dtype=np.int64)
        return Images(u, v, left_deg, right_deg, none, none), none
    turn = 4 * quarter
    span = 2 * int(max(np.abs(p).max(), np.abs(q).max())) + 1
    best_place = best_edges = np.full(len(u), np.iinfo(np.int64).max)
    best = np.zeros(len(u), dtype=np.int64)
    for number, symmetry in enumerate(SYMMETRIES):
        image_p, image_q = symmetry.places(p, q)
        image_left, image_right = symmetry.slices(left, right, quarter)
        image_place = image_p * span + image_q
        image_edges = image_left % turn * turn + image_right % turn
        smaller = (image_place < best_place) | (
            (image_place == best_place) & (image_edges < best_edges)
        )
        best_place = np.where(smaller, image_place, best_place)
        best_edges = np.where(smaller, image_edges, best_edges)
        best[smaller] = number
    keys = np.broadcast_to(place, len(u)), best_place, best_edges
    order = np.lexsort(keys[::-1])
    fresh = np.ones(len(order), dtype=bool)  # where slices of another sector begin
    fresh[1:] = np.logical_or.reduce([np.diff(key[order]) != 0 for key in keys])
    first = order[fresh]
    chosen = [np.empty(len(first)) for _ in sectors]
    for number, symmetry in enumerate(SYMMETRIES):
        some = best[first] == number
        one = first[some]
        image_u, image_v = symmetry.places(u[one] - 0.5, v[one] - 0.5)
        image_left, image_right = symmetry.slices(left_deg[one], right_deg[one], 90.0)
        images = image_u + 0.5, image_v + 0.5, image_left, image_right
        for target, image in zip(chosen, images, strict=True):
            target[some] = image
    inverse = np.array([SYMMETRIES.index(symmetry.inverse) for symmetry in SYMMETRIES])
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    u, v, left_deg, right_deg = chosen
    return Images(u, v, left_deg, right_deg, np.cumsum(fresh) - 1, inverse[best][order]), rank


def _unique(keys: Codes, size: int) -> tuple[Codes, Codes]:
    """`np.unique` with its inverse, for keys in 0..size - 1."""
    if size > 4 * keys.size:
        values, inverse = np.unique(keys, return_inverse=True)
        return values, inverse
    # The keys are dense, as those of a grid are: a table is several times faster than sorting.
    present = np.zeros(size, dtype=bool)
    present[keys] = True
    return np.flatnonzero(present), (np.cumsum(present) - 1)[keys]
