"""What a car's sensors say of its motion: odometry that drifts, and satellite fixes.

The errors are those that such sensors have, in kind and size: a wheel whose radius is not quite
known and that slips, above all when the car speeds up or slows down; a gyroscope with a bias that
wanders; and fixes whose errors go on for seconds, as those of reflected signals do.
"""

import numpy as np
from numpy.typing import NDArray

from slicemask.synth.layout.routes import Motion

Floats = NDArray[np.float64]

WHEEL_SCALE = 0.015  # deviation of a drive's wheel radius, as a share
SLIP, SLIP_S = 0.015, 4.0  # deviation of the slip, as a share, and how long it lasts
SLIP_OF_ACCELERATION = 0.01  # a share for each m/s^2
SPEED_NOISE_MPS = 0.05
GYRO_BIAS_DPS, GYRO_WANDER_DPS, GYRO_NOISE_DPS = 0.2, 0.02, 0.15  # wander: in a second
FIX_M, FIX_S = 4.0, 20.0  # deviation of fixes to the east and north, and how long it lasts


def measure_odometry(motion: Motion, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """What odometry says at the frames' times: m/s forward and degrees a second clockwise."""
    count = len(motion.times_s)
    step_s = float(motion.times_s[1]) if count > 1 else 1.0
    slip = _lasting(count, step_s, SLIP_S, rng) * SLIP
    scale = 1.0 + rng.normal(0.0, WHEEL_SCALE) + slip
    speed = motion.speeds_mps * (scale + SLIP_OF_ACCELERATION * motion.accelerations_mps2)
    # A wheel that stands says so exactly.
    speed = speed + rng.normal(0.0, SPEED_NOISE_MPS, count) * (motion.speeds_mps > 0.05)
    bias = rng.normal(0.0, GYRO_BIAS_DPS) + np.cumsum(
        rng.normal(0.0, GYRO_WANDER_DPS * np.sqrt(step_s), count)
    )
    yaw = motion.yaw_rates_dps + bias + rng.normal(0.0, GYRO_NOISE_DPS, count)
    return np.maximum(speed, 0.0), yaw


def measure_fixes(motion: Motion, rng: np.random.Generator) -> Floats:
    """Fixes at the frames' times, metres east and north of the city's centre, float64 [F, 2]."""
    count = len(motion.times_s)
    step_s = float(motion.times_s[1]) if count > 1 else 1.0
    errors = [_lasting(count, step_s, FIX_S, rng) * FIX_M for _ in range(2)]
    return motion.places + np.stack(errors, axis=1)


def _lasting(count: int, step_s: float, lasts_s: float, rng: np.random.Generator) -> Floats:
    """Normal errors of deviation 1 that stay alike for a while (Ornstein and Uhlenbeck's)."""
    keeps = np.exp(-step_s / lasts_s)
    values = rng.normal(0.0, 1.0, count)
    for k in range(1, count):
        values[k] = keeps * values[k - 1] + np.sqrt(1.0 - keeps**2) * values[k]
    return values
