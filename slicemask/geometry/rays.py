"""The closed-form engine: exact cell fractions of slices from two rays and the lattice lines.

Write F = (x, y) / 2 with the camera at the origin. Its divergence is 1, so the area of (cell and
slice) is the flux of F out of that region (Green's theorem), and F runs along the slice's two
rays, so no flux leaves through them: only the cell's four lattice edges count. Through a
horizontal lattice line at offset Y from the camera the flux is Y / 2 times the length of the edge
that lies in the slice; through a vertical one at offset X, X / 2 times it. A slice narrower than
180 degrees cuts a lattice line in one interval, so those lengths are differences of the lattice
coordinates clipped to the interval, and the area of cell (i, j) is the mixed difference of

    G[i, j] = (Y[i] * clip(x[j], interval of row line i)
               + X[j] * clip(y[i], interval of column line j)) / 2

on the (L + 1) x (L + 1) lattice points. No polygon is ever built. The arithmetic is the array API
standard's alone, so NumPy arrays and torch tensors (on any device, with gradients through place
and azimuths) take the same path.
"""

import math
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import array_api_compat
import numpy as np

from slicemask.geometry.azimuths import direction

# Lattice values worked on at once. NumPy's fit a processor's second-level cache; other libraries
# pay more for each call.
_NUMPY_VALUES = 35_000
_OTHER_VALUES = 90_000
_PARALLEL = 1e-30
# Sectors are cut before they are 180 degrees wide, which rounding of their edges could make of a
# little less.
_WIDEST_DEG = 179.9


def sector_fractions(
    u: Any, v: Any, left_deg: Any, right_deg: Any, cells: int, widest_deg: float | None = None
) -> Any:
    """Share of each cell that lies in a sector, for a batch of sectors.

    Parameters
    ----------
    u, v : arrays [B]
        The camera, in the aerial frame; it may stand on or outside the tile's edge.
    left_deg, right_deg : arrays [B]
        Azimuths of the sector's edges, clockwise from left to right, with
        left <= right <= left + 360.
    cells : int
        L, the number of cells along each side of the tile.
    widest_deg : float, optional
        No sector is wider than this; found from the azimuths if not given, which for a tensor on
        an accelerator waits for its values.

    Returns
    -------
    fractions : array [B, L, L]
        In the arrays' own namespace, dtype and device; differentiable where they are. Rounding
        leaves values of the order of L * 1e-16 outside [0, 1] (float64).
    """
    # NumPy is its own namespace; the wrapper's would only add a long import.
    on_numpy = array_api_compat.is_numpy_array(u)
    xp = np if on_numpy else array_api_compat.array_namespace(u, v, left_deg, right_deg)
    if u.shape[0] == 0:
        return xp.zeros((0, cells, cells), dtype=u.dtype, device=array_api_compat.device(u))
    # A sector of 180 degrees or more can cut a line twice: cut it into narrower ones.
    if widest_deg is None:
        widest_deg = float(xp.max(right_deg - left_deg))
    parts = math.floor(widest_deg / _WIDEST_DEG) + 1
    fractions = None
    start_deg = left_deg
    for part in range(1, parts + 1):
        stop_deg = right_deg if part == parts else left_deg + (right_deg - left_deg) * part / parts
        share = _narrow(u, v, start_deg, stop_deg, cells, xp)
        fractions = share if fractions is None else fractions + share
        start_deg = stop_deg
    return fractions


def _narrow(u: Any, v: Any, left_deg: Any, right_deg: Any, cells: int, xp: ModuleType) -> Any:
    """`sector_fractions` of sectors narrower than 180 degrees."""
    count, lines = u.shape[0], cells + 1
    lattice = xp.arange(lines, dtype=u.dtype, device=array_api_compat.device(u)) / cells
    ray_u, ray_v = direction(xp.concat([left_deg, right_deg]), xp)
    lu, ru, lv, rv = ray_u[:count], ray_u[count:], ray_v[:count], ray_v[count:]
    # The horizontal lines, then the vertical ones: their offsets Y and X, and their intervals.
    # Azimuth grows to the right where a line lies ahead (Y < 0) and to the left where it lies
    # behind; swapping the axes turns the plane's orientation, hence the swapped rays.
    offset = lattice - xp.concat([v, u])[:, None]
    low, high = _intervals(
        offset,
        xp.concat([u, v]),
        (xp.concat([lu, rv]), xp.concat([lv, ru])),
        (xp.concat([ru, lv]), xp.concat([rv, lu])),
        xp,
    )
    # Fractions are areas over that of a cell; the factor comes in here, where it is cheapest.
    cuts = offset * (cells * cells / 2), low, high
    # G is laid out as [i, b, j]: for all sectors at once, what belongs to columns lies together.
    rows = [xp.permute_dims(values[:count, :], (1, 0))[:, :, None] for values in cuts]
    columns = [values[None, count:, :] for values in cuts]

    on_numpy = array_api_compat.is_numpy_array(u)
    step = max(1, (_NUMPY_VALUES if on_numpy else _OTHER_VALUES) // lines**2)
    fractions: Any = np.empty((count, cells, cells), dtype=u.dtype) if on_numpy else []
    desk = _Desk(lattice[None, None, :], lattice[:, None, None])
    for start in range(0, count, step):
        some = slice(start, min(start + step, count))
        if on_numpy:
            desk = desk.laid_out((lines, some.stop - some.start, lines))
        areas = _areas([x[:, some, :] for x in rows], [x[:, some, :] for x in columns], desk, xp)
        areas = xp.permute_dims(areas, (1, 0, 2))
        if on_numpy:
            fractions[some] = areas
        else:
            fractions.append(areas)
    return fractions if on_numpy else xp.concat(fractions, axis=0)


@dataclass(frozen=True)
class _Desk:
    """The lattice along rows and columns, and arrays to compute in, if any: all [i, b, j].

    NumPy works in arrays that are there: the first touch of fresh memory costs as much as the
    arithmetic. And it works on whole arrays twice as fast as on those it must repeat.
    """

    along_row: Any
    along_column: Any
    one: Any = None
    other: Any = None

    def laid_out(self, shape: tuple[int, int, int]) -> "_Desk":
        """Return a desk of arrays of a shape: this one, if it is."""
        if self.one is not None and self.one.shape == shape:
            return self
        lattice = self.along_row[0, 0]
        along_row, along_column, one, other = (np.empty(shape) for _ in range(4))
        along_row[:], along_column[:] = lattice, lattice[:, None, None]
        return _Desk(along_row, along_column, one, other)


def _areas(rows: list[Any], columns: list[Any], desk: _Desk, xp: ModuleType) -> Any:
    """Areas of the cells within sectors, over that of a cell, [L, b, L].

    ``rows`` and ``columns`` are the factors, lows and highs of the horizontal lines [L + 1, b, 1]
    and the vertical ones [1, b, L + 1].
    """
    g = _fluxes(desk.along_row, rows, desk.one, xp)
    g += _fluxes(desk.along_column, columns, desk.other, xp)
    if desk.one is None:
        g = g[1:, :, :] - g[:-1, :, :]
        return g[:, :, 1:] - g[:, :, :-1]
    g = np.subtract(g[1:], g[:-1], out=desk.other[:-1])
    # One long run, over the ends of rows too, takes half the time of many short ones.
    np.subtract(g.reshape(-1)[1:], g.reshape(-1)[:-1], out=desk.one.reshape(-1)[: g.size - 1])
    return desk.one[:-1, :, :-1]


def _fluxes(lattice: Any, lines: list[Any], out: Any, xp: ModuleType) -> Any:
    """One kind of lines' part of G, in the array ``out`` if there is one."""
    factor, low, high = lines
    if out is None:
        return factor * xp.clip(lattice, low, high)
    clipped = np.minimum(np.maximum(lattice, low, out=out), high, out=out)
    return np.multiply(factor, clipped, out=out)


def _intervals(
    offset: Any, origin: Any, left: tuple[Any, Any], right: tuple[Any, Any], xp: ModuleType
) -> tuple[Any, Any]:
    """Where the lines q = offset lie in sectors: low and high p, in [0, 1], each [B, L + 1].

    ``origin`` [B] is the camera's p; ``left`` and ``right`` are the (p, q) of the sectors' left
    and right directions, each [B]. Outside the sector low = high, so that clipping to the
    interval gives a constant.
    """
    ahead = offset < 0.0
    left_ahead, left_behind, left_slope = _meetings(*left, xp)
    right_ahead, right_behind, right_slope = _meetings(*right, xp)
    zero, one = xp.zeros_like(origin), xp.ones_like(origin)

    def bound(ray_ahead: Any, else_ahead: Any, ray_behind: Any, else_behind: Any) -> Any:
        """Where the lines meet a ray (whether they do, its slope), or what stands for it."""
        (meets_ahead, slope_ahead), (meets_behind, slope_behind) = ray_ahead, ray_behind
        start = xp.where(
            ahead,
            xp.where(meets_ahead, origin, else_ahead)[:, None],
            xp.where(meets_behind, origin, else_behind)[:, None],
        )
        slope = xp.where(
            ahead,
            xp.where(meets_ahead, slope_ahead, zero)[:, None],
            xp.where(meets_behind, slope_behind, zero)[:, None],
        )
        return xp.clip(start + offset * slope, 0.0, 1.0)

    # Ahead (offset < 0) the sector opens with its left ray and closes with its right one. A ray
    # that misses the lines leaves that side open if the other one meets them, and empty otherwise.
    low = bound(
        (left_ahead, left_slope),
        zero,
        (right_behind, right_slope),
        xp.where(left_behind, zero, one),
    )
    high = bound(
        (right_ahead, right_slope),
        xp.where(left_ahead, one, zero),
        (left_behind, left_slope),
        one,
    )
    return low, high


def _meetings(p: Any, q: Any, xp: ModuleType) -> tuple[Any, Any, Any]:
    """Whether rays (p, q) [B] meet the lines ahead, and those behind, and their slopes dp/dq."""
    # A ray this close to parallel leaves the tile before it meets any line that matters: fluxes
    # are proportional to the offset. Dividing by q would overflow.
    parallel = xp.abs(q) < _PARALLEL
    slope = p / xp.where(parallel, xp.ones_like(q), q)
    return ~parallel & (q < 0.0), ~parallel & (q > 0.0), slope
