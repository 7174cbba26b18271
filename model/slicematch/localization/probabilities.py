"""How sure an estimate is: probabilities of candidates, and how they spread.

Ours. Scores become probabilities by a softmax, p_k = exp(c_k / T) / sum exp(c / T), with one
temperature T for all images, fitted afterwards (temperature scaling: Guo, Pleiss, Sun,
Weinberger, *On Calibration of Modern Neural Networks*, ICML 2017, section 4.2).
"""

import math

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from slicemask import PoseGrid
from slicematch.angles import angle_difference_deg
from slicematch.localization.modes import (
    axes_within_reach,
    candidates_within_reach,
    grid_steps,
)

# The share of probability that a region of places or an ellipse is to hold.
CONFIDENCE = 0.95


def probabilities(scores: ArrayLike, temperature: float) -> NDArray[np.float64]:
    """Probabilities of candidates, of any shape and 1 in all; 0 where the score is -inf.

    Examples
    --------
    >>> probabilities([0.5, 0.5, -np.inf], temperature=0.1)
    array([0.5, 0.5, 0. ])
    """
    scaled = np.asarray(scores, dtype=np.float64) / temperature
    # torch's, since it is there: scipy's takes a tenth of a second to import.
    return np.asarray(torch.from_numpy(scaled.ravel()).softmax(0).numpy().reshape(scaled.shape))


def credible_region(place_map: ArrayLike, confidence: float = CONFIDENCE) -> NDArray[np.bool]:
    """The fewest places that hold the confidence together, the likeliest first.

    Parameters
    ----------
    place_map : float [rows, columns]
        Probabilities of places, 1 in all.
    confidence : float
        In (0, 1].

    Returns
    -------
    region : bool [rows, columns]

    Examples
    --------
    >>> credible_region([[0.6, 0.3], [0.08, 0.02]], 0.9)
    array([[ True,  True],
           [False, False]])
    """
    places = np.asarray(place_map, dtype=np.float64)
    order = np.argsort(-places, axis=None, kind="stable")
    before = np.cumsum(places.ravel()[order]) - places.ravel()[order]
    held = np.zeros(places.size, dtype=bool)
    held[order] = before < confidence - 1e-12
    return held.reshape(places.shape)


def mode_probabilities(
    modes: NDArray[np.float64], probabilities: NDArray[np.float64], grid: PoseGrid
) -> NDArray[np.float64]:
    """Probabilities of modes: of the candidates within reach of each and of none before it.

    Parameters
    ----------
    modes : float64 [m, 3]
        Best first.
    probabilities : float64 [rows, columns, headings]
        Of the grid's candidates.
    grid : PoseGrid

    Returns
    -------
    probabilities : float64 [m]
        Together at most 1; what is missing lies near none of the modes.
    """
    left = probabilities.ravel().copy()
    found = np.empty(len(modes))
    for m, mode in enumerate(modes):
        around = candidates_within_reach(mode, grid)
        found[m] = left[around].sum()
        left[around] = 0.0
    return found


def mean_pose(
    pose: NDArray[np.float64], probabilities: NDArray[np.float64], grid: PoseGrid
) -> NDArray[np.float64]:
    """The mean of the candidates within reach of a pose, by their probabilities.

    Of all poses it has the least expected squared error, in place and in heading, if the camera is
    within reach of the one handed in.

    Parameters
    ----------
    pose : float64 [3]
        u, v, heading_deg.
    probabilities : float64 [rows, columns, headings]
        Of the grid's candidates.
    grid : PoseGrid

    Returns
    -------
    mean : float64 [3]
        Headings are averaged as turns from the pose's, the short way round, and not wrapped. The
        pose itself where nothing within reach is likely.
    """
    near, turned = axes_within_reach(pose, grid)
    weights = probabilities.reshape(-1, grid.headings)[np.ix_(near, turned)]
    total = weights.sum()
    if not total > 0:
        return pose
    row, column = np.divmod(np.flatnonzero(near), grid.columns)
    places, turns = weights.sum(axis=1), angle_difference_deg(grid.headings_deg[turned], pose[2])
    u, v = places @ grid.u[column] / total, places @ grid.v[row] / total
    return np.array([u, v, pose[2] + weights.sum(axis=0) @ turns / total])


def covariance(
    pose: NDArray[np.float64],
    poses: NDArray[np.float64],
    weights: NDArray[np.float64],
    grid: PoseGrid,
) -> NDArray[np.float64]:
    """Second moments about a pose of candidates around it: float64 [3, 3] of east, north, heading.

    Parameters
    ----------
    pose : float64 [3]
        The estimate.
    poses : float64 [K, 3]
        Candidates around it.
    weights : float64 [K]
        Their probabilities, up to a factor.
    grid : PoseGrid
        Where they stand. A candidate stands for its whole cell of the grid, so that a twelfth of
        the squared step is added along each axis.

    Returns
    -------
    covariance : float64 [3, 3]
        Places in shares of the tile's side; headings in degrees clockwise, turned from the pose
        the short way round. Of an axis of one value, which is known, all is 0.
    """
    steps = np.array(grid_steps(grid))
    heading_deg = angle_difference_deg(poses[:, 2], pose[2])
    away = np.stack([poses[:, 0] - pose[0], pose[1] - poses[:, 1], heading_deg], axis=1)
    away[:, steps == 0] = 0.0
    total = weights.sum()
    # Where the pose stands so far from all that is likely that nothing is left to weigh.
    shares = weights / total if total > 0 else np.zeros_like(weights)
    return (away * shares[:, None]).T @ away + np.diag(steps**2 / 12.0)


def ellipse(covariance: NDArray[np.float64], confidence: float = CONFIDENCE) -> tuple[float, ...]:
    """The ellipse that holds the confidence, if places are normally distributed.

    Parameters
    ----------
    covariance : float64 [2, 2]
        Of east and north.

    Returns
    -------
    major, minor : float
        Half axes, in the covariance's unit.
    azimuth_deg : float
        Of the major axis, clockwise from north, in [0, 180).

    Examples
    --------
    >>> [round(value, 3) for value in ellipse(np.diag([4.0, 1.0]))]
    [4.895, 2.448, 90.0]
    """
    variances, axes = np.linalg.eigh(covariance)
    # The chi-squared quantile of two degrees of freedom.
    factor = math.sqrt(-2.0 * math.log1p(-confidence))
    minor, major = factor * np.sqrt(np.maximum(variances, 0.0))
    azimuth_deg = math.degrees(math.atan2(axes[0, 1], axes[1, 1])) % 180.0
    return float(major), float(minor), azimuth_deg


def ellipse_outline(major: float, minor: float, azimuth_deg: float) -> NDArray[np.float64]:
    """Points around an ellipse, for a picture of it; the last one is the first again.

    Parameters
    ----------
    major, minor, azimuth_deg
        As `ellipse` gives them.

    Returns
    -------
    float64 [73, 2]
        East and north of its middle, in the half axes' unit.

    Examples
    --------
    >>> (ellipse_outline(2.0, 1.0, 90.0)[[0, 18]].round(9) + 0.0).tolist()
    [[2.0, 0.0], [0.0, -1.0]]
    """
    around, axis = np.linspace(0.0, 2.0 * math.pi, 73), math.radians(azimuth_deg)
    along, across = major * np.cos(around), minor * np.sin(around)
    east = along * math.sin(axis) + across * math.cos(axis)
    return np.column_stack([east, along * math.cos(axis) - across * math.sin(axis)])
