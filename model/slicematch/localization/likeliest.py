"""The likeliest answers: the poses with the most probability within reach of them.

Ours. If an answer counts as right when the camera is within reach of it, the first one is right
most often of all, but for little. The best candidate need not be near it: many that are nearly as
good side by side make a likelier answer than one that stands alone.
"""

import math

import numpy as np
from numpy.typing import NDArray

from slicemask import PoseGrid
from slicematch.localization.modes import (
    MODES,
    ROUNDING,
    candidates_within_reach,
    grid_steps,
    non_maximum_suppression,
    reach_of,
    within_reach,
)
from slicematch.localization.probabilities import mean_pose, mode_probabilities

# How often an answer moves to the mean of what is within reach of it; further moves are small.
_MOVES = 3
# The share of the probability within reach that it may not lose by that.
_LOST = 0.1
# Sums of probabilities that differ by less are equal but for rounding.
_EQUAL = 1e-12


def likeliest_poses(
    probabilities: NDArray[np.float64], grid: PoseGrid, most: int = MODES
) -> NDArray[np.float64]:
    """The poses with the most probability within reach, moved to the mean of what is there.

    One starts at the candidate with the most probability within reach, and moves three times to the
    mean of the candidates within reach, by their probabilities: mean shift (Comaniciu and Meer,
    *Mean Shift: A Robust Approach Toward Feature Space Analysis*, PAMI 2002), as long as nine
    tenths of that probability stay within reach. The next one is found likewise among what is
    beyond reach of it, and so on.

    Parameters
    ----------
    probabilities : float64 [rows, columns, headings]
        Of the grid's candidates, 1 in all.
    grid : PoseGrid
        Where they stand.
    most : int
        How many poses to find.

    Returns
    -------
    poses : float64 [m, 3]
        u, v, heading_deg, which is not wrapped: at least one, as `likeliest_first` orders them.
    """
    left = np.array(probabilities, order="C")  # a copy, which `ravel` shows and does not copy
    candidates = grid.poses()
    free = np.ones(len(candidates), dtype=bool)  # to start from
    mass = mass_within_reach(left, grid).ravel()
    found: list[NDArray[np.float64]] = []
    while (highest := mass[free].max(initial=0.0)) > _EQUAL:
        equal = np.flatnonzero(free & (mass > highest - _EQUAL))
        start = candidates[equal[left.ravel()[equal].argmax()]]
        pose = _moved(start, (1.0 - _LOST) * highest, left, grid)
        free &= ~candidates_within_reach(start, grid)
        if found and within_reach(pose, np.array(found), grid).any():
            continue  # what is left around a likelier one
        found.append(pose)
        if len(found) == most:
            break
        around = candidates_within_reach(pose, grid)
        left.ravel()[around] = 0.0
        free &= ~around
        mass = mass_within_reach(left, grid).ravel()
    return likeliest_first(np.array(found), probabilities, grid)


def likeliest_first(
    poses: NDArray[np.float64], probabilities: NDArray[np.float64], grid: PoseGrid
) -> NDArray[np.float64]:
    """Poses in the order of their probabilities, each of them beyond reach of those before it.

    Parameters
    ----------
    poses : float64 [m, 3]
        In any order.
    probabilities : float64 [rows, columns, headings]
        Of the grid's candidates.
    grid : PoseGrid

    Returns
    -------
    poses : float64 [at most m, 3]
        Their `mode_probabilities` do not rise. One within reach of a likelier one is left out.
    """
    while True:
        # What several have within reach is the first one's, so that another order changes them: but
        # each time those that come first have more.
        likely = mode_probabilities(poses, probabilities, grid)
        ordered, _ = non_maximum_suppression(poses, likely, grid, len(poses))
        if len(ordered) == len(poses) and (ordered == poses).all():
            return poses
        poses = ordered


def _moved(
    pose: NDArray[np.float64], least: float, left: NDArray[np.float64], grid: PoseGrid
) -> NDArray[np.float64]:
    """A pose moved to the mean of what is within reach of it, with so much within reach."""
    for _ in range(_MOVES):
        mean = mean_pose(pose, left, grid)
        if left.ravel()[candidates_within_reach(mean, grid)].sum() < least:
            break
        pose = mean
    return pose


def mass_within_reach(probabilities: NDArray[np.float64], grid: PoseGrid) -> NDArray[np.float64]:
    """The probability of all candidates within reach of each: float64 [rows, columns, headings]."""
    step_u, step_v, step_deg = grid_steps(grid)
    reach, reach_deg = reach_of(grid)
    steps = _steps(reach_deg, step_deg)
    if 2 * steps + 1 >= grid.headings:
        turned = np.repeat(probabilities.sum(axis=2, keepdims=True), grid.headings, axis=2)
    else:
        around = np.pad(probabilities, ((0, 0), (0, 0), (steps, steps)), mode="wrap")
        turned = _sums(_summed(around.swapaxes(1, 2)), steps, steps).swapaxes(1, 2)
    # What is within reach is a disc of places: row by row of it, as far as the grid goes.
    widest, rows = min(_steps(reach, step_u), grid.columns - 1), grid.rows
    summed = _summed(np.pad(turned, ((0, 0), (widest, widest), (0, 0))))
    total = np.zeros_like(turned)
    lowest = min(_steps(reach, step_v), rows - 1)
    for down in range(-lowest, lowest + 1):
        across = math.sqrt(max(reach**2 - (down * step_v) ** 2, 0.0))
        first, last = max(-down, 0), rows - max(down, 0)
        part = summed[first + down : last + down]
        total[first:last] += _sums(part, min(_steps(across, step_u), widest), widest)
    return total


def _steps(reach: float, step: float) -> int:
    """How many steps are within reach; none along an axis of one value."""
    return int((reach + ROUNDING) / step) if step > 0 else 0


def _summed(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sums along the second axis of all values before each, and of all."""
    return np.pad(values.cumsum(axis=1), ((0, 0), (1, 0), (0, 0)))


def _sums(summed: NDArray[np.float64], steps: int, margin: int) -> NDArray[np.float64]:
    """Sums up to so many steps to either side of each value, but for those of the margins."""
    size = summed.shape[1] - 1 - 2 * margin
    before, after = margin - steps, margin + steps + 1
    return summed[:, after : after + size] - summed[:, before : before + size]
