"""A belief as a few hypotheses, each a cloud of particles: a mixture of particle filters.

Each hypothesis is weighed by what its particles score and is resampled by itself, so that a mode
that is less likely for a while is not lost to chance (Vermaak, Doucet, Perez, *Maintaining
Multi-Modality through Mixture Tracking*, ICCV 2003, equations 5 to 8).
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slicematch.angles import angle_difference_deg
from slicematch.tracking.odometry import HEADING

Floats = NDArray[np.float64]

# Hypotheses whose means are nearer than this are one: metres and degrees.
SAME_M, SAME_DEG = 3.0, 20.0
# A hypothesis that is less likely is given up.
LEAST_PROBABILITY = 1e-4
MOST = 12  # hypotheses at a time
# Width of the kernel that particles are set apart by, in deviations of the cloud.
KERNEL = 0.1


@dataclass(frozen=True)
class Hypothesis:
    """One of the places where the camera may be.

    Attributes
    ----------
    states : float64 [P, 5]
        Particles (`slicematch.tracking.odometry`).
    weights : float64 [P]
        1 in all.
    probability : float
        That it is the right one.
    waiting : float
        What the images have counted that it has not been weighed by: the less likely ones take
        turns.
    """

    states: Floats
    weights: Floats
    probability: float
    waiting: float = 0.0

    def mean(self) -> Floats:
        """The mean pose, float64 [3]; the heading the short way round, in [0, 360)."""
        place = self.weights @ self.states[:, :2]
        angle = np.radians(self.states[:, HEADING])
        heading = np.degrees(np.arctan2(self.weights @ np.sin(angle), self.weights @ np.cos(angle)))
        return np.array([*place, heading % 360.0])

    def covariance(self) -> Floats:
        """Of east, north (metres) and heading (degrees) about the mean, float64 [3, 3]."""
        mean = self.mean()
        away = self.states[:, :3] - mean
        away[:, HEADING] = angle_difference_deg(self.states[:, HEADING], mean[HEADING])
        return np.asarray((away * self.weights[:, None]).T @ away)

    def weighed(self, log_likelihood: Floats) -> tuple["Hypothesis", float]:
        """The hypothesis after a measurement [P], and the log of its evidence."""
        most = float(log_likelihood.max())
        weights = self.weights * np.exp(log_likelihood - most)
        total = float(weights.sum())
        if not total > 0:  # all particles with a weight are far below the best one
            return self, most - 700.0
        return replace(self, weights=weights / total), most + np.log(total)

    def resampled(self, count: int, rng: np.random.Generator) -> "Hypothesis":
        """So many particles of equal weight, drawn systematically, and set apart a little.

        One uniform number draws all: Kitagawa, *Monte Carlo Filter and Smoother*, JCGS 1996. What
        is unknown of the odometry hardly changes from frame to frame, so that copies of a few
        particles would soon be all there is. So each is drawn towards the mean and moved by a
        kernel, which keeps mean and variance: Liu and West, *Combined Parameter and State
        Estimation in Simulation-Based Filtering*, 2001.
        """
        ends = np.cumsum(self.weights)
        at = (rng.random() + np.arange(count)) / count * ends[-1]
        drawn = np.minimum(np.searchsorted(ends, at), len(ends) - 1)
        mean = np.concatenate([self.mean(), self.weights @ self.states[:, HEADING + 1 :]])
        away = self.states - mean
        away[:, HEADING] = angle_difference_deg(self.states[:, HEADING], mean[HEADING])
        spread = np.sqrt(self.weights @ np.square(away))
        moved = KERNEL * spread * rng.normal(size=(count, len(mean)))
        states = mean + math.sqrt(1.0 - KERNEL**2) * away[drawn] + moved
        states[:, HEADING] %= 360.0
        return replace(self, states=states, weights=np.full(count, 1.0 / count))

    def effective(self) -> float:
        """How many particles of equal weight say as much (Kong, Liu, Wong 1994)."""
        return float(1.0 / np.square(self.weights).sum())


def normalised(hypotheses: list[Hypothesis]) -> list[Hypothesis]:
    """The likeliest first, their probabilities 1 in all, without those that are given up."""
    total = sum(one.probability for one in hypotheses)
    kept = sorted(hypotheses, key=lambda one: -one.probability)[:MOST]
    kept = [one for one in kept if one.probability / total > LEAST_PROBABILITY]
    total = sum(one.probability for one in kept)
    return [replace(one, probability=one.probability / total) for one in kept]


def merged(hypotheses: list[Hypothesis]) -> list[Hypothesis]:
    """Those that have come to the same place made one, the likeliest first."""
    kept: list[Hypothesis] = []
    for one in hypotheses:
        for number, other in enumerate(kept):
            if same_place(one.mean(), other.mean()):
                total = one.probability + other.probability
                kept[number] = Hypothesis(
                    np.concatenate([other.states, one.states]),
                    np.concatenate(
                        [
                            other.weights * other.probability / total,
                            one.weights * one.probability / total,
                        ]
                    ),
                    total,
                    other.waiting,
                )
                break
        else:
            kept.append(one)
    return kept


def same_place(pose: Floats, other: Floats) -> bool:
    """Whether two poses (east_m, north_m, heading_deg) are one answer."""
    near = np.hypot(*(pose[:2] - other[:2])) < SAME_M
    turned = abs(angle_difference_deg(pose[2:], float(other[2]))[0])
    return bool(near and turned < SAME_DEG)
