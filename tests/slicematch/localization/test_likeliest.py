"""The likeliest answers, against sums over all candidates, one by one."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from slicematch.angles import angle_difference_deg
from slicematch.localization.likeliest import likeliest_poses, mass_within_reach
from slicematch.localization.modes import MODES, find_modes, within_reach
from slicematch.localization.probabilities import mode_probabilities
from slicematch.localization.refinement import mean_modes
from slicematch.priors import PosePrior

from slicemask import PoseGrid

GRID = PoseGrid.parse("21x21x64")


@st.composite
def scored_grids(draw):
    """A grid of any steps, and probabilities of its candidates, most of them next to nothing."""
    u0, v0 = (draw(st.floats(0.0, 0.4)) for _ in range(2))
    extent = (u0, v0, draw(st.floats(u0 + 0.2, 1.0)), draw(st.floats(v0 + 0.2, 1.0)))
    counts = (draw(st.integers(1, most)) for most in (17, 13, 40))
    grid = PoseGrid(*counts, extent=extent)
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    shares = random.dirichlet(np.full(len(grid), 0.1)).reshape(grid.shape)
    return grid, shares


def summed(grid, shares):
    """The mass within reach of each candidate."""
    poses = grid.poses()
    around = [shares.ravel()[within_reach(pose, poses, grid)].sum() for pose in poses]
    return np.reshape(around, grid.shape)


@settings(deadline=None, max_examples=60)
@given(scored_grids())
def test_the_mass_is_that_of_all_candidates_within_reach(scored):
    grid, shares = scored
    np.testing.assert_allclose(mass_within_reach(shares, grid), summed(grid, shares), atol=1e-12)


@settings(deadline=None, max_examples=60)
@given(scored_grids())
def test_the_first_answer_starts_where_most_is_and_all_are_apart(scored):
    grid, shares = scored
    found = likeliest_poses(shares, grid)
    assert 1 <= len(found) <= MODES
    # Some of what is within reach may be lost in moving, a tenth at most.
    near = within_reach(found[0], grid.poses(), grid)
    assert shares.ravel()[near].sum() >= 0.9 * summed(grid, shares).max() - 1e-12
    check_order(found, shares, grid)
    u0, v0, u1, v1 = grid.extent
    assert ((found[:, 0] >= u0) & (found[:, 0] <= u1)).all()
    assert ((found[:, 1] >= v0) & (found[:, 1] <= v1)).all()


def check_order(found, shares, grid):
    """The likeliest first, and each beyond reach of all others."""
    for m, pose in enumerate(found):
        assert not within_reach(pose, np.delete(found, m, axis=0), grid).any()
    assert (np.diff(mode_probabilities(found, shares, grid)) <= 0).all()


@settings(deadline=None, max_examples=60)
@given(scored_grids(), st.floats(1, 180), st.floats(0, 360), st.floats(0.1, 1.0))
def test_the_order_holds_within_any_prior(scored, half_width, centre, radius):
    grid, shares = scored
    place = (*grid.poses()[0, :2], radius)
    prior = PosePrior(grid.extent, (centre, half_width), place)
    inside = prior.project(torch.from_numpy(grid.poses())).numpy()
    allowed = np.abs(inside - grid.poses()).max(axis=1) < 1e-9
    left = np.where(allowed.reshape(grid.shape), shares, 0.0)
    if left.sum() == 0:
        return
    left = left / left.sum()
    poses, values = mean_modes(lambda some: some[:, 2], left, grid, prior)
    again = prior.project(torch.from_numpy(poses)).numpy()
    np.testing.assert_allclose(poses[:, :2], again[:, :2], atol=1e-9)
    np.testing.assert_allclose(angle_difference_deg(poses[:, 2], again[:, 2]), 0, atol=1e-6)
    np.testing.assert_array_equal(values, poses[:, 2])
    check_order(poses, left, grid)


def test_a_mean_where_next_to_nothing_is_likely_is_no_answer():
    """All that is within reach of the start is beyond reach of its mean."""
    shares = np.zeros(GRID.shape)
    shares[8, 10, 5] = shares[12, 10, 5] = 0.335
    shares[10, 12, 15] = 0.33
    assert mass_within_reach(shares, GRID).max() == pytest.approx(1.0)
    found = likeliest_poses(shares, GRID)
    assert mode_probabilities(found, shares, GRID)[0] > 0.9


def test_headings_in_the_gap_of_a_wide_prior_are_one_answer():
    shares = np.zeros(GRID.shape)
    shares[10, 10, [28, 37, 26]] = 0.45, 0.35, 0.2
    prior = PosePrior(heading_prior=(0.0, 158.0))
    poses, _ = mean_modes(lambda some: some[:, 2], shares, GRID, prior)
    check_order(poses, shares, GRID)


def test_many_that_are_nearly_as_good_are_likelier_than_the_best_one():
    scores = np.full(GRID.shape, -np.inf, dtype=np.float32)
    scores[3, 3, 10] = 1.0
    scores[14:17, 14:17, 30:34] = 0.9
    shares = np.exp(scores.astype(float)) / np.exp(scores.astype(float)).sum()
    best = find_modes(scores, GRID)[0][0]
    np.testing.assert_allclose(best, GRID.poses()[GRID.index(3, 3, 10)])
    likeliest, other = likeliest_poses(shares, GRID)
    np.testing.assert_allclose(likeliest, [GRID.u[15], GRID.v[15], 31.5 * 360 / 64])
    np.testing.assert_allclose(other, best)
    assert mode_probabilities(np.array([likeliest, other]), shares, GRID).argmax() == 0


def test_one_candidate_that_holds_all_is_the_answer():
    shares = np.zeros(GRID.shape)
    shares[20, 0, 63] = 1.0
    found = likeliest_poses(shares, GRID)
    np.testing.assert_allclose(found, [GRID.poses()[GRID.index(20, 0, 63)]])


@pytest.mark.parametrize("name", ["1x1x1", "1x1x8", "5x1x1", "2x3x4"])
def test_equal_candidates_have_an_answer_on_any_grid(name):
    grid = PoseGrid.parse(name)
    found = likeliest_poses(np.full(grid.shape, 1 / len(grid)), grid)
    assert np.isfinite(found).all()
    assert len(found) >= 1


def test_headings_are_averaged_across_north():
    shares = np.zeros(GRID.shape)
    shares[10, 10, [62, 63, 0, 1, 2]] = 0.2
    (found,) = likeliest_poses(shares, GRID)
    assert (found[2] + 180) % 360 - 180 == pytest.approx(0, abs=1e-9)
