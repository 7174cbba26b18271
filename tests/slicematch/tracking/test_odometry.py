"""Motion between frames: frames and signs, and what is unknown of the odometry."""

import numpy as np
import pytest
from slicematch.errors import ConfigError
from slicematch.tracking.odometry import MotionNoise, Odometry, mean_move, move, start_states

STILL = np.array([[0.0, 0.0, 0.0, 1.0, 0.0]])


@pytest.mark.parametrize(
    ("heading_deg", "east_m", "north_m"), [(0, 0, 5), (90, 5, 0), (180, 0, -5), (270, -5, 0)]
)
def test_a_car_goes_where_it_heads(heading_deg, east_m, north_m):
    moved = mean_move(STILL + np.array([0, 0, heading_deg, 0, 0]), Odometry(10.0), 0.5)
    np.testing.assert_allclose(moved[0, :2], [east_m, north_m], atol=1e-12)


def test_small_steps_of_a_turn_are_one_circle():
    state, radius_m = STILL, 10.0
    for _ in range(900):  # a quarter turn to the right at 10 m radius
        state = mean_move(state, Odometry(radius_m * np.pi / 2, 90.0), 1 / 900)
    np.testing.assert_allclose(state[0, :3], [radius_m, radius_m, 90.0], atol=1e-4)


def test_what_is_unknown_of_the_odometry_is_undone():
    state = STILL + np.array(
        [0, 0, 0, 0.1, 2.0]
    )  # true speeds are 1.1 times, and 2 degrees/s are nothing
    moved = mean_move(state, Odometry(10.0, 2.0), 1.0)
    np.testing.assert_allclose(moved[0, :3], [0.0, 11.0, 0.0], atol=1e-12)


def test_a_relative_pose_is_its_mean_motion():
    odometry = Odometry.between(2.0, 0.5, 10.0, 0.5)
    assert odometry == Odometry(4.0, 20.0, 1.0)
    moved = mean_move(STILL, odometry, 0.5)
    assert moved[0, 2] == pytest.approx(10.0)
    assert np.hypot(*moved[0, :2]) == pytest.approx(np.hypot(2.0, 0.5))
    with pytest.raises(ConfigError, match=r"between two frames is 0 s; it must be above 0"):
        Odometry.between(1.0, 0.0, 0.0, 0.0)


def test_errors_grow_with_the_way_and_more_so_without_odometry():
    rng, noise = np.random.default_rng(0), MotionNoise()
    states = start_states(np.zeros((4000, 3)), noise, rng)
    near = move(states, Odometry(5.0), Odometry(0.0), 0.1, noise, rng)
    far = move(states, Odometry(50.0), Odometry(0.0), 0.1, noise, rng)
    lost = move(states, None, Odometry(5.0), 0.1, noise, rng)
    spreads = [moved[:, 1].std() for moved in (near, far, lost)]
    assert spreads[0] < spreads[1]
    assert spreads[0] < spreads[2]
    assert abs(lost[:, 1].mean() - 0.5) < 0.05  # it goes on as before
