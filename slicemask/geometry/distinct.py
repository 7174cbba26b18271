"""Which slices of a set of poses are equal, and which are images of others.

Three facts settle it, whatever the poses are:

- Slices of one place are equal if their edge azimuths are.
- A slice whose outline does not turn at the camera says nothing about where the camera stands:
  it is *empty* (all outside the tile), *full* (the whole tile) or a *half-plane* cut off by a
  straight line, and may equal slices of other places. These are unanchored.
- Any other slice shows its camera as a corner, so it can only equal slices of the same place,
  or be the image of slices of the place's seven mirror images and turns. It is anchored.

Bands of range anchor every slice but the empty ones, since ranges are measured from the camera.
They are equal if their slices are; bands beyond the tile are empty, and all empty masks are equal.
"""

from dataclasses import dataclass, replace
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

# Ranges closer than this are equal: a band that thin has no share of a cell.
_SAME_RANGE = 1e-12


class Shape(IntEnum):
    """What a slice is within the tile."""

    WEDGE = 0
    EMPTY = 1
    FULL = 2
    HALF = 3


@dataclass(frozen=True)
class SectorOrbit:
    """Slices as images of sectors: slice s is symmetry ``symmetry[s]`` of sector ``sector[s]``.

    Parameters
    ----------
    u, v, left_deg, right_deg, heading_deg : float64 [R]
        The sectors whose masks are to be computed. One of no width is empty, one of 360 degrees
        full. The heading is that along which a pinhole's bands are measured.
    in_tile : bool [R, B]
        Which of their bands are on the tile at all: a row of the bank each.
    sector : int64 [S]
        Which of them each slice is an image of, ascending.
    symmetry : int64 [S]
        Index into `slicemask.geometry.symmetry.SYMMETRIES`.
    """

    u: Array
    v: Array
    left_deg: Array
    right_deg: Array
    heading_deg: Array
    in_tile: NDArray[np.bool_]
    sector: Codes
    symmetry: Codes

    @property
    def rows(self) -> int:
        """How many masks there are, of all bands on the tile of all slices."""
        return int(np.count_nonzero(self.in_tile[self.sector]))


@dataclass(frozen=True)
class UnanchoredSlices:
    """Slices that are equal wherever their cameras stand.

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
    def joined(cls, parts: "list[UnanchoredSlices]") -> "UnanchoredSlices":
        """Return those of several sets, one after another."""
        return cls(
            np.concatenate([part.shape for part in parts]),
            np.concatenate([part.left_deg for part in parts]),
            np.concatenate([part.offset for part in parts]),
        )


@dataclass(frozen=True)
class Distinct:
    """The distinct masks of some poses.

    Parameters
    ----------
    anchored : SectorOrbit
        The distinct slices that show where their camera stands.
    unanchored : UnanchoredSlices
        The distinct other slices of each place; with bands also one that is empty, for the bands
        beyond the tile.
    mask_of : int64 [n, N * B]
        Each mask of each pose: the number of a row of the anchored slices, which has those of a
        slice's bands on the tile in order, or -1 - an index into the unanchored ones.
    """

    anchored: SectorOrbit
    unanchored: UnanchoredSlices
    mask_of: Codes


def distinct_slices(
    u: Array, v: Array, place: Codes, heading_deg: Array, frustum: Frustum
) -> Distinct:
    """Find the distinct masks of poses.

    Parameters
    ----------
    u, v : float64 [P]
        Distinct places, in the aerial frame.
    place, heading_deg : int64 [n], float64 [n]
        The poses: each the index of its place, and its heading.
    frustum : Frustum
        Field of view, slices and bands.
    """
    # Equal slices of one place. Those of a pinhole that are banded along other headings differ:
    # where edges are equal, that is where the slices' numbers do.
    numbers = frustum.slices if frustum.bands and frustum.projection == "pinhole" else 1
    headings, heading = np.unique(heading_deg, return_inverse=True)
    edges = frustum.edges_deg(headings)
    codes, quarter = azimuth_codes(edges)
    keys = (codes[:, :-1] * (4 * quarter) + codes[:, 1:]) * numbers
    if numbers > 1:
        keys += np.arange(numbers)
    kinds, first, kind = np.unique(keys.ravel(), return_index=True, return_inverse=True)
    kind = kind.reshape(keys.shape)
    pairs, slice_of = _unique(place[:, None] * len(kinds) + kind[heading], len(u) * len(kinds))
    at, kind = np.divmod(pairs, len(kinds))
    left, right = np.divmod(kinds // numbers, 4 * quarter)
    left_deg, right_deg = edges[:, :-1].ravel()[first], edges[:, 1:].ravel()[first]

    # Those anchored to a place, and the others.
    p, q, edge = offset_codes(u, v)
    view = _View.of(
        p[at], q[at], edge, left[kind], right[kind], quarter, left_deg[kind], right_deg[kind]
    )
    shape, half_deg = view.shapes()
    slices = _Slices(
        (u[at], v[at], left_deg[kind], right_deg[kind], headings[first // frustum.slices][kind]),
        (p[at], q[at], left[kind], right[kind], kinds[kind] % numbers),
        quarter,
    )
    anchors = shape == Shape.WEDGE
    if frustum.bands:
        slices, whole, row = _canonical(slices, view, at, frustum)
        shape, half_deg, slice_of = shape[whole.first], half_deg[whole.first], row[slice_of]
        # A slice that ends within its first band is a slice without bands.
        anchors = np.where(whole.within_first, shape == Shape.WEDGE, shape != Shape.EMPTY)
    mirrored = _mirrored_numbers(frustum) if numbers > 1 else None
    orbit, rank = _orbits(slices.of(anchors), mirrored=mirrored)
    free = ~anchors
    du, dv = direction(half_deg[free], np)
    offset = du * (0.5 - slices.sectors[1][free]) - dv * (0.5 - slices.sectors[0][free])
    unanchored = UnanchoredSlices(
        shape[free], half_deg[free], np.where(shape[free] == Shape.HALF, offset, 0.0)
    )
    mask_of = -np.cumsum(free)
    mask_of[anchors] = rank
    if not frustum.bands:
        mask_of = mask_of[slice_of].reshape(len(place), frustum.slices)
        return Distinct(orbit, unanchored, mask_of)
    return _with_bands(orbit, unanchored, mask_of, slice_of, frustum)


@dataclass(frozen=True)
class _Slices:
    """Slices by their numbers: u, v, left_deg, right_deg, heading_deg [S], and as codes.

    The codes are those of p, q, left and right, and what separates slices further: a number that
    mirrorings count from the other end, or -1.
    """

    sectors: tuple[Array, ...]
    codes: tuple[Codes, ...]
    quarter: int

    def of(self, some: Any) -> "_Slices":
        """Some of them."""
        return _Slices(
            tuple(values[some] for values in self.sectors),
            tuple(values[some] for values in self.codes),
            self.quarter,
        )


@dataclass(frozen=True)
class _Whole:
    """Of slices: a number of each among those it was found in, and whether band 0 is all of it."""

    first: Codes
    within_first: NDArray[np.bool_]


def _canonical(
    slices: _Slices, view: "_View", at: Codes, frustum: Frustum
) -> tuple[_Slices, _Whole, Codes]:
    """Banded slices, those that are equal within the tile made one; and which each of them became.

    Edges out of view do not matter, nor does the heading of a slice that its first band holds.
    """
    within_first = farthest_ranges(slices.sectors, frustum) <= frustum.bands[0] + _SAME_RANGE
    sectors, codes = slices.sectors, slices.codes
    if frustum.projection == "equirectangular":
        edges_deg, edges = view.clipped()
        sectors, codes = (*sectors[:2], *edges_deg, sectors[4]), (*codes[:2], *edges, codes[4])
    codes = (*codes[:4], np.where(within_first, -1, codes[4]))
    keys = np.stack([at, *codes[2:], within_first])
    _, first, row = np.unique(keys, axis=1, return_index=True, return_inverse=True)
    kept = _Slices(sectors, codes, slices.quarter).of(first)
    return kept, _Whole(first, within_first[first]), row.ravel()


def _with_bands(
    orbit: SectorOrbit, unanchored: UnanchoredSlices, mask_of: Codes, slice_of: Codes,
    frustum: Frustum,
) -> Distinct:  # fmt: skip
    """The distinct masks of banded slices, given each slice's number among the slices."""
    orbit = replace(orbit, in_tile=_bands_in_tile(orbit, frustum))
    in_tile = orbit.in_tile[orbit.sector]  # of each slice
    # Empty slices have had their numbers; one more stands for the bands beyond the tile.
    empty = len(unanchored.shape)
    row = np.where(in_tile, np.cumsum(in_tile).reshape(in_tile.shape) - 1, -1 - empty)
    bands = np.full((len(mask_of), frustum.band_count), -1 - empty)
    bands[:, 0] = mask_of
    anchored = mask_of >= 0
    bands[anchored] = row[mask_of[anchored]]
    beyond = UnanchoredSlices(np.array([int(Shape.EMPTY)]), np.zeros(1), np.zeros(1))
    return Distinct(
        orbit,
        UnanchoredSlices.joined([unanchored, beyond]),
        bands[slice_of].reshape(-1, frustum.slices * frustum.band_count),
    )


def _bands_in_tile(orbit: SectorOrbit, frustum: Frustum) -> NDArray[np.bool_]:
    """Which bands of sectors are on the tile: those that begin nearer than the farthest point."""
    sectors = orbit.u, orbit.v, orbit.left_deg, orbit.right_deg, orbit.heading_deg
    starts = np.array([-1.0, *frustum.bands])
    return np.asarray(farthest_ranges(sectors, frustum)[:, None] > starts + _SAME_RANGE)


def farthest_ranges(sectors: tuple[Array, ...], frustum: Frustum) -> Array:
    """The farthest range of sectors on the tile: float64 [S], in shares of its side.

    Sectors are u, v, left_deg, right_deg, heading_deg [S]; range is measured as the frustum's bands
    are.
    """
    u, v, left_deg, right_deg, heading_deg = sectors
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    x, y = (corners[:, axis] - at[:, None] for axis, at in ((0, u), (1, v)))
    after_left = (np.degrees(np.arctan2(x, -y)) - left_deg[:, None] + 1e-9) % 360.0
    seen = after_left <= (right_deg - left_deg)[:, None] + 2e-9
    points = [(np.where(seen, x, 0.0), np.where(seen, y, 0.0))]
    for azimuth_deg in (left_deg, right_deg):
        du, dv = direction(azimuth_deg, np)
        # Where the ray leaves the tile.
        length = np.minimum(_exit(u, du), _exit(v, dv))
        points.append(((length * du)[:, None], (length * dv)[:, None]))
    x, y = (np.concatenate([point[axis] for point in points], axis=1) for axis in (0, 1))
    if frustum.projection == "pinhole":
        hu, hv = (part[:, None] for part in direction(heading_deg, np))
        return np.asarray((x * hu + y * hv).max(axis=1))
    return np.asarray(np.hypot(x, y).max(axis=1))


def _exit(at: Array, step: Array) -> Array:
    """How far a ray goes along one axis, by its step a unit, until it leaves [0, 1]."""
    room = np.where(step > 0.0, 1.0 - at, at)
    ahead = np.abs(step) > 1e-15
    return np.where(ahead, room / np.where(ahead, np.abs(step), 1.0), 2.0)


def distinct_unanchored(slices: UnanchoredSlices) -> tuple[SectorOrbit, Codes]:
    """Find the distinct ones of unanchored slices, across all places.

    Returns
    -------
    orbit : SectorOrbit
        The distinct slices; a half-plane's camera is the foot of the perpendicular from the
        tile's centre to its line, which may lie a little outside the tile.
    row : int64 [T]
        Which of them each slice is.
    """
    codes, quarter = azimuth_codes(np.where(slices.shape == Shape.HALF, slices.left_deg, 0.0))
    distance = offsets_equal(slices.offset)
    _, first, row = np.unique(
        np.stack([slices.shape, distance, codes]), axis=1, return_index=True, return_inverse=True
    )
    shape, left_deg, offset = slices.shape[first], slices.left_deg[first], slices.offset[first]
    width = np.select([shape == Shape.HALF, shape == Shape.FULL], [180.0, 360.0], 0.0)
    left_deg = np.where(shape == Shape.HALF, left_deg, 0.0)
    du, dv = direction(left_deg, np)
    u, v = 0.5 + offset * dv, 0.5 - offset * du
    # A symmetry keeps a line's distance from the centre, so the distance stands for the place.
    place = distance[first] * len(Shape) + shape
    still = np.zeros_like(place)
    left = codes[first]
    right = (left + np.where(shape == Shape.HALF, 2 * quarter, 0)) % (4 * quarter)
    sectors = _Slices(
        (u, v, left_deg, left_deg + width, left_deg), (still, still, left, right, still), quarter
    )
    orbit, rank = _orbits(sectors, place)
    return orbit, rank[row.ravel()]


@dataclass(frozen=True)
class _View:
    """Slices as seen within the tile.

    From the tile's edge half a turn is in view, from a corner a quarter, from inside everything.

    Azimuths are codes of the circle, ``full_circle`` in all. The view begins at ``start`` and is
    ``view`` wide; the slice begins ``begin`` after that and is ``width`` wide.
    """

    left: Codes
    left_deg: Array
    right_deg: Array
    full_circle: int
    start: Codes
    view: Codes
    begin: Codes
    width: Codes
    straight: NDArray[np.bool_]

    @classmethod
    def of(
        cls, p: Codes, q: Codes, edge: int, left: Codes, right: Codes, quarter: int,
        left_deg: Array, right_deg: Array,
    ) -> "_View":  # fmt: skip
        """The views of slices from places p, q (see `offset_codes`), given by their edges."""
        full_circle = 4 * quarter
        width_deg = right_deg - left_deg
        whole, none = same_azimuth(width_deg, 360.0), same_azimuth(width_deg, 0.0)
        width = np.where(whole, full_circle, np.where(none, 0, (right - left) % full_circle))
        west, east, north, south = p == -edge, p == edge, q == -edge, q == edge
        view = np.select([(west | east) & (north | south), west | east | north | south],
                         [quarter, 2 * quarter], full_circle)  # fmt: skip
        start = np.select(
            [north & west, north & east, south & east, south & west, north, east, south, west],
            [quarter, 2 * quarter, 3 * quarter, 0, quarter, 2 * quarter, 3 * quarter, 0],
            left,
        )
        straight = same_azimuth(width_deg, 180.0)
        return cls(
            left,
            left_deg,
            right_deg,
            full_circle,
            start,
            view,
            (left - start) % full_circle,
            width,
            straight,
        )

    def _stretch(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_], Codes, Codes]:
        """Whether nothing is in view, or two stretches; from and to where it is one."""
        end = self.begin + self.width
        seen = np.minimum(end, self.view) - self.begin  # of the view after the left edge
        around = np.minimum(end - self.full_circle, self.view)  # before it, if it wraps
        at_edge = self.view < self.full_circle
        two = at_edge & (seen > 0) & (around > 0)
        nothing = (self.width == 0) | (at_edge & (seen <= 0) & (around <= 0))
        low = np.where(seen > 0, self.begin, 0)
        high = np.where(seen > 0, np.minimum(end, self.view), around)
        return nothing, two, low, high

    def shapes(self) -> tuple[Codes, Array]:
        """The shape of each slice, and the left azimuth of those that are HALF."""
        nothing, two, low, high = self._stretch()
        one = (self.view < self.full_circle) & ~two
        everything = (self.width == self.full_circle) | (one & (low == 0) & (high == self.view))
        half = self.straight | (one & ((low == 0) ^ (high == self.view)))
        half_deg = np.where(one & (low == 0), self.right_deg - 180.0, self.left_deg)
        shape = np.select(
            [nothing, everything, half], [Shape.EMPTY, Shape.FULL, Shape.HALF], Shape.WEDGE
        )
        return shape.astype(np.int64), half_deg

    def clipped(self) -> tuple[tuple[Array, Array], tuple[Codes, Codes]]:
        """Left and right edges, in degrees and as codes, moved in where they are out of view.

        So slices that are equal within the tile have equal edges. A whole circle begins at 0.
        """
        _, two, low, high = self._stretch()
        at_edge, circle = self.view < self.full_circle, self.width == self.full_circle
        one = at_edge & ~two
        from_start, to_end = one & (low == 0), one & (high == self.view)
        from_start, to_end = from_start | (at_edge & circle), to_end | (at_edge & circle)
        end = self.start + self.view
        left_deg = np.where(from_start, self.start * (360.0 / self.full_circle), self.left_deg)
        right_deg = np.where(to_end, end * (360.0 / self.full_circle), self.right_deg)
        # Where one edge was moved it may be a turn away from the other.
        turned_deg = left_deg + (right_deg - left_deg) % 360.0
        right_deg = np.where(from_start | to_end, turned_deg, right_deg)
        left = np.where(from_start, self.start, self.left) % self.full_circle
        right = np.where(to_end, end, self.left + self.width) % self.full_circle
        whole = ~at_edge & circle
        return (
            (np.where(whole, 0.0, left_deg), np.where(whole, 360.0, right_deg)),
            (np.where(whole, 0, left), np.where(whole, 0, right)),
        )


def _mirrored_numbers(frustum: Frustum) -> Codes:
    """The number of each slice's mirror image about the heading, int64 [N].

    It is that of the slice that has the image's edges or, around a principal point off the centre,
    where none need have them, one from N up.
    """
    offsets = frustum.edge_offsets_deg()
    mirrored = -offsets[::-1]
    numbers = np.arange(frustum.slices)
    image = frustum.slices - 1 - numbers  # which of the mirrored slices each one's image is
    at = np.searchsorted(offsets[1:], mirrored[image] + 1e-9)
    at = np.minimum(at, frustum.slices - 1)
    equal = same_azimuth(offsets[at], mirrored[image])
    equal &= same_azimuth(offsets[at + 1], mirrored[image + 1])
    return np.where(equal, at, frustum.slices + numbers)


def _orbits(
    slices: _Slices, place: Any = 0, mirrored: Codes | None = None
) -> tuple[SectorOrbit, Codes]:
    """Bring slices under the eight symmetries together; give also each slice's number among them.

    Of a slice's eight images, the one with the smallest codes stands for all of them. ``place`` [S]
    separates slices further, by what no symmetry changes. The slices' own numbers become those
    ``mirrored`` [N] where a symmetry mirrors them.
    """
    u, v, left_deg, right_deg, heading_deg = slices.sectors
    p, q, left, right, number = slices.codes
    quarter = slices.quarter
    none = np.zeros(0, dtype=np.int64)
    if len(u) == 0:
        nothing = np.zeros((0, 1), dtype=bool)
        return SectorOrbit(u, v, left_deg, right_deg, heading_deg, nothing, none, none), none
    full_circle = 4 * quarter
    span = 2 * int(max(np.abs(p).max(), np.abs(q).max())) + 1
    best_place = best_edges = np.full(len(u), np.iinfo(np.int64).max)
    best = np.zeros(len(u), dtype=np.int64)
    mirrored = np.zeros(1, dtype=np.int64) if mirrored is None else mirrored
    numbers = int(mirrored.max()) + 1
    mirrored_number = np.where(number < 0, number, mirrored[number])
    for one, symmetry in enumerate(SYMMETRIES):
        image_p, image_q = symmetry.places(p, q)
        image_left, image_right = symmetry.slices(left, right, quarter)
        image_number = number if symmetry.azimuth_map[0] > 0 else mirrored_number
        image_place = image_p * span + image_q
        image_edges = image_left % full_circle * full_circle + image_right % full_circle
        image_edges = image_edges * (numbers + 1) + image_number
        smaller = (image_place < best_place) | (
            (image_place == best_place) & (image_edges < best_edges)
        )
        best_place = np.where(smaller, image_place, best_place)
        best_edges = np.where(smaller, image_edges, best_edges)
        best[smaller] = one
    keys = np.broadcast_to(place, len(u)), best_place, best_edges
    order = np.lexsort(keys[::-1])
    fresh = np.ones(len(order), dtype=bool)  # where slices of another sector begin
    fresh[1:] = np.logical_or.reduce([np.diff(key[order]) != 0 for key in keys])
    first = order[fresh]
    chosen = [np.empty(len(first)) for _ in slices.sectors]
    for one, symmetry in enumerate(SYMMETRIES):
        some = best[first] == one
        s = first[some]
        image_u, image_v = symmetry.places(u[s] - 0.5, v[s] - 0.5)
        image_edges_deg = symmetry.slices(left_deg[s], right_deg[s], 90.0)
        image_heading = symmetry.azimuth(heading_deg[s], 90.0)
        images = image_u + 0.5, image_v + 0.5, *image_edges_deg, image_heading
        for target, image in zip(chosen, images, strict=True):
            target[some] = image
    inverse = np.array([SYMMETRIES.index(symmetry.inverse) for symmetry in SYMMETRIES])
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    u, v, left_deg, right_deg, heading_deg = chosen
    in_tile = np.ones((len(first), 1), dtype=bool)
    sector, symmetry_of = np.cumsum(fresh) - 1, inverse[best][order]
    return (
        SectorOrbit(u, v, left_deg, right_deg, heading_deg, in_tile, sector, symmetry_of),
        rank,
    )


def _unique(keys: Codes, size: int) -> tuple[Codes, Codes]:
    """`np.unique` with its inverse, for keys in 0..size - 1."""
    if size > 4 * keys.size:
        values, inverse = np.unique(keys, return_inverse=True)
        return values, inverse
    # The keys are dense, as those of a grid are: a table is several times faster than sorting.
    present = np.zeros(size, dtype=bool)
    present[keys] = True
    return np.flatnonzero(present), (np.cumsum(present) - 1)[keys]
