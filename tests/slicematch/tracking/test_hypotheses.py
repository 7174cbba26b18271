"""A belief of several clouds: resampling, merging, and agreement with Kalman's filter."""

import numpy as np
import pytest
from slicematch.tracking.hypotheses import MOST, Hypothesis, merged, normalised
from slicematch.tracking.odometry import MotionNoise, Odometry, move, start_states
from slicematch.tracking.smoothing import Step, smooth


def cloud(poses, probability=1.0):
    states = np.column_stack([poses, np.ones(len(poses)), np.zeros(len(poses))])
    return Hypothesis(states, np.full(len(poses), 1 / len(poses)), probability)


def test_each_particle_is_drawn_as_often_as_its_weight_says():
    weights = np.array([0.5, 0.25, 0.125, 0.125])
    states = np.arange(20.0).reshape(4, 5)
    drawn = Hypothesis(states, weights, 1.0).resampled(8, np.random.default_rng(3))
    nearest = np.abs(drawn.states[:, 0, None] - states[:, 0]).argmin(axis=1)
    # Systematic: as exactly as whole numbers allow.
    assert np.bincount(nearest).tolist() == [4, 2, 1, 1]


def test_resampling_keeps_mean_and_spread_and_copies_nothing():
    rng = np.random.default_rng(5)
    states = rng.normal(size=(400, 5)) * [2.0, 1.0, 5.0, 0.01, 0.2] + [3.0, 4.0, 359.0, 1.0, 0.1]
    states[:, 2] %= 360.0
    weights = rng.random(400) ** 4
    one = Hypothesis(states, weights / weights.sum(), 1.0)
    drawn = one
    for _ in range(20):
        drawn = drawn.resampled(2000, rng)
    assert len(np.unique(drawn.states[:, 3])) == 2000
    deviations = np.sqrt(np.diag(one.covariance()))
    away = drawn.mean() - one.mean()
    away[2] = (away[2] + 180.0) % 360.0 - 180.0
    assert (np.abs(away) < 0.15 * deviations).all()
    assert np.sqrt(np.diag(drawn.covariance())) == pytest.approx(deviations, rel=0.1)


def test_headings_are_averaged_the_short_way_round():
    one = cloud(np.array([[0.0, 0.0, 350.0], [0.0, 0.0, 30.0]]))
    assert one.mean()[2] == pytest.approx(10.0)
    assert one.covariance()[2, 2] == pytest.approx(400.0)


def test_what_comes_to_one_place_is_one_and_the_rest_stays_apart():
    here, there = np.zeros((10, 3)), np.full((10, 3), 30.0)
    near = here + np.array([1.0, 0, 5.0])
    found = merged([cloud(here, 0.5), cloud(there, 0.3), cloud(near, 0.2)])
    assert [one.probability for one in found] == [0.7, 0.3]
    assert found[0].mean()[0] == pytest.approx(0.2 / 0.7)
    # The same place, but the other way round, is another answer.
    assert len(merged([cloud(here), cloud(here + np.array([0, 0, 180.0]))])) == 2


def test_only_the_likeliest_are_kept():
    many = [cloud(np.full((3, 3), 10.0 * k), 1.0 / (k + 1)) for k in range(MOST + 4)]
    kept = normalised([*many, cloud(np.zeros((3, 3)), 1e-9)])
    assert len(kept) == MOST
    assert sum(one.probability for one in kept) == pytest.approx(1.0)
    assert kept[0].probability == max(one.probability for one in kept)


def test_evidence_and_weights_are_bayes():
    one = cloud(np.zeros((4, 3)))
    likelihood = np.array([1.0, 2.0, 3.0, 4.0])
    after, evidence = one.weighed(np.log(likelihood))
    np.testing.assert_allclose(after.weights, likelihood / 10)
    assert np.exp(evidence) == pytest.approx(2.5)


def test_smoothing_is_surer_than_the_filter_and_nearer_to_the_truth():
    # A car drives north past three places that are seen; then all is known of the way to them.
    rng, noise = np.random.default_rng(1), MotionNoise(scale=0.1)
    states = start_states(rng.normal(0, [3.0, 3.0, 2.0], (600, 3)), noise, rng)
    one, steps = Hypothesis(states, np.full(600, 1 / 600), 1.0), []
    truth = []
    for k in range(40):
        if k:
            moved = move(one.states, Odometry(5.0), Odometry(5.0), 0.5, noise, rng)
            one = Hypothesis(moved, one.weights, 1.0)
        truth.append((0.0, 2.5 * k))
        if k >= 30:
            off = np.square(one.states[:, :2] - truth[-1]).sum(axis=1)
            one, _ = one.weighed(-off / 2 / 0.5**2)
        if one.effective() < 300:
            one = one.resampled(600, rng)
        steps.append(Step.of([one], Odometry(5.0), 0.5))
    smoothed = smooth(steps, noise, rng)
    first = cloud(smoothed[5][:, :3])
    before = Hypothesis(steps[5].states, steps[5].weights, 1.0)
    assert np.trace(first.covariance()[:2, :2]) < 0.6 * np.trace(before.covariance()[:2, :2])
    assert np.hypot(*(first.mean()[:2] - truth[5])) < 1.5
