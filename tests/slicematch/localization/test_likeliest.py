"""The likeliest answers, against sums over all candidates, one by one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from slicematch.localization.likeliest import likeliest_poses, mass_within_reach
from slicematch.localization.modes import MODES, find_modes, within_reach
from slicematch.localization.probabilities import mean_pose, mode_probabilities

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
    mass = summed(grid, shares).ravel()
    # Of those that have the most within reach, the likeliest itself.
    start = grid.poses()[np.where(mass > mass.max() - 1e-12, shares.ravel(), -1).argmax()]
    for _ in range(3):
        start = mean_pose(start, shares, grid)
    np.testing.assert_allclose(found[0], start, atol=1e-9)
    for m, pose in enumerate(found):
        assert not within_reach(pose, np.delete(found, m, axis=0), grid).any()
        u0, v0, u1, v1 = grid.extent
        assert u0 <= pose[0] <= u1
        assert v0 <= pose[1] <= v1
    assert (mode_probabilities(found, shares, grid) > 0).all()


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
