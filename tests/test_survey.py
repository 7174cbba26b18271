"""The survey of real pairs: a pose is found from the directions of marks."""

import numpy as np
import pytest

from benchmarks.survey import MARKS, resect


@pytest.mark.parametrize("pose", [(0.0, 0.0, 0.0), (3.0, -2.0, 96.0), (-5.0, 4.0, 181.0)])
@pytest.mark.parametrize("name", list(MARKS))
def test_a_pose_is_found_from_where_marks_are_seen(name, pose):
    marks = np.array(MARKS[name])
    azimuths_deg = np.degrees(np.arctan2(*(marks[:, :2] - pose[:2]).T))
    marks[:, 2] = azimuths_deg - pose[2]
    found, off_deg = resect(marks)
    np.testing.assert_allclose(found[:2], pose[:2], atol=1e-4)
    assert (found[2] - pose[2] + 180) % 360 - 180 == pytest.approx(0, abs=1e-3)
    np.testing.assert_allclose(off_deg, 0, atol=1e-3)


@pytest.mark.parametrize("name", list(MARKS))
def test_the_marks_agree_on_a_pose(name):
    assert np.abs(resect(np.array(MARKS[name]))[1]).max() < 5
