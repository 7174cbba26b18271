"""Negatives off the training grid; both kinds are ours, and off unless a run asks for them.

A model that only ever sees the poses of one grid as negatives learns how they differ from the
truth, and little of what lies between them, where refinement looks.
"""

import tempfile
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from slicemask import Frustum, PoseGrid, build_bank, open_bank
from slicematch.localization.modes import grid_steps
from slicematch.priors import PosePrior
from slicematch.scoring.candidates import Candidates

# How many offsets of the grid a run draws from: banks of them are built at its start.
OFFSETS = 16


def jittered_candidates(
    poses: NDArray[np.float64],
    grid: PoseGrid,
    prior: PosePrior,
    frustum: Frustum,
    cells: int,
    seed: int,
) -> list[Candidates]:
    """The candidates of a grid, moved and turned together: once for each of 16 random offsets.

    Parameters
    ----------
    poses : float64 [K, 3]
        The grid's candidates within the priors.
    grid : PoseGrid
        An offset is at most half its step to either side, along each axis, so that all offsets
        together fill its cells.
    prior : PosePrior
        Which jittered candidates do not leave. A known heading stays.
    frustum, cells
        Of the masks.
    seed : int
        The offsets are drawn from it alone.
    """
    offsets = np.random.default_rng([seed, OFFSETS]).uniform(-0.5, 0.5, (OFFSETS, 3))
    offsets *= grid_steps(grid)
    if prior.heading_prior is not None:
        half_width = prior.heading_prior[1]
        offsets[:, 2] = np.clip(offsets[:, 2], -half_width, half_width)
    jittered = []
    with tempfile.TemporaryDirectory() as folder:
        for number, offset in enumerate(offsets):
            moved = prior.project(torch.from_numpy(poses + offset)).numpy()
            out = Path(folder, f"{number}.h5")
            with open_bank(build_bank(moved, frustum, cells, engine="rays", out=out).path) as bank:
                jittered.append(Candidates.from_bank(bank))
    return jittered


def near_poses(truths: Tensor, count: int, grid: PoseGrid, prior: PosePrior) -> Tensor:
    """Poses at random within one step of the grid of true ones, to either side along each axis.

    Drawn from torch's own random state, on the CPU.

    Parameters
    ----------
    truths : float64 [B, 3]
        True poses.
    count : int
        Poses around each.
    grid : PoseGrid
        The training grid.
    prior : PosePrior
        Which the poses do not leave.

    Returns
    -------
    poses : float64 [B, count, 3]
    """
    shares = torch.rand(len(truths), count, 3, dtype=truths.dtype, device="cpu")
    offsets = (2.0 * shares - 1.0).to(truths) * truths.new_tensor(grid_steps(grid))
    return prior.project((truths[:, None] + offsets).flatten(0, 1)).unflatten(0, (-1, count))
