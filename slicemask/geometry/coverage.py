"""The Shapely engine: slices as polygons, fractions as areas of polygon-cell intersections.

The default of `slicemask build`, and the judge of the closed-form engine. A cell that the slice's
edges leave alone is wholly inside or wholly outside, so only the cells they may cross are
intersected; a few hundredths of the work of intersecting every cell.
"""

from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from slicemask.geometry.azimuths import direction

Array = NDArray[np.float64]

# Half the side of the square, around the camera, that stands for an unbounded slice. Any value
# above 1 reaches past the tile from every place on it; a power of two keeps corners exact.
_REACH = 2.0
# Lattice points classified at once, which bounds the memory of a call.
_LATTICE_VALUES = 1 << 21


def sector_polygons(u: Array, v: Array, left_deg: Array, right_deg: Array) -> NDArray[np.object_]:
    """Polygons of sectors, large enough to cover their part of the tile.

    Parameters
    ----------
    u, v : float64 [B]
        The camera, in the aerial frame.
    left_deg, right_deg : float64 [B]
        Azimuths of the sector's edges, left < right <= left + 360.

    Returns
    -------
    polygons : Shapely polygons [B]
        Each the part of the sector within a square around the camera, in the aerial frame; not
        clipped to the tile. Reflex beyond 180 degrees; the whole square at 360.
    """
    # Between its two edges the square's outline turns at azimuths 45 + 90 k. Those outside the
    # sector are clamped to its edges: repeated vertices, which polygons may have, in return for
    # one vertex count for all.
    first_corner = 90.0 * np.ceil((left_deg - 45.0) / 90.0) + 45.0
    corners = np.clip(
        first_corner[:, None] + 90.0 * np.arange(4), left_deg[:, None], right_deg[:, None]
    )
    azimuths = np.concatenate([left_deg[:, None], corners, right_deg[:, None]], axis=1)
    du, dv = direction(azimuths, np)
    scale = _REACH / np.maximum(np.abs(du), np.abs(dv))
    ring = np.empty((len(u), 7, 2))
    ring[:, 0, 0], ring[:, 0, 1] = u, v
    ring[:, 1:, 0] = u[:, None] + scale * du
    ring[:, 1:, 1] = v[:, None] + scale * dv
    polygons = np.asarray(shapely.polygons(ring))
    whole = right_deg - left_deg >= 360.0
    polygons[whole] = shapely.box(
        u[whole] - _REACH, v[whole] - _REACH, u[whole] + _REACH, v[whole] + _REACH
    )
    return polygons


def cell_boxes(flat: NDArray[np.int64], cells: int) -> NDArray[np.object_]:
    """Cells of the tile, given by their flat indices i * L + j, as Shapely boxes."""
    i, j = np.divmod(flat, cells)
    return np.asarray(shapely.box(j / cells, i / cells, (j + 1) / cells, (i + 1) / cells))


def sector_fractions(u: Array, v: Array, left_deg: Array, right_deg: Array, cells: int) -> Array:
    """Share of each cell that lies in a sector, for a batch of sectors.

    Takes and gives what `slicemask.geometry.rays.sector_fractions` does, for NumPy arrays:
    cameras u, v [B], edge azimuths left_deg < right_deg <= left_deg + 360 [B]; float64 [B, L, L].
    """
    fractions = np.empty((len(u), cells * cells))
    step = max(1, _LATTICE_VALUES // (cells + 1) ** 2)
    for start in range(0, len(u), step):
        some = slice(start, start + step)
        batch = u[some], v[some], left_deg[some], right_deg[some]
        full, crossed = _classify(*batch, cells)
        fractions[some] = full.reshape(len(full), -1)
        which, cell = np.nonzero(crossed.reshape(len(full), -1))
        # Polygons and boxes are paired up and intersected in one vectorised call.
        # Cells are shared by many slices: their boxes are made once.
        some_cells, at = np.unique(cell, return_inverse=True)
        boxes = cell_boxes(some_cells, cells)[at]
        shares = shapely.area(shapely.intersection(sector_polygons(*batch)[which], boxes))
        fractions[start + which, cell] = shares * (cells * cells)
    return fractions.reshape(len(u), cells, cells)


def _classify(
    u: Array, v: Array, left_deg: Array, right_deg: Array, cells: int
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Cells wholly inside each sector, and cells that its edges may cross: bool [B, L, L]."""
    edges = np.arange(cells + 1) / cells
    x, y = edges - u[:, None], edges - v[:, None]

    def side(azimuth_deg: Array) -> Array:
        """Cross product of the ray and each lattice point: positive clockwise of the ray."""
        du, dv = direction(azimuth_deg, np)
        product: Any = (du[:, None] * y)[:, :, None] - (dv[:, None] * x)[:, None, :]
        return np.asarray(product)

    left, right = side(left_deg), side(right_deg)
    past_left, before_right = _all_corners(left >= 0.0), _all_corners(right <= 0.0)
    before_left, past_right = _all_corners(left <= 0.0), _all_corners(right >= 0.0)
    # Up to 180 degrees a sector is where two half-planes meet; beyond, where either holds.
    convex = (right_deg - left_deg <= 180.0)[:, None, None]
    whole = (right_deg - left_deg >= 360.0)[:, None, None]
    full = np.where(convex, past_left & before_right, past_left | before_right) | whole
    empty = np.where(convex, before_left | past_right, before_left & past_right) & ~whole
    return full, ~(full | empty)


def _all_corners(points: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether something holds at all four corners of each cell: [B, L + 1, L + 1] -> [B, L, L]."""
    rows = points[:, 1:] & points[:, :-1]
    return np.asarray(rows[:, :, 1:] & rows[:, :, :-1])
