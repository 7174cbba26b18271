"""From distinct slices to CSR rows, in pieces computed by threads and written in order."""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from slicemask.geometry.distinct import SectorOrbit
from slicemask.geometry.frustum import Frustum
from slicemask.geometry.masks import Engine, engine_fractions
from slicemask.geometry.noise import NEGLIGIBLE
from slicemask.geometry.symmetry import SYMMETRIES

# Cells of sectors' masks in a piece, at most: 1 MiB of float32, which a processor's cache holds.
_PIECE_VALUES = 1 << 18

_Piece = TypeVar("_Piece")
_Result = TypeVar("_Result")


@dataclass(frozen=True)
class Rows:
    """CSR rows.

    Parameters
    ----------
    counts : int64 [r]
        Nonzeros of each row.
    indices : int32 [nnz]
        Their cells, i * L + j, ascending in a row.
    data : float32 [nnz]
        Their fractions.
    """

    counts: NDArray[np.int64]
    indices: NDArray[np.int32]
    data: NDArray[np.float32]


def split_by_size(orbit: SectorOrbit, cells: int) -> Iterator[SectorOrbit]:
    """Split slices into pieces of bounded size; a sector's images stay together."""
    step = _piece_slices(orbit, cells)
    for start in range(0, len(orbit.u), step):
        sectors = slice(start, start + step)
        first, last = np.searchsorted(orbit.sector, [start, start + step])
        yield SectorOrbit(
            orbit.u[sectors],
            orbit.v[sectors],
            orbit.left_deg[sectors],
            orbit.right_deg[sectors],
            orbit.heading_deg[sectors],
            orbit.in_tile[sectors],
            orbit.sector[first:last] - start,
            orbit.symmetry[first:last],
        )


def _piece_slices(orbit: SectorOrbit, cells: int) -> int:
    bands: int = orbit.in_tile.shape[1]
    return max(1, _PIECE_VALUES // (cells**2 * bands))


def mask_rows(orbit: SectorOrbit, frustum: Frustum, cells: int, engine: Engine) -> list[Rows]:
    """Compute the sectors' masks, and return the rows of their images in order, in parts."""
    sectors = _sector_masks(orbit, frustum, cells, engine)
    # A few images at a time stay in the processor's cache.
    step = _piece_slices(orbit, cells)
    parts = [slice(start, start + step) for start in range(0, len(orbit.sector), step)]
    return [
        _image_rows(sectors, orbit.in_tile, orbit.sector[part], orbit.symmetry[part])
        for part in parts
    ]


def _sector_masks(
    orbit: SectorOrbit, frustum: Frustum, cells: int, engine: Engine
) -> NDArray[np.float32]:
    """Masks of the sectors, float32 [R, B, L, L], with rounding noise where they are near 0.

    Of slices that are equal wherever they are seen from, B is 1: they have no bands.
    """
    if orbit.in_tile.shape[1] == 1:
        frustum = replace(frustum, bands=())
    width_deg = orbit.right_deg - orbit.left_deg
    some = width_deg > 0.0
    if not frustum.bands:  # a whole tile needs no engine
        some &= width_deg < 360.0
    arguments = (orbit.u, orbit.v, orbit.left_deg, orbit.right_deg, orbit.heading_deg)
    # Rounding to float32 rounds noise near 1 away.
    if some.all():  # as nearly always: a copy would take longer than the masks themselves
        fractions = engine_fractions(engine, frustum)(*arguments, cells)
        return np.asarray(fractions.astype(np.float32))
    masks = np.zeros((*orbit.in_tile.shape, cells, cells), dtype=np.float32)
    if some.any():
        masks[some] = engine_fractions(engine, frustum)(*(x[some] for x in arguments), cells)
    if not frustum.bands:
        masks[width_deg == 360.0] = 1.0
    return masks


def _image_rows(
    sectors: NDArray[np.float32],
    in_tile: NDArray[np.bool_],
    sector: NDArray[np.int64],
    symmetry: NDArray[np.int64],
) -> Rows:
    """Rows of images of sectors' masks [R, B, L, L]: of the bands on the tile, in order."""
    # In the order of the symmetries, all images by one of them are made by one copy.
    order = np.argsort(symmetry, kind="stable")
    ends = np.searchsorted(symmetry[order], np.arange(len(SYMMETRIES) + 1))
    dense = sectors[sector[order]]
    moved = np.empty_like(dense)
    for image, (start, end) in zip(SYMMETRIES, pairwise(ends), strict=True):
        moved[start:end] = image.masks(dense[start:end])
    dense[order] = moved
    rows, kept = dense.reshape(-1, dense[0, 0].size), in_tile[sector].ravel()
    if not kept.all():
        rows = rows[kept]
    flat = rows.reshape(-1)
    at = np.flatnonzero(flat >= NEGLIGIBLE)
    starts = np.arange(len(rows) + 1) * rows.shape[1]
    counts = np.diff(np.searchsorted(at, starts))
    cell = at - np.repeat(starts[:-1], counts)
    return Rows(counts, cell.astype(np.int32), flat[at])


def map_ordered(
    compute: Callable[[_Piece], _Result],
    pieces: Iterator[tuple[float, _Piece]],
    pool: ThreadPoolExecutor,
    most_waiting: int,
) -> Iterator[tuple[float, _Result]]:
    """Compute pieces on threads, and yield the results in the order of the pieces.

    NumPy and Shapely release the interpreter's lock while they work: threads are enough.

    Parameters
    ----------
    compute : callable
        Called with each piece, on a thread.
    pieces : iterator of (float, piece)
        The pieces, each with the fraction of all work that is done after it, in [0, 1].
    pool : ThreadPoolExecutor
        The threads.
    most_waiting : int
        How many pieces may be submitted and not yet yielded, which bounds memory.

    Yields
    ------
    (float, result)
        The fraction of the piece, and its result.
    """
    waiting: deque[tuple[float, Future[_Result]]] = deque()
    for fraction_done, piece in pieces:
        waiting.append((fraction_done, pool.submit(compute, piece)))
        if len(waiting) > most_waiting:
            fraction_done, result = waiting.popleft()
            yield fraction_done, result.result()
    while waiting:
        fraction_done, result = waiting.popleft()
        yield fraction_done, result.result()
