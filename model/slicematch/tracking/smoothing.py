"""Smoothing after a drive: each frame's belief with what later frames say of it.

Backward simulation (Godsill, Doucet and West, *Monte Carlo Smoothing for Nonlinear Time Series*,
JASA 2004, algorithm 1): whole drives are drawn from the particles that the filter had, from the
last frame back to the first, each particle by its weight and by how well odometry leads from it to
the one already drawn. What the filter took for unlikely and turned out right is thus found again.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slicematch.angles import angle_difference_deg
from slicematch.tracking.hypotheses import Hypothesis
from slicematch.tracking.odometry import HEADING, MotionNoise, Odometry, mean_move, step_deviations
from slicematch.tracking.tiles import TrackTiles
from slicematch.tracking.track_estimate import TrackEstimate, TrackMode

Floats = NDArray[np.float64]

DRAWS = 100
# The filter has few particles for so fine a motion: its noise counts so many times as much.
WIDER = 2.0
# How likely it is that a step is none of odometry's, but a jump to a place that a search found.
JUMP = 1e-6


@dataclass(frozen=True)
class Step:
    """What the filter knew at a frame, and how it came there from the one before.

    Attributes
    ----------
    states, weights : float64 [P, 5], [P]
        Of all hypotheses together; the weights are 1 in all.
    odometry : Odometry
    dt_s : float
    """

    states: Floats
    weights: Floats
    odometry: Odometry
    dt_s: float

    @classmethod
    def of(cls, hypotheses: list[Hypothesis], odometry: Odometry, dt_s: float) -> "Step":
        """A belief as one cloud."""
        states = np.concatenate([one.states for one in hypotheses])
        weights = np.concatenate([one.weights * one.probability for one in hypotheses])
        return cls(states, weights / weights.sum(), odometry, dt_s)


def smooth(
    steps: list[Step], noise: MotionNoise, rng: np.random.Generator, draws: int = DRAWS
) -> list[Floats]:
    """States of the frames [draws, 5] of whole drives, drawn from all that was seen.

    Parameters
    ----------
    steps : list of Step
        Of a drive, in turn.
    noise : MotionNoise
        Of its odometry.
    rng : numpy.random.Generator
    draws : int
        How many drives.
    """
    last = steps[-1]
    drawn = [last.states[rng.choice(len(last.weights), draws, p=last.weights)]]
    for step, later in zip(steps[-2::-1], steps[:0:-1], strict=True):
        moved = mean_move(step.states, later.odometry, later.dt_s)
        spread = WIDER * step_deviations(later.odometry, max(later.dt_s, 1e-3), noise)
        away = drawn[-1][:, None] - moved  # [draws, P, 5]
        away[..., HEADING] = angle_difference_deg(away[..., HEADING], 0.0)
        likely = np.exp(-0.5 * np.square(away / spread).sum(axis=2)) + JUMP
        likely *= step.weights
        ends = np.cumsum(likely, axis=1)
        chosen = (ends < rng.random((draws, 1)) * ends[:, -1:]).sum(axis=1)
        drawn.append(step.states[np.minimum(chosen, len(step.weights) - 1)])
    return drawn[::-1]


def smoothed_estimates(
    estimates: list[TrackEstimate],
    drawn: list[Floats],
    tiles: TrackTiles,
    registration_m: float,
) -> list[TrackEstimate]:
    """Estimates of the same frames from the smoothed states."""
    found = []
    for estimate, states in zip(estimates, drawn, strict=True):
        cloud = Hypothesis(states, np.full(len(states), 1.0 / len(states)), 1.0)
        east_m, north_m, heading_deg = cloud.mean().tolist()
        lat, lon = tiles.globe(east_m, north_m)
        heading_deg = (heading_deg - tiles.turn_deg(lat, lon)) % 360.0
        # Drawn from few particles, headings may come out as sure as none is.
        least = np.diag([registration_m**2, registration_m**2, 0.1**2])
        covariance = cloud.covariance() + least
        mode = TrackMode(lat, lon, heading_deg, covariance, 1.0, east_m, north_m)
        found.append(replace(estimate, modes=(mode,)))
    return found
