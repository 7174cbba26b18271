"""How sure an estimate is: probabilities of candidates, their spread, and how well they hold.

Ours. Scores become probabilities by a softmax, p_k = exp(c_k / T) / sum exp(c / T), with one
temperature T for all images, fitted afterwards (temperature scaling: Guo, Pleiss, Sun,
Weinberger, *On Calibration of Modern Neural Networks*, ICML 2017, section 4.2).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize_scalar
from scipy.special import log_softmax, softmax

from slicemask import PoseGrid
from slicematch.errors import ConfigError
from slicematch.evaluation.metrics import turn_deg
from slicematch.localization.refinement import grid_steps, near

# The share of probability that a region of places or an ellipse is to hold.
CONFIDENCE = 0.95
# Temperatures that are tried: from scores that settle everything to scores that settle nothing.
_LEAST, _MOST = 1e-4, 10.0


def probabilities(scores: ArrayLike, temperature: float) -> NDArray[np.float64]:
    """Probabilities of candidates, of any shape and 1 in all; 0 where the score is -inf.

    Examples
    --------
    >>> probabilities([0.5, 0.5, -np.inf], temperature=0.1)
    array([0.5, 0.5, 0. ])
    """
    return np.asarray(softmax(np.asarray(scores, dtype=np.float64) / temperature))


def region(place_map: ArrayLike, confidence: float = CONFIDENCE) -> NDArray[np.bool]:
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
    >>> region([[0.6, 0.3], [0.08, 0.02]], 0.9)
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
    poses, left = grid.poses(), probabilities.ravel().copy()
    found = np.empty(len(modes))
    for m, mode in enumerate(modes):
        around = near(mode, poses, grid)
        found[m] = left[around].sum()
        left[around] = 0.0
    return found


def mean_poses(
    modes: NDArray[np.float64], probabilities: NDArray[np.float64], grid: PoseGrid
) -> NDArray[np.float64]:
    """The mean pose of the candidates within reach of each mode, by their probabilities.

    Of all poses it has the least expected squared error, in place and in heading, if the mode is
    the right one.

    Parameters
    ----------
    modes : float64 [m, 3]
        Candidates of the grid.
    probabilities : float64 [rows, columns, headings]
        Of the grid's candidates.
    grid : PoseGrid

    Returns
    -------
    poses : float64 [m, 3]
        Headings are averaged as turns from the mode's, the short way round, and not wrapped.
    """
    poses, found = grid.poses(), np.empty_like(modes)
    for m, mode in enumerate(modes):
        around = near(mode, poses, grid)
        weights = probabilities.ravel()[around]
        if not weights.sum() > 0:  # far less likely than the best mode
            found[m] = mode
            continue
        away = poses[around] - mode
        away[:, 2] = turn_deg(poses[around, 2], mode[2])
        found[m] = mode + weights @ away / weights.sum()
    return found


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
    away = np.stack(
        [poses[:, 0] - pose[0], pose[1] - poses[:, 1], turn_deg(poses[:, 2], pose[2])], axis=1
    )
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


def fit_temperature(scores: NDArray[np.float32], truths: NDArray[np.int64]) -> tuple[float, float]:
    """The temperature under which the true candidates are likeliest.

    Parameters
    ----------
    scores : float [n, K]
        Of the candidates; -inf leaves one out.
    truths : int [n]
        The candidate nearest to each truth.

    Returns
    -------
    temperature : float
        In [1e-4, 10].
    nll : float
        The mean negative log-likelihood of the true candidates under it.

    Raises
    ------
    ConfigError
        If there is no sample, or a score is NaN or infinite, or that of a true candidate -inf.
    """
    if len(scores) == 0:
        raise ConfigError("there are no samples to fit a temperature to; at least one is needed")
    # A NaN outdoes any maximum.
    if not (scores.max() < np.inf and scores[np.arange(len(truths)), truths].min() > -np.inf):
        raise ConfigError(
            "no temperature can be fitted: some scores are not finite numbers, as those of a run "
            "that has diverged; train anew with a lower learning rate"
        )
    found = minimize_scalar(
        lambda log_temperature: mean_nll(scores, truths, math.exp(log_temperature)),
        bounds=(math.log(_LEAST), math.log(_MOST)),
        method="bounded",
        options={"xatol": 1e-3},
    )
    return float(math.exp(found.x)), float(found.fun)


def mean_nll(scores: NDArray[np.float32], truths: NDArray[np.int64], temperature: float) -> float:
    """Mean negative log-likelihood of the true candidates; as in `fit_temperature`."""
    return float(
        np.mean(
            [
                -log_softmax(row.astype(np.float64) / temperature)[truth]
                for row, truth in zip(scores, truths, strict=True)
            ]
        )
    )


@dataclass(frozen=True)
class Calibration:
    """What probabilities promised and what came true, of n estimates.

    Parameters
    ----------
    probability : float64 [n]
        That the camera is within reach of the estimate.
    near : bool [n]
        Whether it is.
    in_region : bool [n]
        Whether the true place's cell lies in the 95 % region: the fewest, likeliest places that
        hold this much (`region`).
    region_share : float64 [n]
        How much of the tile that region takes.
    """

    probability: NDArray[np.float64]
    near: NDArray[np.bool]
    in_region: NDArray[np.bool]
    region_share: NDArray[np.float64]

    def summary(self) -> dict[str, float]:
        """The expected calibration error, and means of all."""
        return {
            "expected_error": calibration_error(self.probability, self.near),
            "mean_probability": float(self.probability.mean()),
            "share_near": float(self.near.mean()),
            "share_in_region": float(self.in_region.mean()),
            "region_share": float(self.region_share.mean()),
        }


def calibration_error(probabilities: ArrayLike, held: ArrayLike, bins: int = 10) -> float:
    """Expected calibration error: how far probabilities lie from the shares that came true.

    The mean over samples of | mean probability - share that held |, each taken over the samples
    of one of ``bins`` equal bins of probability (Guo and others, ICML 2017, eq. 3).

    Parameters
    ----------
    probabilities : float [n]
        What was promised, in [0, 1].
    held : bool [n]
        What came true.

    Examples
    --------
    >>> round(calibration_error([0.8, 0.8, 0.8, 0.8], [True, True, True, False]), 3)
    0.05
    """
    promised, held = np.asarray(probabilities, float), np.asarray(held, float)
    number = np.minimum((promised * bins).astype(int), bins - 1)
    gaps = np.bincount(number, promised - held, bins)
    return float(np.abs(gaps).sum() / len(promised))
