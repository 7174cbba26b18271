"""Poses finer than the candidates: from the modes of a scored grid, by steps and by gradients.

Ours; the paper answers with the best candidate. Masks are exact at any pose (the closed form of
`slicemask.slice_masks`), so scores are, and nothing ties an answer to a grid. A score is handed
in as a function of poses, whatever computes it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from scipy.optimize import minimize
from torch import Tensor

from slicemask import Frustum, PoseGrid, slice_masks
from slicematch.errors import ConfigError, RunError
from slicematch.evaluation.metrics import turn_deg
from slicematch.network.aggregation import unit

Refine = Literal["none", "mean", "fine", "continuous"]
# What `Localizer`, evaluate and predict do unless they are told otherwise.
DEFAULT: Refine = "mean"

# Modes that are kept, and those of them that gradients climb from.
MODES, CLIMBED = 5, 2
# The finest step: of the place in metres or, where no resolution is known, in shares of the
# tile's side (0.28 m on a tile of VIGOR), and of the heading.
FINEST_M, FINEST_SHARE, FINEST_DEG = 0.25, 1 / 256, 0.5
# Poses nearer to each other than this are one answer, in shares of the tile's side and degrees.
REACH, REACH_DEG = 0.1, 30.0
# Evaluations of a score with its gradient in one climb.
_MOST_EVALUATIONS = 30

# Scores [K] of poses [K, 3], float64; differentiable in the poses where gradients are asked for.
Score = Callable[[Tensor], Tensor]


def check_refine(refine: str) -> Refine:
    """Return the name of a refinement, or raise ConfigError if there is none of that name."""
    if refine not in get_args(Refine):
        raise ConfigError(f"refine is {refine!r}; it must be one of {', '.join(get_args(Refine))}")
    return refine


@dataclass(frozen=True)
class Domain:
    """Where a camera may be, and how it may look.

    Parameters
    ----------
    extent : (u0, v0, u1, v1)
        Places, in the aerial frame.
    heading_prior : (centre, half_width) or None
        Only headings within half_width of the centre; None for any.
    place_prior : (u, v, radius) or None
        Only places within the radius of (u, v).
    """

    extent: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)
    heading_prior: tuple[float, float] | None = None
    place_prior: tuple[float, float, float] | None = None

    def project(self, poses: Tensor) -> Tensor:
        """The poses moved into the domain, headings in [0, 360): [K, 3], differentiable."""
        places, headings = poses[:, :2], poses[:, 2]
        low, high = (places.new_tensor(self.extent[start : start + 2]) for start in (0, 2))
        places = torch.maximum(torch.minimum(places, high), low)
        if self.place_prior is not None:
            *centre, radius = self.place_prior
            middle = places.new_tensor(centre)
            # Towards the extent's place that is nearest to the prior's centre, and so is in both;
            # on the way to it a place stays in the extent.
            nearest = torch.maximum(torch.minimum(middle, high), low)
            away, offset = places - nearest, nearest - middle
            # The share of the way out that the prior allows: |offset + share * away| = radius. The
            # least values keep the gradient finite where nothing is left of the way.
            square = away.square().sum(dim=1, keepdim=True).clamp_min(1e-60)
            along = (away * offset).sum(dim=1, keepdim=True)
            beyond = offset.square().sum() - radius**2
            root = (along.square() - square * beyond).clamp_min(1e-60).sqrt()
            places = nearest + away * ((root - along) / square).clamp(0.0, 1.0)
        if self.heading_prior is not None:
            centre_deg, half_width = self.heading_prior
            turn = turn_deg(headings, centre_deg)
            headings = centre_deg + turn.clamp(-half_width, half_width)
        headings = torch.remainder(headings, 360.0)
        # A tiny negative heading wraps to 360 itself.
        headings = torch.where(headings < 360.0, headings, headings - 360.0)
        return torch.cat([places, headings[:, None]], dim=1)


def near(pose: NDArray[np.float64], poses: NDArray[np.float64], grid: PoseGrid) -> NDArray[np.bool]:
    """Which poses [K, 3] are one answer with a pose [3]: those within reach of it.

    The reach is a tenth of the tile's side and 30 degrees, or one and a half steps of a grid that
    is coarser than that.
    """
    step_u, step_v, step_deg = grid_steps(grid)
    place = np.hypot(*(poses[:, :2] - pose[:2]).T) <= max(REACH, 1.5 * max(step_u, step_v))
    return place & (np.abs(turn_deg(poses[:, 2], pose[2])) <= max(REACH_DEG, 1.5 * step_deg))


def grid_steps(grid: PoseGrid) -> tuple[float, float, float]:
    """The grid's steps in u, v and heading; 0 along an axis of one value, which is known."""
    step_u, step_v = (float(at[1] - at[0]) if len(at) > 1 else 0.0 for at in (grid.u, grid.v))
    return step_u, step_v, 360.0 / grid.headings if grid.headings > 1 else 0.0


def find_modes(
    scores: NDArray[np.float32], grid: PoseGrid, most: int = MODES
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The modes of a scored grid: its best candidate and the next best peaks away from it.

    A peak scores no less than its neighbours in the grid; those within reach (`near`) of a better
    one are passed over.

    Parameters
    ----------
    scores : float [rows, columns, headings]
        -inf where a prior left a candidate out.
    grid : PoseGrid
        Where they stand.
    most : int
        How many modes to keep.

    Returns
    -------
    poses : float64 [m, 3]
        Best first; at least one.
    scores : float64 [m]
        Their scores.

    Raises
    ------
    RunError
        If a score is NaN or infinite, or a prior left every candidate out.
    """
    best = scores.max()  # NaN, if there is any
    if not np.isfinite(best):
        raise RunError(
            f"the best score is {best}; it must be finite, but the model's weights or features are "
            "not: take another checkpoint, train anew with a smaller learning rate, or, where the "
            "precision is 16-mixed, choose bf16-mixed"
        )
    highest = maximum_filter(scores, size=3, mode=("constant", "constant", "wrap"), cval=-np.inf)
    peaks = np.flatnonzero(np.isfinite(scores) & (scores == highest))
    row, column, heading = np.unravel_index(peaks, grid.shape)
    poses = np.stack([grid.u[column], grid.v[row], grid.headings_deg[heading]], axis=1)
    return keep_apart(poses, scores.ravel()[peaks].astype(np.float64), grid, most)


def keep_apart(
    poses: NDArray[np.float64], scores: NDArray[np.float64], grid: PoseGrid, most: int = MODES
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Of poses [K, 3] and their scores [K] those that are modes: `most` of them, best first.

    One within reach (`near`) of a better one is the same answer, and is left out.
    """
    # A stable order: of equal scores the first pose, as argmax has it.
    left = np.argsort(-scores, kind="stable")
    modes: list[int] = []
    while len(left) and len(modes) < most:
        modes.append(left[0])
        left = left[~near(poses[left[0]], poses[left], grid)]
    return poses[modes], scores[modes]


def refine_modes(
    score: Score,
    modes: NDArray[np.float64],
    grid: PoseGrid,
    domain: Domain,
    refine: Refine,
    tile_metres: float | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Refine the modes of a scored grid.

    Parameters
    ----------
    score : callable
        Scores of poses.
    modes : float64 [m, 3]
        What `find_modes` gives, in the domain.
    grid : PoseGrid
        That they were found on: its steps are where refinement begins, and along an axis of one
        value nothing is refined.
    domain : Domain
        Which no refined pose leaves.
    refine : {"fine", "continuous"}
        Coarse to fine (`coarse_to_fine`), or that and then by gradients (`climb`) from the best
        modes.
    tile_metres : float, optional
        Side of the tile on the ground.

    Returns
    -------
    poses : float64 [at most m, 3]
        Best first; none scores below the mode it came from. Of modes that end within reach of
        each other the best one is kept (`keep_apart`).
    scores : float64 [at most m]
        Their scores.
    """
    share = FINEST_SHARE if tile_metres is None else FINEST_M / tile_metres
    steps = np.array(grid_steps(grid))
    finest = np.array([share, share, FINEST_DEG])
    poses = torch.from_numpy(modes)
    with torch.no_grad():
        scores = score(poses).double().cpu()
        poses, scores = coarse_to_fine(score, poses, scores, steps, finest, domain)
    if refine == "continuous":
        poses, scores = poses.clone(), scores.clone()
        for m in scores.argsort(descending=True)[:CLIMBED].tolist():
            poses[m], scores[m] = climb(score, poses[m], np.minimum(steps, finest), domain)
    return keep_apart(poses.numpy(), scores.numpy(), grid)


def coarse_to_fine(
    score: Score,
    poses: Tensor,
    scores: Tensor,
    steps: NDArray[np.float64],
    finest: NDArray[np.float64],
    domain: Domain,
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
    domain : Domain
        Poses outside it are moved onto its edge.

    Returns
    -------
    poses, scores : float64 [m, 3], [m]
        No score is below what it was.
    """
    halvings = np.log2(np.where(steps > finest, steps / finest, 1.0))
    for level in range(1, math.ceil(halvings.max() - 1e-9) + 1):
        step = np.where(steps > finest, np.maximum(steps / 2.0**level, finest), 0.0)
        axes = [torch.tensor([-one, 0.0, one] if one else [0.0]) for one in step.tolist()]
        around = torch.cartesian_prod(*(axis.double() for axis in axes))
        tried = [domain.project(pose + around) for pose in poses]
        found = [score(some).double().cpu().max(dim=0) for some in tried]
        values = torch.stack([best.values for best in found])
        moved = torch.stack([some[best.indices] for some, best in zip(tried, found, strict=True)])
        better = values > scores
        poses = torch.where(better[:, None], moved, poses)
        scores = torch.where(better, values, scores)
    return poses, scores


def climb(
    score: Score, pose: Tensor, steps: NDArray[np.float64], domain: Domain
) -> tuple[Tensor, float]:
    """Climb from a pose to the top by L-BFGS-B, with the score's gradient in u, v and heading.

    Parameters
    ----------
    score : callable
        Scores of poses, differentiable.
    pose : float64 [3]
        Where to start.
    steps : float64 [3]
        The scale of each axis; one of 0 is held.
    domain : Domain
        Which the climb does not leave.

    Returns
    -------
    pose : float64 [3]
        The best pose found; the start if no better one was.
    score : float
        Its score.
    """
    start = pose.numpy()
    scale = np.where(steps > 0, steps, 1.0)
    best_pose, best_score = pose, -math.inf

    def descend(x: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        nonlocal best_pose, best_score
        # Gradients are needed here, whether or not the caller keeps any.
        with torch.inference_mode(False), torch.enable_grad():
            at = torch.from_numpy(start + x * scale)[None].requires_grad_()
            inside = domain.project(at)
            value = score(inside)[0]
            (gradient,) = torch.autograd.grad(value, at)
        if value.item() > best_score:
            best_pose, best_score = inside.detach()[0], value.item()
        return -value.item(), -gradient[0].double().cpu().numpy() * scale

    u0, v0, u1, v1 = domain.extent
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


@dataclass(frozen=True)
class Similarity:
    """The score of any poses for one pair of images, on or off a grid: a `Score`.

    Equal to `slicematch.scoring.scores.score_masks`. The poses of a call should lie near each
    other: a slice is then pooled over the few cells that any of them needs.

    Parameters
    ----------
    ground : float [N, C]
        d_g^n, of unit length or zero.
    features : float [C, L, L]
        z_a.
    attention : float [N, L, L]
        M_a^n.
    frustum : Frustum
        Of the ground image.
    """

    ground: Tensor
    features: Tensor
    attention: Tensor
    frustum: Frustum

    def __post_init__(self) -> None:
        # Tensors made in inference mode take no part in gradients; copies made outside it do.
        with torch.inference_mode(False):
            for name in ("ground", "features", "attention"):
                tensor = getattr(self, name)
                if tensor.is_inference():
                    object.__setattr__(self, name, tensor.clone())

    def __call__(self, poses: Tensor) -> Tensor:
        """Poses float64 [K, 3] to scores float [K], differentiable in the poses."""
        device, cells = self.features.device, self.features.shape[-1]
        with torch.autocast(device.type, enabled=False):
            ground = self.ground.float()
            masks = slice_masks(poses.to(device), self.frustum, cells, engine="rays").flatten(2)
            masks = masks.float()  # [K, N, L * L]
            columns = self.features.flatten(1).T  # [L * L, C]
            attention = self.attention.flatten(1)
            dots, there = ground.new_zeros(len(poses)), ground.new_zeros(len(poses))
            for n, seen in enumerate((masks.detach() > 0).any(dim=0)):
                some = seen.nonzero()[:, 0]
                pooled = (masks[:, n, some] * attention[n, some].float()) @ columns[some].float()
                descriptors = unit(pooled)  # d_a^{k,n}, [K, C]
                dots = dots + descriptors @ ground[n]
                there = there + (descriptors.detach() != 0).any(dim=1)
            lengths = there.sqrt() * ground.square().sum().sqrt()
            return dots / torch.where(lengths > 0, lengths, 1.0)
