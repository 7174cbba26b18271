"""Motion between frames: what odometry says, how far off it is, and how states move by it.

A state is (east_m, north_m, heading_deg, scale, bias_dps): a pose on the map, and what is unknown
of the odometry itself: by which factor true speeds differ from those it says, and what its yaw rate
says when the car goes straight.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slicematch.errors import ConfigError

Floats = NDArray[np.float64]
# Columns of a state.
EAST, NORTH, HEADING, SCALE, BIAS = range(5)


@dataclass(frozen=True)
class Odometry:
    """Mean motion since the last frame, in the camera's frame.

    Attributes
    ----------
    speed_mps : float
        Along the heading, metres a second.
    yaw_rate_dps : float
        Degrees a second, clockwise from above, as headings grow.
    sideways_mps : float
        To the right, metres a second; a car has none.
    """

    speed_mps: float
    yaw_rate_dps: float = 0.0
    sideways_mps: float = 0.0

    @classmethod
    def between(cls, forward_m: float, right_m: float, turn_deg: float, dt_s: float) -> "Odometry":
        """The mean motion that leads to a relative pose, as visual odometry gives it.

        Parameters
        ----------
        forward_m, right_m : float
            From the last camera to this one, in the frame half way between their headings.
        turn_deg : float
            Clockwise, from the last heading to this one.
        dt_s : float
            Between the two frames, seconds.
        """
        if not (math.isfinite(dt_s) and dt_s > 0):
            raise ConfigError(f"the time between two frames is {dt_s:g} s; it must be above 0")
        return cls(forward_m / dt_s, turn_deg / dt_s, right_m / dt_s)

    @property
    def finite(self) -> bool:
        """Whether all of it are numbers."""
        return all(map(math.isfinite, (self.speed_mps, self.yaw_rate_dps, self.sideways_mps)))


@dataclass(frozen=True)
class MotionNoise:
    """How far off odometry is: standard deviations.

    Attributes
    ----------
    scale, bias_dps : float
        Of what is unknown of the odometry, at the start.
    scale_wander, bias_wander_dps : float
        By which these change in a second.
    place_m : float
        Of the place, to all sides, after a metre; it grows with the root of the way.
    heading_deg : float
        Of the heading after a second; it grows with the root of the time.
    unknown_speed_mps, unknown_yaw_dps : float
        Where a frame has no odometry, about the motion before it.
    """

    scale: float = 0.03
    bias_dps: float = 0.5
    scale_wander: float = 0.006
    bias_wander_dps: float = 0.05
    place_m: float = 0.06
    heading_deg: float = 0.3
    unknown_speed_mps: float = 3.0
    unknown_yaw_dps: float = 10.0


def start_states(poses: Floats, noise: MotionNoise, rng: np.random.Generator) -> Floats:
    """States [P, 5] at poses [P, 3] of odometry that nothing is known of yet."""
    count = len(poses)
    unknown = [rng.normal(1.0, noise.scale, count), rng.normal(0.0, noise.bias_dps, count)]
    return np.column_stack([poses, *unknown])


def mean_move(states: Floats, odometry: Odometry, dt_s: float) -> Floats:
    """States [P, 5] moved by odometry, without noise."""
    moved = states.copy()
    turn_deg = (odometry.yaw_rate_dps - states[:, BIAS]) * dt_s
    half = np.radians(states[:, HEADING] + turn_deg / 2.0)
    forward_m = odometry.speed_mps * dt_s * states[:, SCALE]
    right_m = odometry.sideways_mps * dt_s * states[:, SCALE]
    moved[:, EAST] += forward_m * np.sin(half) + right_m * np.cos(half)
    moved[:, NORTH] += forward_m * np.cos(half) - right_m * np.sin(half)
    moved[:, HEADING] = (states[:, HEADING] + turn_deg) % 360.0
    return moved


def step_deviations(odometry: Odometry, dt_s: float, noise: MotionNoise) -> Floats:
    """Standard deviations [5] that a step of odometry adds to states."""
    way_m = math.hypot(odometry.speed_mps, odometry.sideways_mps) * dt_s
    root_s = math.sqrt(dt_s)
    place_m = noise.place_m * math.sqrt(way_m) + 0.01 * root_s
    return np.array(
        [
            place_m,
            place_m,
            # A wheel that stands turns by nothing.
            noise.heading_deg * root_s * min(1.0, 0.1 + abs(odometry.speed_mps)),
            noise.scale_wander * root_s,
            noise.bias_wander_dps * root_s,
        ]
    )


def move(
    states: Floats,
    odometry: Odometry | None,
    before: Odometry,
    dt_s: float,
    noise: MotionNoise,
    rng: np.random.Generator,
) -> Floats:
    """Move states [P, 5] by odometry, each with an error of its own.

    Without odometry each goes on about as the one before says.
    """
    if odometry is None:
        count = len(states)
        moved = states.copy()
        for k in range(count):
            guess = Odometry(
                max(0.0, before.speed_mps + rng.normal(0.0, noise.unknown_speed_mps)),
                before.yaw_rate_dps + rng.normal(0.0, noise.unknown_yaw_dps),
            )
            moved[k : k + 1] = mean_move(states[k : k + 1], guess, dt_s)
        odometry = before
    else:
        moved = mean_move(states, odometry, dt_s)
    moved += rng.normal(size=states.shape) * step_deviations(odometry, dt_s, noise)
    moved[:, HEADING] %= 360.0
    return moved
