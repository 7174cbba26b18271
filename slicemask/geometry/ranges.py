"""Where bands of range end: at circles around the camera, or at planes of constant depth.

A band is what a slice has up to its far range, less what it has up to its near one. The closed form
(`slicemask.geometry.rays`) needs two things of a slice that ends at a range r: which stretch of
each lattice line lies within r, and how much of the flux of F = (x, y) / 2 leaves each cell through
the outline at r. F's flux through an arc of radius r is r^2 / 2 times its angle, and through a
piece of a line at distance r from the camera r / 2 times its length.

Along an outline that runs in one sense in both axes (a quarter of a circle, or a line), let a point
at parameter t lie above the horizontal line i while t is on one side of a_i, and left of the
vertical line j while it is on one side of b_j. Then the stretch of it within cell (i, j) is, up to
its sign, the mixed difference of min(a_i, b_j): `Outline` holds a and b.
"""

import math
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from slicemask.geometry.azimuths import direction

# Beyond the tile as seen from any place on it: farther ranges cut nothing off.
BEYOND = 1.5
# Beyond every lattice line, as seen from any camera.
FAR = 4.0
_RADIANS = math.pi / 180.0
# Moves a share by less than 1e-12.
_HAIR = 1e-15
PARALLEL = 1e-30


def clip_between(values: Any, low: Any, high: Any, xp: ModuleType) -> Any:
    """Clip to arrays of bounds; where low = high, gradients are those of the bounds.

    torch's own clamp, which takes half the time, gives none there: see `kept_apart`.
    """
    return xp.minimum(xp.maximum(values, low), high)


def kept_apart(low: Any, high: Any, xp: ModuleType) -> Any:
    """``high``, a hair above ``low`` where they are equal, so that clamps have gradients there.

    NumPy has none, and keeps what is exact.
    """
    if xp is np:
        return high
    return xp.maximum(high, low + _HAIR)


@dataclass(frozen=True)
class Outline:
    """A part of a range's outline, as what it adds to G (see `slicemask.geometry.rays`).

    That is ``clip(along[b, j], low[b, i], high[b, i])``, of which the mixed difference is the flux
    through the outline, over the area of a cell.

    Parameters
    ----------
    along, low, high : arrays [B, L + 1]
        For the vertical lines, and for the horizontal ones.
    """

    along: Any
    low: Any
    high: Any


@dataclass(frozen=True)
class Cut:
    """What a range leaves of the lattice lines of B cameras.

    Parameters
    ----------
    low, high : arrays [2 * B, L + 1]
        The stretch within the range of the horizontal lines (along x), then of the vertical ones
        (along y), relative to the camera; low = high where nothing of a line is.
    outlines : list of Outline
        The parts of the outline.
    """

    low: Any
    high: Any
    outlines: list[Outline]


def cut_by_circle(
    range_: float, y: Any, x: Any, left_deg: Any, right_deg: Any, widest_deg: float, scale: float,
    xp: ModuleType,
) -> Cut:  # fmt: skip
    """Cut sectors off at the distance ``range_`` from the camera.

    Parameters
    ----------
    range_ : float
        Radius of the circle, in shares of the tile's side.
    y, x : arrays [B, L + 1]
        Offsets of the horizontal and of the vertical lattice lines from the cameras.
    left_deg, right_deg : arrays [B]
        The sectors' edges.
    widest_deg : float
        No sector is wider than this.
    scale : float
        By which fluxes are multiplied: 1 over the area of a cell.
    xp : module
        The arrays' namespace.
    """
    lines = xp.concat([y, x])
    # As a product of differences, which keeps its digits where the circle touches a line.
    square = (range_ - lines) * (range_ + lines)
    meets = square > 0.0
    chord = xp.where(
        meets, xp.sqrt(xp.where(meets, square, xp.ones_like(square))), xp.zeros_like(lines)
    )
    count = y.shape[0]
    # The azimuths at which the circle meets the lines, from the same chords: so the errors of
    # chords and arcs cancel. Clockwise from north, for the eastern and for the northern half.
    of_row = xp.atan2(chord[:count, :], -y)  # in [0, pi]
    of_column = xp.atan2(x, chord[count:, :])  # in [-pi / 2, pi / 2]
    first = xp.floor(left_deg / 90.0)
    outlines = []
    for part in range(math.floor(widest_deg / 90.0) + 2):
        # The part in one quadrant, in which both coordinates run in one sense.
        start_deg = 90.0 * (first + float(part))
        start, stop = (
            (xp.clip(edge - start_deg, 0.0, 90.0) * _RADIANS)[:, None]
            for edge in (left_deg, right_deg)
        )
        quadrant = (first + float(part)) - 4.0 * xp.floor((first + float(part)) / 4.0)
        outlines.append(
            _quarter(quadrant[:, None], of_row, of_column, start, stop, scale * range_**2 / 2, xp)
        )
    return Cut(-chord, chord, outlines)


def _quarter(
    quadrant: Any, of_row: Any, of_column: Any, start: Any, stop: Any, factor: float, xp: ModuleType
) -> Outline:
    """A circle's part in a quadrant 0 to 3 [B, 1], from angle start to stop after its beginning."""
    one, zero = xp.ones_like(start), xp.zeros_like(start)
    right_angle = math.pi / 2 * one
    # The angles after the quadrant's beginning at which the lines are met.
    east, north = quadrant < 2.0, (quadrant == 0.0) | (quadrant == 3.0)
    even = (quadrant == 0.0) | (quadrant == 2.0)
    row_sign = xp.where(east, one, -one)
    row_start = xp.where(
        even,
        xp.where(east, zero, 2.0 * right_angle),
        xp.where(east, -right_angle, right_angle),
    )
    column_sign = xp.where(north, one, -one)
    column_start = xp.where(even, zero, right_angle)
    rows = clip_between(row_start + row_sign * of_row, start, stop, xp) * factor
    columns = clip_between(column_start + column_sign * of_column, start, stop, xp) * factor
    return _outline(rows, columns, even, start * factor, stop * factor, xp)


def _outline(
    rows: Any, columns: Any, even: Any, lowest: Any, highest: Any, xp: ModuleType
) -> Outline:
    """The outline whose stretch in a cell is the mixed difference of min(row, column).

    That is so where both coordinates run in one sense (``even``), else it is that of their maximum.
    """
    low, high = xp.where(even, lowest, rows), xp.where(even, rows, highest)
    return Outline(columns, low, kept_apart(low, high, xp))


def cut_by_plane(
    range_: float, y: Any, x: Any, heading_deg: Any, left: tuple[Any, Any],
    right: tuple[Any, Any], scale: float, xp: ModuleType,
) -> Cut:  # fmt: skip
    """Cut sectors off at the depth ``range_`` along the heading.

    Parameters
    ----------
    range_ : float
        Depth, in shares of the tile's side.
    y, x : arrays [B, L + 1]
        Offsets of the horizontal and of the vertical lattice lines from the cameras.
    heading_deg : array [B]
        Azimuth along which depth is measured.
    left, right : (du, dv), arrays [B]
        Directions of the sectors' edges, less than 90 degrees from the heading.
    scale : float
        By which fluxes are multiplied: 1 over the area of a cell.
    xp : module
        The arrays' namespace.
    """
    hx, hy = (part[:, None] for part in direction(heading_deg, xp))
    # The depth line: range_ * h + t * w, with w to the right of the heading.
    wx, wy = -hy, hx

    def end(ray: tuple[Any, Any]) -> Any:
        du, dv = (part[:, None] for part in ray)
        return range_ * (du * wx + dv * wy) / (du * hx + dv * hy)

    start, stop = end(left), end(right)
    row_at, row_bounds = _meet(range_, y, hy, wy, hx, wx, xp)
    column_at, column_bounds = _meet(range_, x, hx, wx, hy, wy, xp)
    factor = scale * range_ / 2
    rows = clip_between(row_at, start, stop, xp) * factor
    columns = clip_between(column_at, start, stop, xp) * factor
    even = (wx > -PARALLEL) == (wy > -PARALLEL)
    outline = _outline(rows, columns, even, start * factor, stop * factor, xp)
    low, high = (
        xp.concat([row, column]) for row, column in zip(row_bounds, column_bounds, strict=True)
    )
    return Cut(low, high, [outline])


def _meet(
    range_: float, offset: Any, h_across: Any, w_across: Any, h_along: Any, w_along: Any,
    xp: ModuleType,
) -> tuple[Any, tuple[Any, Any]]:  # fmt: skip
    """Where the depth line meets one family of lattice lines: t, and the stretch within range.

    ``offset`` [B, L + 1] is the lines' coordinate; h and w [B, 1] have their parts across the lines
    and along them.
    """
    ahead = offset - range_ * h_across
    # Dividing by less would overflow.
    parallel = xp.abs(w_across) < PARALLEL
    t = ahead / xp.where(parallel, xp.ones_like(w_across), w_across)
    far = FAR * xp.ones_like(ahead)
    # A line that runs along the depth line is within range or not as a whole. Where both are one,
    # the outline's flux counts for the cell before it, so the line is within range if that cell is
    # not.
    t = xp.where(parallel, xp.where(ahead >= 0.0, far, -far), t)
    at = xp.clip(range_ * h_along + t * w_along, -FAR, FAR)
    within_all = xp.where(h_across > 0.0, ahead < 0.0, ahead >= 0.0)
    backward = h_along > 0.0
    low = xp.where(parallel, xp.where(within_all, -far, far), xp.where(backward, -far, at))
    high = xp.where(parallel, far, xp.where(backward, at, far))
    return t, (low, high)


def window_cells(range_: float, cells: int) -> int:
    """How many cells in a row a circle of this radius around any camera can reach."""
    return min(cells, int(np.floor(2.0 * range_ * cells)) + 2)
