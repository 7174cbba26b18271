"""Modes: the peaks of a scored grid, each beyond reach of every better one."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slicemask import PoseGrid
from slicematch.angles import angle_difference_deg
from slicematch.errors import RunError

# Modes that are kept.
MODES = 5
# Poses nearer to each other than this are one answer, in shares of the tile's side and degrees.
REACH, REACH_DEG = 0.1, 30.0
# Candidates that stand on the edge of that are within reach.
ROUNDING = 1e-9


@dataclass(frozen=True)
class Mode:
    """One answer among several: a peak of the scores, or where probability gathers.

    Attributes
    ----------
    pose : float64 [3]
        u, v, heading_deg.
    score : float
        Its score, a cosine in [-1, 1].
    probability : float
        That the camera is within reach of it: the candidates there, less those that a better
        mode has, count together.
    """

    pose: NDArray[np.float64]
    score: float
    probability: float


def within_reach(
    pose: NDArray[np.float64],
    poses: NDArray[np.float64],
    grid: PoseGrid,
    side: float = 1.0,
) -> NDArray[np.bool]:
    """Which poses are one answer with a pose: those within reach of it (`reach_of`).

    Parameters
    ----------
    pose : float64 [3]
        u, v, heading_deg.
    poses : float64 [K, 3]
        Likewise.
    grid : PoseGrid
        Of the candidates.
    side : float
        Side of what is searched, in shares of the tile's side.

    Returns
    -------
    within : bool [K]
    """
    near, turned = _within(pose, poses[:, :2], poses[:, 2], reach_of(grid, side))
    return near & turned


def candidates_within_reach(pose: NDArray[np.float64], grid: PoseGrid) -> NDArray[np.bool]:
    """Which candidates of a grid are one answer with a pose: `within_reach` of all its poses, [K].

    Places and headings are looked at by themselves, which is many times as fast.
    """
    near, turned = axes_within_reach(pose, grid)
    return np.logical_and(near[:, None], turned).ravel()


def axes_within_reach(
    pose: NDArray[np.float64], grid: PoseGrid
) -> tuple[NDArray[np.bool], NDArray[np.bool]]:
    """Which places [rows * columns] and which headings [headings] of a grid are within reach."""
    places = np.stack(np.broadcast_arrays(grid.u, grid.v[:, None]), axis=-1).reshape(-1, 2)
    return _within(pose, places, grid.headings_deg, reach_of(grid))


def reach_of(grid: PoseGrid, side: float = 1.0) -> tuple[float, float]:
    """How far apart poses may be that are one answer: in place, and in degrees of heading.

    A tenth of the side that is searched and 30 degrees, or one and a half steps of a grid that is
    coarser than that.
    """
    step_u, step_v, step_deg = grid_steps(grid)
    return max(REACH * side, 1.5 * max(step_u, step_v)), max(REACH_DEG, 1.5 * step_deg)


def _within(
    pose: NDArray[np.float64],
    places: NDArray[np.float64],
    headings_deg: NDArray[np.float64],
    reach: tuple[float, float],
) -> tuple[NDArray[np.bool], NDArray[np.bool]]:
    """Which places [p, 2], and which headings [h], are within reach of a pose."""
    near = np.hypot(*(places - pose[:2]).T) <= reach[0] + ROUNDING
    return near, np.abs(angle_difference_deg(headings_deg, pose[2])) <= reach[1] + ROUNDING


def grid_steps(grid: PoseGrid) -> tuple[float, float, float]:
    """The grid's steps in u, v and heading; 0 along an axis of one value, which is known."""
    step_u, step_v = (float(at[1] - at[0]) if len(at) > 1 else 0.0 for at in (grid.u, grid.v))
    return step_u, step_v, 360.0 / grid.headings if grid.headings > 1 else 0.0


def find_modes(
    scores: NDArray[np.float32], grid: PoseGrid, most: int = MODES
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The modes of a scored grid: its best candidate and the next best peaks away from it.

    A peak scores no less than its neighbours in the grid; those within reach (`within_reach`) of a
    better one are passed over.

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
    check_scores(scores)
    peaks = np.flatnonzero(np.isfinite(scores) & (scores == _highest_around(scores)))
    row, column, heading = np.unravel_index(peaks, grid.shape)
    poses = np.stack([grid.u[column], grid.v[row], grid.headings_deg[heading]], axis=1)
    return non_maximum_suppression(poses, scores.ravel()[peaks].astype(np.float64), grid, most)


def check_scores(scores: NDArray[np.float32]) -> None:
    """Refuse scores of a grid among which no answer can be found.

    Raises
    ------
    RunError
        If one is NaN or infinite, or a prior left every candidate out.
    """
    best = scores.max()  # NaN, if there is any
    if not np.isfinite(best):
        raise RunError(
            f"the best score is {best}; it must be finite, but the model's weights or features are "
            "not: take another checkpoint, train again with a smaller learning rate, or, where the "
            "precision is 16-mixed, choose bf16-mixed"
        )


def _highest_around(scores: NDArray[np.float32]) -> NDArray[np.float32]:
    """The highest score of each candidate and its 26 neighbours; headings go round.

    scipy's filter does the same, but its import is a twentieth of the time to the first answer.
    """
    highest = np.pad(scores, ((1, 1), (1, 1), (0, 0)), constant_values=-np.inf)
    highest = np.maximum(highest, np.maximum(np.roll(highest, 1, 2), np.roll(highest, -1, 2)))
    highest = np.maximum(highest[1:-1], np.maximum(highest[:-2], highest[2:]))
    return np.maximum(highest[:, 1:-1], np.maximum(highest[:, :-2], highest[:, 2:]))


def non_maximum_suppression(
    poses: NDArray[np.float64], scores: NDArray[np.float64], grid: PoseGrid, most: int = MODES
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Of poses [K, 3] and their scores [K] those that are modes: `most` of them, best first.

    One within reach (`within_reach`) of a better one is the same answer, and is left out.
    """
    # A stable order: of equal scores the first pose, as argmax has it.
    left = np.argsort(-scores, kind="stable")
    modes: list[int] = []
    while len(left) and len(modes) < most:
        modes.append(left[0])
        left = left[~within_reach(poses[left[0]], poses[left], grid)]
    return poses[modes], scores[modes]
