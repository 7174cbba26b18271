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
from types import ModuleType
from typing import Any

import array_api_compat
import numpy as np

from slicemask.geometry.azimuths import direction

# Lattice values worked on at once: arrays small enough for a processor's second-level cache, and
# for the allocator to hand out the same memory again (below 128 KiB). Either halves the time.
_CACHE_VALUES = 15_000
_PARALLEL = 1e-30


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
    parts = math.floor(widest_deg / 180.0) + 1
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
    lattice = xp.arange(cells + 1, dtype=u.dtype, device=array_api_compat.device(u)) / cells
    lu, lv = direction(left_deg, xp)
    ru, rv = direction(right_deg, xp)
    row_offset = lattice - v[:, None]  # Y of the horizontal lines
    column_offset = lattice - u[:, None]  # X of the vertical lines
    # Azimuth grows to the right where a line lies ahead (Y < 0) and to the left where it lies
    # behind; swapping the axes turns the plane's orientation, hence the swapped rays.
    row_low, row_high = _interval(row_offset, u, lu, lv, ru, rv, xp)
    column_low, column_high = _interval(column_offset, v, rv, ru, lv, lu, xp)

    # NumPy's clip is a third slower than its two halves; torch's is a third faster, backward too.
    on_numpy = array_api_compat.is_numpy_array(u)
    clip = _numpy_clip if on_numpy else xp.clip

    # Fractions are areas over that of a cell; the factor comes in here, where it is cheapest.
    row_factor = row_offset * (cells * cells / 2)
    column_factor = column_offset * (cells * cells / 2)

    def row_differences(some: slice) -> Any:
        """G[i + 1, j] - G[i, j], [b, L, L + 1]."""
        g = row_factor[some, :, None] * clip(
            lattice[None, None, :], row_low[some, :, None], row_high[some, :, None]
        )
        g += column_factor[some, None, :] * clip(
            lattice[None, :, None], column_low[some, None, :], column_high[some, None, :]
        )
        return g[:, 1:, :] - g[:, :-1, :]

    # Other libraries pay more for each call, and keep what they free.
    values = _CACHE_VALUES if on_numpy else 6 * _CACHE_VALUES
    step = max(1, values // (cells + 1) ** 2)
    count = u.shape[0]
    pieces = [slice(start, min(start + step, count)) for start in range(0, count, step)]
    if on_numpy:
        # Filling one array spares fresh memory, whose first touch costs as much as the arithmetic.
        fractions = np.empty((count, cells, cells), dtype=u.dtype)
        for some in pieces:
            g = row_differences(some)
            np.subtract(g[:, :, 1:], g[:, :, :-1], out=fractions[some])
        return fractions
    return xp.concat([g[:, :, 1:] - g[:, :, :-1] for g in map(row_differences, pieces)], axis=0)


def _numpy_clip(values: Any, low: Any, high: Any) -> Any:
    return np.minimum(np.maximum(values, low), high)


def _interval(
    offset: Any, origin: Any, lp: Any, lq: Any, rp: Any, rq: Any, xp: ModuleType
) -> tuple[Any, Any]:
    """Where the lines q = offset lie in sectors: low and high p, in [0, 1], each [B, L + 1].

    ``origin`` [B] is the camera's p; (lp, lq) and (rp, rq) [B] are the sectors' left and right
    directions. Outside the sector low = high, so that clipping to the interval gives a constant.
    """
    left_meets, left_p = _meeting(offset, origin, lp, lq, xp)
    right_meets, right_p = _meeting(offset, origin, rp, rq, xp)
    zero, one = xp.zeros_like(left_p), xp.ones_like(left_p)
    # Ahead (offset < 0) the sector opens with its left ray and closes with its right one. A ray
    # that misses the line leaves that side open if the other one meets it, and empty otherwise.
    ahead = offset < 0.0
    low_ahead = xp.where(left_meets, left_p, zero)
    high_ahead = xp.where(right_meets, right_p, xp.where(left_meets, one, zero))
    low_behind = xp.where(right_meets, right_p, xp.where(left_meets, zero, one))
    high_behind = xp.where(left_meets, left_p, one)
    return xp.where(ahead, low_ahead, low_behind), xp.where(ahead, high_ahead, high_behind)


def _meeting(offset: Any, origin: Any, p: Any, q: Any, xp: ModuleType) -> tuple[Any, Any]:
    """Whether rays (p, q) from the origin meet the lines at offset, and where: p in [0, 1]."""
    # A ray this close to parallel leaves the tile before it meets any line that matters: fluxes
    # are proportional to the offset. Dividing by q would overflow.
    parallel = xp.abs(q) < _PARALLEL
    meets = ~parallel[:, None] & (q[:, None] * offset > 0.0)
    # The quotient is only used where the ray meets the line; elsewhere it is kept finite, so
    # that no NaN reaches a gradient.
    divisor = xp.where(parallel, xp.ones_like(q), q)
    at = origin[:, None] + offset * (p / divisor)[:, None]
    zero, one = xp.zeros_like(at), xp.ones_like(at)
    return meets, xp.minimum(xp.maximum(at, zero), one)
