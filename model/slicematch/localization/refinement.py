"""Poses finer than the candidates: from the modes of a scored grid, by steps and by gradients.

Ours; the paper answers with the best candidate. Masks are exact at any pose (the closed form of
`slicemask.slice_masks`), so scores are, and nothing ties an answer to a grid. A score is handed
in as a function of poses, whatever computes it (`slicematch.scoring.off_grid.PairScorer`).
"""

import math
from collections.abc import Callable
from typing import Literal, cast, get_args

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from slicemask import PoseGrid
from slicematch.errors import ConfigError
from slicematch.localization.likeliest import likeliest_first, likeliest_poses
from slicematch.localization.modes import grid_steps, non_maximum_suppression
from slicematch.priors import PosePrior

Refine = Literal["none", "mean", "fine", "continuous"]
# What `Localizer`, evaluate and predict do unless they are told otherwise.
DEFAULT: Refine = "mean"

# The modes that gradients climb from: the best ones.
CLIMBED = 2
# The finest step: of the place in metres or, where no resolution is known, in shares of the
# tile's side (0.28 m on a tile of VIGOR), and of the heading.
FINEST_M, FINEST_SHARE, FINEST_DEG = 0.25, 1 / 256, 0.5
# Evaluations of a score with its gradient in one ascent.
_MOST_EVALUATIONS = 30

# Scores [K] of poses [K, 3], float64; differentiable in the poses where gradients are asked for.
Score = Callable[[Tensor], Tensor]


def check_refine(refine: str) -> Refine:
    """Return the name of a refinement, or raise ConfigError if there is none of that name."""
    if refine not in get_args(Refine):
        raise ConfigError(f"refine is {refine!r}; it must be one of {', '.join(get_args(Refine))}")
    return cast(Refine, refine)


def refine_modes(
    score: Score,
    modes: NDArray[np.float64],
    grid: PoseGrid,
    prior: PosePrior,
    refine: Refine,
    tile_metres: float | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Refine the modes of a scored grid.

    Parameters
    ----------
    score : callable
        Scores of poses.
    modes : float64 [m, 3]
        What `find_modes` gives, in the prior.
    grid : PoseGrid
        That they were found on: its steps are where refinement begins, and along an axis of one
        value nothing is refined.
    prior : PosePrior
        Which no refined pose leaves.
    refine : {"fine", "continuous"}
        Coarse to fine (`coarse_to_fine`), or that and then by gradients (`gradient_ascent`) from
        the best modes.
    tile_metres : float, optional
        Side of the tile on the ground.

    Returns
    -------
    poses : float64 [at most m, 3]
        Best first; none scores below the mode it came from. Of modes that end within reach of
        each other the best one is kept (`non_maximum_suppression`).
    scores : float64 [at most m]
        Their scores.
    """
    share = FINEST_SHARE if tile_metres is None else FINEST_M / tile_metres
    steps = np.array(grid_steps(grid))
    finest = np.array([share, share, FINEST_DEG])
    poses = torch.from_numpy(modes)
    with torch.no_grad():
        scores = score(poses).double().cpu()
        poses, scores = coarse_to_fine(score, poses, scores, steps, finest, prior)
    if refine == "continuous":
        poses, scores = poses.clone(), scores.clone()
        for m in scores.argsort(descending=True)[:CLIMBED].tolist():
            poses[m], scores[m] = gradient_ascent(score, poses[m], np.minimum(steps, finest), prior)
    return non_maximum_suppression(poses.numpy(), scores.numpy(), grid)


def mean_modes(
    score: Score, probabilities: NDArray[np.float64], grid: PoseGrid, prior: PosePrior
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The likeliest poses (`likeliest_poses`), and their scores.

    Parameters
    ----------
    score : callable
        Scores of poses.
    probabilities : float64 [rows, columns, headings]
        Of the grid's candidates.
    grid : PoseGrid
        Where they stand.
    prior : PosePrior
        Which no pose leaves.

    Returns
    -------
    poses, scores : float64 [m, 3], [m]
        The likeliest first, whose score need not be the highest.
    """
    # A mean leaves the prior by rounding, or where it allows nearly all headings into the gap.
    allowed = prior.project(torch.from_numpy(likeliest_poses(probabilities, grid))).numpy()
    poses = likeliest_first(allowed, probabilities, grid)
    with torch.no_grad():
        values = score(torch.from_numpy(poses)).double().cpu().numpy()
    return poses, values


def coarse_to_fine(
    score: Score,
    poses: Tensor,
    scores: Tensor,
    steps: NDArray[np.float64],
    finest: NDArray[np.float64],
    prior: PosePrior,
) -> tuple[Tensor, Tensor]:
    """Move poses to the best of 3 x 3 x 3 around them, with steps that halve level by level.

    The first steps are half the grid's, the last ones the finest asked for; all levels together
    reach nearly a whole step of the grid.

    Parameters
    ----------
    score : callable
        Scores of poses; it is called for the poses around one pose at a time.
    poses, scores : float64 [m, 3], [m]
        Where to start.
    steps, finest : float64 [3]
        The grid's and the finest steps in u, v and heading. A grid's step that is fine enough
        already, or 0, is not halved.
    prior : PosePrior
        Poses outside it are moved onto its edge.

    Returns
    -------
    poses, scores : float64 [m, 3], [m]
        No score is below what it was.
    """
    halvings = np.log2(np.where(steps > finest, steps / finest, 1.0))
    for level in range(1, math.ceil(halvings.max() - 1e-9) + 1):
        step = np.where(steps > finest, np.maximum(steps / 2.0**level, finest), 0.0)
        axes = [torch.tensor([-size, 0.0, size] if size else [0.0]) for size in step.tolist()]
        around = torch.cartesian_prod(*(axis.double() for axis in axes))
        tried = [prior.project(pose + around) for pose in poses]
        found = [score(some).double().cpu().max(dim=0) for some in tried]
        values = torch.stack([best.values for best in found])
        moved = torch.stack([some[best.indices] for some, best in zip(tried, found, strict=True)])
        better = values > scores
        poses = torch.where(better[:, None], moved, poses)
        scores = torch.where(better, values, scores)
    return poses, scores


def gradient_ascent(
    score: Score, pose: Tensor, steps: NDArray[np.float64], prior: PosePrior
) -> tuple[Tensor, float]:
    """Go up from a pose to the top by L-BFGS-B, with the score's gradient in u, v and heading.

    Parameters
    ----------
    score : callable
        Scores of poses, differentiable.
    pose : float64 [3]
        Where to start.
    steps : float64 [3]
        The scale of each axis; one of 0 is held.
    prior : PosePrior
        Which no pose leaves.

    Returns
    -------
    pose : float64 [3]
        The best pose found; the start if no better one was.
    score : float
        Its score.
    """
    from scipy.optimize import minimize  # here: it takes 0.1 s, and few answers climb

    start = pose.numpy()
    scale = np.where(steps > 0, steps, 1.0)
    best_pose, best_score = pose, -math.inf

    def descend(x: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        nonlocal best_pose, best_score
        # Gradients are needed here, whether or not the caller keeps any.
        with torch.inference_mode(False), torch.enable_grad():
            at = torch.from_numpy(start + x * scale)[None].requires_grad_()
            inside = prior.project(at)
            value = score(inside)[0]
            (gradient,) = torch.autograd.grad(value, at)
        if value.item() > best_score:
            best_pose, best_score = inside.detach()[0], value.item()
        return -value.item(), -gradient[0].double().cpu().numpy() * scale

    u0, v0, u1, v1 = prior.extent
    low = (np.array([u0, v0, -np.inf]) - start) / scale
    high = (np.array([u1, v1, np.inf]) - start) / scale
    low, high = np.where(steps > 0, low, 0.0), np.where(steps > 0, high, 0.0)
    minimize(
        descend,
        np.zeros(3),
        jac=True,
        method="L-BFGS-B",
        bounds=np.stack([low, high], axis=1),
        options={"maxfun": _MOST_EVALUATIONS},
    )
    return best_pose, best_score
