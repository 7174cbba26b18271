"""Frames: the drive's metres, tiles that are north up each by itself, and the globe."""

import numpy as np
import pytest
from slicematch.localization.geodesy import offset_m, offset_position
from slicematch.tracking.tiles import TrackTile, convergence_deg

TILE = TrackTile(None, 100.0, -40.0, 3.0, 70.0)


def test_poses_and_states_are_each_other_s_inverse():
    states = np.array([[100.0, -40.0, 20.0], [120.0, -30.0, 359.0], [80.0, -60.0, 1.0]])
    poses = TILE.poses(states)
    np.testing.assert_allclose(poses[0], [0.5, 0.5, 17.0])
    np.testing.assert_allclose(TILE.states(poses), states)


@pytest.mark.parametrize("origin", [(52.0, 4.36), (-33.9, 151.2)])
def test_north_is_turned_as_meridians_converge(origin):
    place = offset_position(origin, 20_000.0, 5_000.0)
    north = offset_position(place, 0.0, 10.0)  # by the place's own north
    step = np.subtract(offset_m(origin, north), offset_m(origin, place))
    expected = np.degrees(np.arctan2(step[0], step[1]))
    assert convergence_deg(origin, place) == pytest.approx(expected, abs=0.002)
    assert abs(expected) > 0.05
