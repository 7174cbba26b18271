"""Probabilities, spread and calibration, against what is known in closed form."""

import numpy as np
import pytest
from slicematch.errors import ConfigError
from slicematch.evaluation.calibration import (
    Calibration,
    calibration_error,
    fit_temperature,
    mean_nll,
)
from slicematch.evaluation.metrics import nearest_candidates
from slicematch.localization.modes import within_reach
from slicematch.localization.probabilities import (
    covariance,
    credible_region,
    ellipse,
    mean_pose,
    mode_probabilities,
    probabilities,
)

from slicemask import PoseGrid

GRID = PoseGrid.parse("41x41x72")


def gaussian(pose, spread, grid=GRID):
    """Scores whose softmax at temperature 1 is normal around a pose."""
    away = grid.poses() - pose
    away[:, 2] = (away[:, 2] + 180) % 360 - 180
    away[:, 1] *= -1
    return -0.5 * np.einsum("ki,ij,kj->k", away, np.linalg.inv(spread), away)


@pytest.mark.parametrize("pose", [[0.5, 0.5, 180.0], [0.52, 0.47, 1.0], [0.5, 0.51, 358.5]])
def test_the_covariance_of_a_normal_distribution_is_found(pose):
    spread = np.array([[4e-4, 2e-4, 0.03], [2e-4, 9e-4, -0.05], [0.03, -0.05, 36.0]])
    shares = probabilities(gaussian(pose, spread), 1.0)
    poses = GRID.poses()
    around = within_reach(np.array(pose), poses, GRID)
    found = covariance(np.array(pose), poses[around], shares[around], GRID)
    # The cells' own width, of which the candidates' probabilities know nothing, is in it too; and
    # what lies beyond reach is not.
    expected = spread + np.diag([1 / 41, 1 / 41, 5.0]) ** 2 / 12
    np.testing.assert_allclose(found[:2, :2], expected[:2, :2], rtol=0.03, atol=1e-5)
    np.testing.assert_allclose(found[2], expected[2], rtol=0.03)


@pytest.mark.parametrize("pose", [[0.5, 0.5, 180.0], [0.521, 0.468, 1.1], [0.5, 0.513, 358.9]])
def test_the_mean_of_a_normal_distribution_is_found_between_candidates(pose):
    shares = probabilities(gaussian(pose, np.diag([4e-4, 4e-4, 36.0])), 1.0).reshape(GRID.shape)
    mode = GRID.poses()[shares.argmax()]
    u, v, heading = mean_pose(mode, shares, GRID)
    assert (u, v) == pytest.approx(pose[:2], abs=1e-4)
    assert (heading - pose[2] + 180) % 360 - 180 == pytest.approx(0, abs=0.02)
    # Where nothing is likely, a pose stays.
    other = GRID.poses()[0]
    np.testing.assert_array_equal(mean_pose(other, np.zeros(GRID.shape), GRID), other)


def test_what_is_known_has_no_spread():
    grid = PoseGrid(5, 1, 1)
    found = covariance(np.array([0.5, 0.5, 0.0]), grid.poses(), np.full(5, 0.2), grid)
    assert (found[[0, 2]] == 0).all()
    assert found[1, 1] == pytest.approx(np.var([0.1, 0.3, 0.5, 0.7, 0.9]) + 0.04 / 12)


def test_nothing_likely_around_leaves_the_cell():
    poses = PoseGrid(2, 2, 4).poses()
    found = covariance(poses[0], poses, np.zeros(16), PoseGrid(2, 2, 4))
    np.testing.assert_allclose(found, np.diag([0.25, 0.25, 8100.0]) / 12)


def test_probabilities_of_left_out_candidates_are_zero():
    found = probabilities([[1.0, -np.inf], [0.0, 1.0]], 0.5)
    assert found[0, 1] == 0
    np.testing.assert_allclose(found[0, 0], found[1, 1])
    np.testing.assert_allclose(found[0, 0] / found[1, 0], np.exp(2))
    assert found.sum() == pytest.approx(1)


def test_modes_share_what_lies_between_them():
    grid = PoseGrid.parse("20x20x1")
    shares = np.full(grid.shape, 1 / 400)
    poses = np.array([[0.5, 0.5, 0.0], [0.55, 0.5, 0.0], [0.1, 0.9, 0.0]])
    found = mode_probabilities(poses, shares, grid)
    places = grid.poses()[:, :2]
    first, second, third = (np.hypot(*(places - pose[:2]).T) <= 0.1 for pose in poses)
    counts = [first.sum(), (second & ~first).sum(), third.sum()]
    np.testing.assert_allclose(found, np.array(counts) / 400)


def test_the_region_is_the_smallest_that_holds_enough():
    rng = np.random.default_rng(0)
    places = rng.dirichlet(np.full(50, 0.3)).reshape(5, 10)
    held = credible_region(places)
    assert places[held].sum() >= 0.95
    assert places[held].sum() - places[held].min() < 0.95
    assert places[held].min() >= places[~held].max()
    assert credible_region(places, 1.0).sum() == (places > 0).sum()
    assert credible_region([[1.0, 0.0]]).tolist() == [[True, False]]


def test_the_ellipse_holds_its_share_and_points_the_right_way():
    # Spread from south-west to north-east: azimuth 45 degrees.
    major, minor, azimuth_deg = ellipse(np.array([[5.0, 4.0], [4.0, 5.0]]))
    assert azimuth_deg == pytest.approx(45)
    assert (major / minor) ** 2 == pytest.approx(9)
    rng = np.random.default_rng(0)
    east, north = rng.multivariate_normal([0, 0], [[5.0, 4.0], [4.0, 5.0]], 40_000).T
    along, across = (east + north) / 2**0.5, (east - north) / 2**0.5
    assert np.mean((along / major) ** 2 + (across / minor) ** 2 <= 1) == pytest.approx(
        0.95, abs=0.005
    )


def test_a_temperature_is_found_again():
    """Truths drawn by the softmax at a temperature are likeliest at that temperature."""
    rng = np.random.default_rng(0)
    scores = rng.normal(0, 0.1, (4000, 60)).astype(np.float32)
    scores[:, 7] = -np.inf
    truths = np.array([rng.choice(60, p=probabilities(row, 0.05)) for row in scores])
    temperature, nll = fit_temperature(scores, truths)
    assert temperature == pytest.approx(0.05, rel=0.05)
    assert nll == pytest.approx(mean_nll(scores, truths, temperature))
    for other in (0.04, 0.06):
        assert mean_nll(scores, truths, other) > nll
    with pytest.raises(ConfigError, match="at least one is needed"):
        fit_temperature(scores[:0], truths[:0])
    for value, place in ((np.nan, 3), (np.inf, 3), (-np.inf, truths[0])):
        spoilt = scores[:2].copy()
        spoilt[0, place] = value
        with pytest.raises(ConfigError, match="some scores are not finite"):
            fit_temperature(spoilt, truths[:2])


def test_calibration_errors():
    # Two bins, of shares 0.25 and 0.75: |0.15 - 1/4| and |0.85 - 2/4| weighed by half each.
    promised = [0.15] * 4 + [0.85] * 4
    held = [True, False, False, False, True, True, False, False]
    assert calibration_error(promised, held) == pytest.approx((0.1 + 0.35) / 2)
    rng = np.random.default_rng(0)
    promised = rng.random(50_000)
    held = rng.random(50_000) < promised
    assert calibration_error(promised, held) < 0.01
    assert calibration_error(promised, rng.random(50_000) < promised / 2) > 0.2
    assert calibration_error([1.0], [True]) == 0

    summary = Calibration(promised, held, held, promised).summary()
    assert summary["expected_error"] < 0.01
    assert summary["within_reach"] == summary["coverage"] == held.mean()


def test_the_candidate_of_a_truth():
    grid = PoseGrid.parse("3x4x8")
    rng = np.random.default_rng(0)
    truths = np.column_stack([rng.random((50, 2)), rng.uniform(0, 360, 50)])
    found = nearest_candidates(grid.poses(), truths)
    row, column = (truths[:, 1] * 3).astype(int), (truths[:, 0] * 4).astype(int)
    heading = np.round(truths[:, 2] / 45).astype(int) % 8
    np.testing.assert_array_equal(found, (row * 4 + column) * 8 + heading)
