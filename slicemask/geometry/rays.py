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
import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from types import ModuleType
from typing import Any

import array_api_compat
import numpy as np

from slicemask.geometry.azimuths import direction
from slicemask.geometry.noise import remove_noise
from slicemask.geometry.ranges import (
    BEYOND,
    PARALLEL,
    Cut,
    clip_between,
    cut_by_circle,
    cut_by_plane,
    kept_apart,
    window_cells,
)

# Lattice values worked on at once. NumPy's fit a processor's second-level cache; other libraries
# pay more for each call.
_NUMPY_VALUES = 35_000
_OTHER_VALUES = 90_000
# What a thread computes in from call to call: in fresh memory 64 masks take 1.7 times as long.
_thread = threading.local()
# Sectors are cut before they are 180 degrees wide, which rounding of their edges could make of a
# little less.
WIDEST_DEG = 179.9


def sector_fractions(
    u: Any, v: Any, left_deg: Any, right_deg: Any, cells: int, widest_deg: float | None = None,
    out: Any = None,
) -> Any:  # fmt: skip
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
    out : float64 [B, L, L], optional
        A NumPy array that NumPy's results are written to. Fresh memory costs as much as the
        arithmetic.

    Returns
    -------
    fractions : array [B, L, L]
        In the arrays' own namespace, dtype and device; differentiable where they are. Rounding
        leaves values of the order of L * 1e-16 outside [0, 1] (float64).
    """
    xp = _namespace(u)
    sectors = _Sectors(u, v, left_deg, right_deg)
    if u.shape[0] == 0:
        return xp.zeros((0, cells, cells), dtype=u.dtype, device=array_api_compat.device(u))
    return _fractions(sectors, _Window(0, 0, cells, cells), widest_deg, xp, out)


def banded_fractions(
    u: Any, v: Any, left_deg: Any, right_deg: Any, cells: int, bands: tuple[float, ...],
    heading_deg: Any = None, widest_deg: float | None = None, out: Any = None,
) -> Any:  # fmt: skip
    """Share of each cell that lies in each band of a sector, for a batch of sectors.

    Parameters
    ----------
    u, v, left_deg, right_deg, cells, widest_deg
        As `sector_fractions` takes them; the cameras are on the tile.
    bands : tuple of float
        The increasing ranges between bands, in shares of the tile's side.
    heading_deg : array [B], optional
        The azimuth along which range is measured as a depth; without it, range is the distance
        from the camera.
    out : float64 [B, len(bands) + 1, L, L], optional
        As `sector_fractions` takes it.

    Returns
    -------
    fractions : array [B, len(bands) + 1, L, L]
        As `sector_fractions` gives them, which is their sum over the bands; but NumPy's are cleaned
        of noise (`slicemask.geometry.noise`), since most of them are empty.
    """
    xp = _namespace(u)
    if u.shape[0] == 0:
        shape = (0, len(bands) + 1, cells, cells)
        return xp.zeros(shape, dtype=u.dtype, device=array_api_compat.device(u))
    if widest_deg is None:
        widest_deg = float(xp.max(right_deg - left_deg))
    sectors = _Sectors(u, v, left_deg, right_deg, heading_deg)
    if xp is np:
        return _bands_in_place(sectors, cells, bands, widest_deg, out)
    whole = sector_fractions(u, v, left_deg, right_deg, cells, widest_deg)
    tile = _Window(0, 0, cells, cells)
    ends = [
        whole
        if range_ >= BEYOND
        else _fractions(replace(sectors, range=range_), tile, widest_deg, xp)
        for range_ in bands
    ]
    ends.append(whole)
    return xp.stack([ends[0]] + [far - near for near, far in pairwise(ends)], axis=1)


def _bands_in_place(
    sectors: "_Sectors", cells: int, bands: tuple[float, ...], widest_deg: float, out: Any
) -> Any:
    """`banded_fractions` of NumPy arrays: what a circle does not reach is left alone."""
    count, tile = len(sectors.u), _Window(0, 0, cells, cells)
    fractions = np.empty((count, len(bands) + 1, cells, cells)) if out is None else out
    fractions[:, :-1] = 0.0
    whole = _fractions(sectors, tile, widest_deg, np, fractions[:, -1])
    # A band is what lies within its far range, less what lies within its near one.
    nearer: tuple[Any, _Window] | None = None
    for band, range_ in enumerate(bands):
        if range_ >= BEYOND:
            fractions[:, band] = whole
            if nearer is not None:
                _take_off(fractions[:, band], tile, *nearer)
            remove_noise(fractions[:, band])
            whole[:] = 0.0
            break
        window = tile
        if sectors.heading_deg is None:
            window = _Window.around(sectors.u, sectors.v, range_, cells)
        within = _fractions(replace(sectors, range=range_), window, widest_deg, np)
        share = within.copy()
        if nearer is not None:
            _take_off(share, window, *nearer)
        remove_noise(share)
        for some, here, there in window.overlaps(tile, count):
            fractions[(some, band, *there)] = share[(some, *here)]
        nearer = within, window
    else:
        if nearer is not None:
            _take_off(whole, tile, *nearer)
        remove_noise(whole)
    return fractions


def _namespace(array: Any) -> ModuleType:
    """The array's namespace; NumPy is its own, since the wrapper's would add a long import."""
    if array_api_compat.is_numpy_array(array):
        return np
    return array_api_compat.array_namespace(array)


@dataclass(frozen=True)
class _Sectors:
    """Sectors of cameras, arrays [B] each, up to a range if there is one.

    The range is a depth along the headings where there are any, else a distance.
    """

    u: Any
    v: Any
    left_deg: Any
    right_deg: Any
    heading_deg: Any = None
    range: float | None = None


@dataclass(frozen=True)
class _Window:
    """The cells to compute: ``size`` rows and columns of an L x L tile, from ``row``, ``column``.

    These are numbers, or int64 [B], one for each sector.
    """

    row: Any
    column: Any
    size: int
    cells: int

    @classmethod
    def around(cls, u: Any, v: Any, range_: float, cells: int) -> "_Window":
        """The cells that circles of a radius around NumPy cameras can reach."""
        size = window_cells(range_, cells)
        if size == cells:
            return cls(0, 0, cells, cells)
        row, column = (
            np.clip(np.floor((at - range_) * cells), 0, cells - size).astype(np.int64)
            for at in (v, u)
        )
        return cls(row, column, size, cells)

    def overlaps(
        self, other: "_Window", count: int
    ) -> Iterator[tuple[slice, tuple[slice, slice], tuple[slice, slice]]]:
        """Sectors in a row, of so many, whose windows lie alike, and the cells in both windows.

        These are rows and columns of this window, and of the other one.
        """
        starts = np.empty((4, count), np.int64)
        for line, start in zip(
            starts, (self.row, self.column, other.row, other.column), strict=True
        ):
            line[:] = start
        moves = np.flatnonzero(np.diff(starts).any(axis=0)) + 1
        for first, last in pairwise([0, *moves.tolist(), count]):
            row, column, other_row, other_column = starts[:, first].tolist()
            rows = _overlap(row, self.size, other_row, other.size)
            columns = _overlap(column, self.size, other_column, other.size)
            yield slice(first, last), (rows[0], columns[0]), (rows[1], columns[1])

    def lattices(self, u: Any, xp: ModuleType) -> tuple[Any, Any]:
        """Coordinates of the horizontal and of the vertical lines, [1 or B, size + 1]."""
        steps = xp.arange(self.size + 1, dtype=u.dtype, device=array_api_compat.device(u))[None, :]
        if isinstance(self.row, int):
            return steps / self.cells, steps / self.cells
        return (self.row[:, None] + steps) / self.cells, (self.column[:, None] + steps) / self.cells


def _take_off(fractions: Any, window: _Window, nearer: Any, near_window: _Window) -> None:
    """Take what lies nearer off fractions, each of a window of its own, in place."""
    for some, near, here in near_window.overlaps(window, len(fractions)):
        fractions[(some, *here)] -= nearer[(some, *near)]


def _overlap(start: int, size: int, other_start: int, other_size: int) -> tuple[slice, slice]:
    """What two stretches of cells share, counted from the start of each."""
    low, high = max(start, other_start), min(start + size, other_start + other_size)
    high = max(low, high)
    return slice(low - start, high - start), slice(low - other_start, high - other_start)


def _fractions(
    sectors: _Sectors, window: _Window, widest_deg: float | None, xp: ModuleType, out: Any = None
) -> Any:
    """`sector_fractions` of some cells: [B, size, size]."""
    left_deg, right_deg = sectors.left_deg, sectors.right_deg
    # A sector of 180 degrees or more can cut a line twice: cut it into narrower ones.
    if widest_deg is None:
        widest_deg = float(xp.max(right_deg - left_deg))
    parts = math.floor(widest_deg / WIDEST_DEG) + 1
    fractions = None
    start_deg = left_deg
    for part in range(1, parts + 1):
        stop_deg = right_deg if part == parts else left_deg + (right_deg - left_deg) * part / parts
        narrow = replace(sectors, left_deg=start_deg, right_deg=stop_deg)
        share = _narrow(narrow, window, widest_deg / parts, xp, out if parts == 1 else None)
        fractions = share if fractions is None else fractions + share
        start_deg = stop_deg
    if out is not None and parts > 1:
        out[...] = fractions
        return out
    return fractions


def _narrow(
    sectors: _Sectors, window: _Window, widest_deg: float, xp: ModuleType, out: Any = None
) -> Any:
    """`_fractions` of sectors narrower than 180 degrees."""
    u, v = sectors.u, sectors.v
    count, cells = u.shape[0], window.cells
    ray_u, ray_v = direction(xp.concat([sectors.left_deg, sectors.right_deg]), xp)
    lu, ru, lv, rv = ray_u[:count], ray_u[count:], ray_v[:count], ray_v[count:]
    row_lattice, column_lattice = window.lattices(u, xp)
    y, x = row_lattice - v[:, None], column_lattice - u[:, None]
    # The horizontal lines, then the vertical ones: their offsets Y and X, and their intervals.
    # Azimuth grows to the right where a line lies ahead (Y < 0) and to the left where it lies
    # behind; swapping the axes turns the plane's orientation, hence the swapped rays.
    offset, origin = xp.concat([y, x]), xp.concat([u, v])
    low, high = _intervals(
        offset,
        origin,
        (xp.concat([lu, rv]), xp.concat([lv, ru])),
        (xp.concat([ru, lv]), xp.concat([rv, lu])),
        xp,
    )
    outlines = []
    if sectors.range is not None:
        cut = _cut(sectors, y, x, ((lu, lv), (ru, rv)), widest_deg, float(cells * cells), xp)
        nearest, farthest = origin[:, None] + cut.low, origin[:, None] + cut.high
        low, high = (clip_between(bound, nearest, farthest, xp) for bound in (low, high))
        high = kept_apart(low, high, xp)
        outlines = [
            (_columns(part.along), _rows(part.low, xp), _rows(part.high, xp))
            for part in cut.outlines
        ]
    # Fractions are areas over that of a cell; the factor comes in here, where it is cheapest.
    cuts = offset * (cells * cells / 2), low, high
    # G is laid out as [i, b, j]: for all sectors at once, what belongs to columns lies together.
    rows = [_rows(values[:count, :], xp) for values in cuts]
    columns = [_columns(values[count:, :]) for values in cuts]
    along_row, along_column = _columns(column_lattice), _rows(row_lattice, xp)

    on_numpy, lines = xp is np, window.size + 1
    step = max(1, (_NUMPY_VALUES if on_numpy else _OTHER_VALUES) // lines**2)
    fractions: Any = out
    if out is None:
        fractions = np.empty((count, window.size, window.size), u.dtype) if on_numpy else []
    workspace = _Workspace(along_row, along_column)
    for start in range(0, count, step):
        some = slice(start, min(start + step, count))
        if on_numpy:
            workspace = workspace.sized((lines, some.stop - some.start, lines), some)
        areas = _areas(
            [values[:, some, :] for values in rows],
            [values[:, some, :] for values in columns],
            [tuple(values[:, some, :] for values in part) for part in outlines],
            workspace if on_numpy else workspace.of(some),
            xp,
        )
        areas = xp.permute_dims(areas, (1, 0, 2))
        if on_numpy:
            fractions[some] = areas
        else:
            fractions.append(areas)
    return fractions if on_numpy else xp.concat(fractions, axis=0)


def _cut(
    sectors: _Sectors, y: Any, x: Any, rays: tuple[tuple[Any, Any], tuple[Any, Any]],
    widest_deg: float, scale: float, xp: ModuleType,
) -> Cut:  # fmt: skip
    assert sectors.range is not None
    if sectors.heading_deg is None:
        edges = sectors.left_deg, sectors.right_deg
        return cut_by_circle(sectors.range, y, x, *edges, widest_deg, scale, xp)
    return cut_by_plane(sectors.range, y, x, sectors.heading_deg, *rays, scale, xp)


def _rows(values: Any, xp: ModuleType) -> Any:
    """Values of the horizontal lines, [b, i] to [i, b, 1]."""
    return xp.permute_dims(values, (1, 0))[:, :, None]


def _columns(values: Any) -> Any:
    """Values of the vertical lines, [b, j] to [1, b, j]."""
    return values[None, :, :]


@dataclass(frozen=True)
class _Workspace:
    """The lattice along rows and columns, and arrays to compute in, if any: all [i, b, j].

    NumPy works in arrays that exist already: the first touch of fresh memory costs as much as the
    arithmetic. And it works on whole arrays twice as fast as on those it must repeat.
    """

    along_row: Any
    along_column: Any
    scratch_a: Any = None
    scratch_b: Any = None
    lattices: tuple[Any, Any] | None = None

    def of(self, some: slice) -> "_Workspace":
        """The workspace of some sectors: their own lattices, or the one that all share."""
        if self.along_row.shape[1] == 1:
            return self
        return _Workspace(self.along_row[:, some, :], self.along_column[:, some, :])

    def sized(self, shape: tuple[int, int, int], some: slice) -> "_Workspace":
        """A workspace of arrays of a shape for some sectors: this one, if it is one."""
        lattices = self.lattices or (self.along_row, self.along_column)
        shared = lattices[0].shape[1] == 1
        fits = self.scratch_a is not None and self.scratch_a.shape == shape
        if fits and shared:
            return self
        kept: _Workspace | None = getattr(_thread, "workspace", None)
        # The lattice that all share is the whole tile's: its shape tells its values.
        if shared and kept is not None and kept.scratch_a.shape == shape:
            return kept
        found = self
        if not fits:
            along_row, along_column, scratch_a, scratch_b = (np.empty(shape) for _ in range(4))
            found = _Workspace(along_row, along_column, scratch_a, scratch_b)
        for array, lattice in zip((found.along_row, found.along_column), lattices, strict=True):
            array[:] = lattice if shared else lattice[:, some, :]
        found = replace(found, lattices=lattices)
        # A whole block's is kept; the last block of a call is smaller.
        if shared and _NUMPY_VALUES // 2 < math.prod(shape) <= _NUMPY_VALUES:
            _thread.workspace = found
        return found


def _areas(
    rows: list[Any], columns: list[Any], outlines: list[Any], workspace: _Workspace, xp: ModuleType
) -> Any:
    """Areas of the cells within sectors, over that of a cell, [L, b, L].

    ``rows`` and ``columns`` are the factors, lows and highs of the horizontal lines [L + 1, b, 1]
    and the vertical ones [1, b, L + 1]; ``outlines`` are the parts of a range's outline.
    """
    g = _fluxes(workspace.along_row, rows, workspace.scratch_a, xp)
    g += _fluxes(workspace.along_column, columns, workspace.scratch_b, xp)
    for along, low, high in outlines:
        g += _clip(along, low, high, workspace.scratch_b, xp)
    if workspace.scratch_a is None:
        g = g[1:, :, :] - g[:-1, :, :]
        return g[:, :, 1:] - g[:, :, :-1]
    g = np.subtract(g[1:], g[:-1], out=workspace.scratch_b[:-1])
    # One long run, over the ends of rows too, takes half the time of many short ones.
    flat = workspace.scratch_a.reshape(-1)
    np.subtract(g.reshape(-1)[1:], g.reshape(-1)[:-1], out=flat[: g.size - 1])
    return workspace.scratch_a[:-1, :, :-1]


def _fluxes(along: Any, lines: list[Any], out: Any, xp: ModuleType) -> Any:
    """One kind of lines' part of G, in the array ``out`` if there is one."""
    factor, low, high = lines
    clipped = _clip(along, low, high, out, xp)
    return factor * clipped if out is None else np.multiply(factor, clipped, out=out)


def _clip(values: Any, low: Any, high: Any, out: Any, xp: ModuleType) -> Any:
    """`xp.clip`, in the array ``out`` if there is one."""
    if out is None:
        return xp.clip(values, low, high)
    return np.minimum(np.maximum(values, low, out=out), high, out=out)


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
    parallel = xp.abs(q) < PARALLEL
    slope = p / xp.where(parallel, xp.ones_like(q), q)
    return ~parallel & (q < 0.0), ~parallel & (q > 0.0), slope
