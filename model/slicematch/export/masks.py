"""Masks of candidates as plain arrays in blocks, which a graph goes through one by one."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slicematch.scoring.candidates import Candidates

# Cells of one block: their features, of 64 channels, are what a processor's cache holds.
_CELLS_AT_ONCE = 1 << 14
# Into how many tables a band's masks are sorted by their numbers of cells, so that little is
# padding.
TABLES = 4


@dataclass(frozen=True)
class MaskTables:
    """The masks of candidates, in tables of masks of about as many cells; by `mask_tables`.

    Band b of a slice has `TABLES` tables, b * TABLES and those that follow it. Table t holds G_t
    blocks of R_t masks of at most m_t cells; what is left over is cell 0 with weight 0.

    Parameters
    ----------
    cells : list of int32 [G_t, R_t, m_t]
        Flat cells.
    weights : list of float32 [G_t, R_t, m_t]
        What part of its mask a cell is: those of a mask sum to 1, or to 0 if it is empty.
    index : int32 [K, N, B]
        Which mask, counted through the tables of its band, is that of band b of slice n of pose
        k. Leaving out some of its rows leaves out those candidates.
    """

    cells: list[NDArray[np.int32]]
    weights: list[NDArray[np.float32]]
    index: NDArray[np.int32]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays by the names of a graph's inputs: index, cells0, ..., weights0, ..."""
        return {
            "index": self.index,
            **{f"cells{t}": table for t, table in enumerate(self.cells)},
            **{f"weights{t}": table for t, table in enumerate(self.weights)},
        }


def mask_tables(candidates: Candidates) -> MaskTables:
    """The masks of candidates in tables.

    Parameters
    ----------
    candidates : Candidates
        K poses.

    Returns
    -------
    tables : MaskTables
        `TABLES` of them a band.
    """
    slices = candidates.index.shape[1]
    found = MaskTables([], [], np.empty(candidates.index.shape, np.int32))
    for band, plan in enumerate(candidates.shared_plans):
        starts, cells, weights = (part.numpy(force=True) for part in plan.masks)
        lengths = np.diff(starts)
        row = np.empty(len(lengths), np.int32)
        first = 0
        for masks in np.array_split(np.argsort(lengths, kind="stable"), TABLES):
            width = max(1, int(lengths[masks].max(initial=0)))
            rows = max(1, min(len(masks), _CELLS_AT_ONCE // width))
            shape = max(1, -(-len(masks) // rows)), rows, width
            inside = np.arange(width) < lengths[masks, None]
            at = (starts[masks, None] + np.arange(width))[inside]
            for tables, values in ((found.cells, cells), (found.weights, weights)):
                table = np.zeros((shape[0] * rows, width), values.dtype)
                table[: len(masks)][inside] = values[at]
                tables.append(table.reshape(shape).astype(values.dtype))
            row[masks] = first + np.arange(len(masks))
            first += shape[0] * rows
        found.index[:, :, band] = row[plan.slot.numpy(force=True) // slices]
    return found
