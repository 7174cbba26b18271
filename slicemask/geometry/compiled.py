"""The closed form in compiled loops: what `slicemask.geometry.rays` computes, but faster.

numba compiles them when they are first called, and keeps the result (the extra ``compiled``). The
formulas and their names are those of `slicemask.geometry.rays` and `slicemask.geometry.ranges`,
which explain them. Loops do what whole arrays cannot: they keep to the rows and columns that a
slice reaches, and work out once what the slices of a pose share.
"""

import math
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

from slicemask.geometry.azimuths import direction
from slicemask.geometry.frustum import Frustum

# These are compiled in, and numba notices changes of this file alone: who changes them there has to
# touch it.
from slicemask.geometry.noise import NEGLIGIBLE
from slicemask.geometry.ranges import BEYOND, FAR, PARALLEL
from slicemask.geometry.rays import WIDEST_DEG

Array = NDArray[np.float64]

# What is this near to a lattice line, in cells, counts as lying on either side of it.
_HAIR = 1e-6
_RIGHT_ANGLE = math.pi / 2
# What is computed before an interrupt is noticed, a tenth of a second or so.
_VALUES_AT_ONCE, _SLICES_AT_ONCE = 1 << 25, 1 << 17
# The rows from the first to before the last, and the columns.
Vector = tuple[float, float]
Block = tuple[tuple[int, int], tuple[int, int]]
P = ParamSpec("P")
R = TypeVar("R")


def takes(frustum: Frustum) -> bool:
    """Whether these loops can do it: a slice of 180 degrees may cut a lattice line twice."""
    return bool(np.diff(frustum.edge_offsets_deg()).max() < WIDEST_DEG)


def write_masks(poses: Array, frustum: Frustum, masks: Array) -> None:
    """Write the slice masks of poses, clean of rounding noise.

    Parameters
    ----------
    poses : float64 [K, 3]
        As `slicemask.slice_masks` takes them, and has checked them.
    frustum : Frustum
        One that `takes` allows.
    masks : float64 [K, N, B, L, L]
        Where they are written to; B is 1 without bands.
    """
    ranges = np.array([range_ for range_ in frustum.bands if range_ < BEYOND])
    depths = frustum.projection == "pinhole"
    step = max(1, min(_VALUES_AT_ONCE // masks[0].size, _SLICES_AT_ONCE // frustum.slices))
    for start in range(0, len(poses), step):
        # Arrays of another kind, such as those that are read-only, would be compiled for again.
        some = np.array(poses[start : start + step], order="C")
        edges_deg = frustum.edges_deg(some[:, 2])
        du, dv = direction(np.concatenate([edges_deg, some[:, 2:]], axis=1), np)
        _write(some, edges_deg, du, dv, ranges, depths, masks[start : start + step])


def _compiled(function: Callable[P, R]) -> Callable[P, R]:
    # Divides as NumPy does, and lets other threads run.
    loops: Callable[P, R] = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    return loops


@_compiled
def _write(
    poses: Array, edges_deg: Array, du: Array, dv: Array, ranges: Array, depths: bool, masks: Array
) -> None:
    """Write the masks of poses.

    The slices' edges are given as azimuths [K, N + 1] and as directions [K, N + 2], of which the
    last is the heading.
    """
    slices, cells = masks.shape[1], masks.shape[3]
    # Of lines: the horizontal ones, then the vertical ones.
    shape = (2, cells + 1)
    offsets, factors, g = np.empty(shape), np.empty(shape), np.empty(shape)
    lattice = np.empty(cells + 1)
    for i in range(cells + 1):
        lattice[i] = i / cells
    ray_meetings = np.empty((slices + 1, 2, cells + 1))
    meetings, bounds = (
        np.empty((len(ranges), 2, cells + 1)),
        np.empty((len(ranges), 2, 2, cells + 1)),
    )
    # The lows and the highs of a slice's intervals.
    cuts, within = np.empty((2, 2, cells + 1)), np.empty((2, 2, cells + 1))
    outlines = np.empty((3, 3, cells + 1))
    near, far = np.zeros((cells, cells)), np.zeros((cells, cells))
    for k in range(len(poses)):
        u, v, heading = poses[k, 0], poses[k, 1], (du[k, -1], dv[k, -1])
        for i in range(cells + 1):
            offsets[0, i], offsets[1, i] = lattice[i] - v, lattice[i] - u
            factors[0, i] = offsets[0, i] * (cells * cells / 2)
            factors[1, i] = offsets[1, i] * (cells * cells / 2)
        for n in range(slices + 1):
            _meet_ray(u, du[k, n], dv[k, n], offsets[0], ray_meetings[n, 0])
            _meet_ray(v, dv[k, n], du[k, n], offsets[1], ray_meetings[n, 1])
        for band in range(len(ranges)):
            if depths:
                _meet_plane(ranges[band], offsets, heading, meetings[band], bounds[band])
            else:
                _meet_circle(ranges[band], offsets, meetings[band], bounds[band])
        for n in range(slices):
            left, right = (du[k, n], dv[k, n]), (du[k, n + 1], dv[k, n + 1])
            ours, next_ = ray_meetings[n], ray_meetings[n + 1]
            _intervals(offsets[0], left[1], right[1], ours[0], next_[0], cuts[:, 0])
            _intervals(offsets[1], right[0], left[0], next_[1], ours[1], cuts[:, 1])
            block = _reached(v, cuts[:, 0]), _reached(u, cuts[:, 1])
            mask = masks[k, n]
            mask[:] = 0.0
            # A band is what lies within its far range, less what lies within its near one.
            nearest = (0, 0), (0, 0)
            for band in range(len(ranges)):
                range_, some = ranges[band], block
                if not depths:
                    some = _around(v, range_, cells, block[0]), _around(u, range_, cells, block[1])
                _cut(cuts[:, 0], bounds[band, :, 0], u, some[0], within[:, 0])
                _cut(cuts[:, 1], bounds[band, :, 1], v, some[1], within[:, 1])
                factor = cells * cells * range_ / 2
                if depths:
                    count = _plane_outline(
                        range_, heading, left, right, meetings[band], factor, some, outlines
                    )
                else:
                    count = _circle_outlines(
                        edges_deg[k, n], edges_deg[k, n + 1], meetings[band], factor * range_,
                        some, outlines,
                    )  # fmt: skip
                _areas(lattice, factors, within, outlines[:count], some, g, near, far, mask[band])
                _empty(near, nearest)
                near, far, nearest = far, near, some
            last = mask[len(ranges)]
            _areas(lattice, factors, cuts, outlines[:0], block, g, near, far, last)
            _empty(near, nearest)
            _empty(far, block)


@_compiled
def _empty(share: Array, block: Block) -> None:
    for i in range(block[0][0], block[0][1]):
        for j in range(block[1][0], block[1][1]):
            share[i, j] = 0.0


@_compiled
def _clip(value: float, low: float, high: float) -> float:
    value = value if value > low else low
    return value if value < high else high


@_compiled
def _meet_ray(origin: float, along: float, across: float, offsets: Array, at: Array) -> None:
    """Where a ray, given by its parts along and across the lines, meets them."""
    # Nothing asks for it where they are parallel.
    slope = 0.0 if abs(across) < PARALLEL else along / across
    for i in range(len(offsets)):
        at[i] = _clip(origin + offsets[i] * slope, 0.0, 1.0)


@_compiled
def _intervals(
    offsets: Array, left: float, right: float, left_at: Array, right_at: Array, cut: Array
) -> None:
    """Where lines lie in a slice, given its edges' parts across the lines: lows and highs."""
    left_ahead, left_behind = left <= -PARALLEL, left >= PARALLEL
    right_ahead, right_behind = right <= -PARALLEL, right >= PARALLEL
    open_ahead, open_behind = 1.0 if left_ahead else 0.0, 0.0 if left_behind else 1.0
    for i in range(len(offsets)):
        if offsets[i] < 0.0:
            cut[0, i] = left_at[i] if left_ahead else 0.0
            cut[1, i] = right_at[i] if right_ahead else open_ahead
        else:
            cut[0, i] = right_at[i] if right_behind else open_behind
            cut[1, i] = left_at[i] if left_behind else 1.0


@_compiled
def _reached(camera: float, cut: Array) -> tuple[int, int]:
    """The first row, or column, that a slice reaches, and the one after the last."""
    cells = cut.shape[1] - 1
    first = math.floor(camera * cells - _HAIR)
    last = math.floor(camera * cells + _HAIR) + 1
    for i in range(cells + 1):
        if cut[0, i] < cut[1, i]:
            first, last = min(first, i - 1), max(last, i + 1)
    return max(first, 0), min(last, cells)


@_compiled
def _around(camera: float, range_: float, cells: int, reached: tuple[int, int]) -> tuple[int, int]:
    """Those of the rows, or columns, that a circle around the camera reaches."""
    first = math.floor((camera - range_) * cells - _HAIR)
    last = math.floor((camera + range_) * cells + _HAIR) + 1
    first, last = max(first, reached[0]), min(last, reached[1])
    return first, max(first, last)


@_compiled
def _cut(cuts: Array, bounds: Array, origin: float, some: tuple[int, int], within: Array) -> None:
    """The intervals of some cells' lines within a range."""
    for i in range(some[0], some[1] + 1):
        low, high = origin + bounds[0, i], origin + bounds[1, i]
        within[0, i], within[1, i] = _clip(cuts[0, i], low, high), _clip(cuts[1, i], low, high)


@_compiled
def _meet_circle(range_: float, offsets: Array, met: Array, bounds: Array) -> None:
    """Where lines meet a circle around the camera: the azimuths, and the stretches within it."""
    for axis in range(2):
        for i in range(offsets.shape[1]):
            offset = offsets[axis, i]
            square = (range_ - offset) * (range_ + offset)
            chord = math.sqrt(square) if square > 0.0 else 0.0
            bounds[0, axis, i], bounds[1, axis, i] = -chord, chord
            met[axis, i] = math.atan2(chord, -offset) if axis == 0 else math.atan2(offset, chord)


@_compiled
def _circle_outlines(
    left_deg: float, right_deg: float, met: Array, factor: float,
    some: Block, outlines: Array,
) -> int:  # fmt: skip
    """A slice's arc, in its quadrants; how many there are."""
    first, count = math.floor(left_deg / 90.0), 0
    for part in range(3):
        start_deg = 90.0 * (first + part)
        start = _clip(left_deg - start_deg, 0.0, 90.0) * (math.pi / 180.0)
        stop = _clip(right_deg - start_deg, 0.0, 90.0) * (math.pi / 180.0)
        if start >= stop:
            continue
        quadrant = int(first + part) % 4
        east, north, even = quadrant < 2, quadrant in (0, 3), quadrant in (0, 2)
        if even:
            row_start, column_start = 0.0 if east else math.pi, 0.0
        else:
            row_start, column_start = -_RIGHT_ANGLE if east else _RIGHT_ANGLE, _RIGHT_ANGLE
        row_sign, column_sign = 1.0 if east else -1.0, 1.0 if north else -1.0
        outline = outlines[count]
        for i in range(some[0][0], some[0][1] + 1):
            row = _clip(row_start + row_sign * met[0, i], start, stop) * factor
            outline[1, i] = start * factor if even else row
            outline[2, i] = row if even else stop * factor
        for j in range(some[1][0], some[1][1] + 1):
            outline[0, j] = _clip(column_start + column_sign * met[1, j], start, stop) * factor
        count += 1
    return count


@_compiled
def _meet_plane(range_: float, offsets: Array, heading: Vector, met: Array, bounds: Array) -> None:
    """Where lines meet a depth line: how far along it, and the stretches within the depth."""
    for axis in range(2):
        h_along, h_across = heading[axis], heading[1 - axis]
        # The depth line runs along (-h_v, h_u).
        w_along, w_across = (-h_across, h_along) if axis == 0 else (h_across, -h_along)
        for i in range(offsets.shape[1]):
            ahead = offsets[axis, i] - range_ * h_across
            if abs(w_across) < PARALLEL:
                inside = ahead < 0.0 if h_across > 0.0 else ahead >= 0.0
                met[axis, i] = FAR if ahead >= 0.0 else -FAR
                bounds[0, axis, i], bounds[1, axis, i] = -FAR if inside else FAR, FAR
                continue
            met[axis, i] = ahead / w_across
            at = _clip(range_ * h_along + met[axis, i] * w_along, -FAR, FAR)
            bounds[0, axis, i] = -FAR if h_along > 0.0 else at
            bounds[1, axis, i] = at if h_along > 0.0 else FAR


@_compiled
def _plane_outline(
    range_: float, heading: Vector, left: Vector, right: Vector, met: Array, scale: float,
    some: Block, outlines: Array,
) -> int:  # fmt: skip
    """A slice's piece of the depth line; there is one."""
    hx, hy = heading[0], heading[1]
    wx, wy = -hy, hx
    start = range_ * (left[0] * wx + left[1] * wy) / (left[0] * hx + left[1] * hy)
    stop = range_ * (right[0] * wx + right[1] * wy) / (right[0] * hx + right[1] * hy)
    even = (wx > -PARALLEL) == (wy > -PARALLEL)
    outline = outlines[0]
    for i in range(some[0][0], some[0][1] + 1):
        row = _clip(met[0, i], start, stop) * scale
        outline[1, i] = start * scale if even else row
        outline[2, i] = row if even else stop * scale
    for j in range(some[1][0], some[1][1] + 1):
        outline[0, j] = _clip(met[1, j], start, stop) * scale
    return 1


@_compiled
def _areas(
    lattice: Array, factors: Array, cuts: Array, outlines: Array,
    some: Block, g: Array, near: Array, far: Array, mask: Array,
) -> None:  # fmt: skip
    """Write some cells' shares within a range to ``far``, and less nearer ones to ``mask``.

    They are mixed differences of G, of which two horizontal lines are kept. A mask is cleaned of
    rounding noise.
    """
    (row_0, row_1), (first, last) = some
    if row_0 >= row_1 or first >= last:
        return
    size = last - first
    along, column_factors = lattice[first : last + 1], factors[1, first : last + 1]
    lows, highs = cuts[0, 1, first : last + 1], cuts[1, 1, first : last + 1]
    before, now = g[0, : size + 1], g[1, : size + 1]
    for i in range(row_0, row_1 + 1):
        factor, low, high, at = factors[0, i], cuts[0, 0, i], cuts[1, 0, i], lattice[i]
        for j in range(size + 1):
            now[j] = factor * _clip(along[j], low, high)
        for j in range(size + 1):
            now[j] += column_factors[j] * _clip(at, lows[j], highs[j])
        for outline in range(len(outlines)):
            fluxes = outlines[outline, 0, first : last + 1]
            low, high = outlines[outline, 1, i], outlines[outline, 2, i]
            for j in range(size + 1):
                now[j] += _clip(fluxes[j], low, high)
        if i > row_0:
            shares, nearer = far[i - 1, first:last], near[i - 1, first:last]
            written = mask[i - 1, first:last]
            for j in range(size):
                shares[j] = (now[j + 1] - before[j + 1]) - (now[j] - before[j])
            for j in range(size):
                share = shares[j] - nearer[j]
                share = share if share >= NEGLIGIBLE else 0.0
                written[j] = share if share <= 1.0 - NEGLIGIBLE else 1.0
        before, now = now, before
