"""Refinement: the modes it starts from, what it may not leave, and how near it comes to a peak."""

import runpy
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.ndimage import maximum_filter
from slicematch.errors import ConfigError, RunError
from slicematch.localization.modes import (
    MODES,
    _highest_around,
    candidates_within_reach,
    find_modes,
    grid_steps,
    non_maximum_suppression,
    within_reach,
)
from slicematch.localization.refinement import (
    DEFAULT,
    check_refine,
    coarse_to_fine,
    gradient_ascent,
    refine_modes,
)
from slicematch.priors import PosePrior

from slicemask import Frustum, PoseGrid

FLOOR = runpy.run_path(str(Path(__file__).parents[3] / "examples" / "refined_floor.py"))
GRID = PoseGrid.parse("21x21x64")
STEPS = np.array([1 / 21, 1 / 21, 5.625])


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 5, 2), (4, 1, 3), (6, 7, 1), (9, 8, 16)])
def test_peaks_are_those_of_a_maximum_filter(shape):
    rng = np.random.default_rng(sum(shape))
    scores = rng.integers(0, 6, shape).astype(np.float32)
    scores[rng.random(shape) < 0.2] = -np.inf
    highest = maximum_filter(scores, 3, mode=("constant", "constant", "wrap"), cval=-np.inf)
    assert np.array_equal(_highest_around(scores), highest)


@pytest.mark.parametrize("name", ["21x21x64", "3x5x8", "1x1x7"])
def test_candidates_within_reach_are_those_among_all_poses(name):
    grid = PoseGrid.parse(name)
    poses = grid.poses()
    for pose in np.add(poses[:: max(1, len(poses) // 25)], [0.001, -0.002, 1.0]):
        expected = within_reach(pose, poses, grid)
        assert expected.any()
        assert np.array_equal(candidates_within_reach(pose, grid), expected)


def bump(truth, width=(0.05, 0.05, 10.0), other=None):
    """A score that peaks with 1 at the truth, and with 0.9 at another pose."""

    def score(poses):
        highest = None
        for height, peak in ((1.0, truth), (0.9, other)):
            if peak is not None:
                away = poses - poses.new_tensor(peak)
                turn = torch.remainder(away[:, 2] + 180.0, 360.0) - 180.0
                away = torch.cat([away[:, :2], turn[:, None]], dim=1) / away.new_tensor(width)
                values = height * torch.exp(-away.square().sum(dim=1) / 2)
                highest = values if highest is None else torch.maximum(highest, values)
        return highest

    return score


def on_grid(score, grid=GRID):
    return score(torch.from_numpy(grid.poses())).reshape(grid.shape).numpy()


def refined(score, truth, how="continuous", grid=GRID, prior=None, tile_metres=72.5):
    modes, _ = find_modes(on_grid(score, grid), grid)
    poses, scores = refine_modes(score, modes, grid, prior or PosePrior(), how, tile_metres)
    return poses[0], scores[0]


# The floor of refinement: the real refinement, with scores that peak at the truth.


@pytest.mark.parametrize(
    ("grid", "frustum"),
    [
        (GRID, Frustum()),
        (PoseGrid.parse("21x21x1"), Frustum()),
        (PoseGrid.parse("15x15x64", (0.21, 0.21, 0.79, 0.79)), Frustum(81.5, 16, "pinhole")),
    ],
    ids=["panorama", "aligned", "pinhole"],
)
def test_refined_answers_reach_a_peak_that_the_grid_misses(grid, frustum):
    # All 1,000 poses: python examples/refined_floor.py
    measured = FLOOR["measure"](12, grid, frustum, seed=3)
    assert FLOOR["share_near"](measured["none"]) == 0
    assert (measured["continuous"].place_m <= 0.05).all()
    assert (measured["continuous"].heading_deg <= 0.2).all()
    # Two finest steps.
    assert (measured["fine"].place_m <= 0.5).all()
    assert (measured["fine"].heading_deg <= 1.0).all()
    if grid.headings == 1:
        assert (measured["continuous"].heading_deg == 0).all()


@pytest.mark.parametrize("how", ["fine", "continuous"])
@pytest.mark.parametrize(
    "truth",
    [
        [0.013, 0.52, 359.7],
        [0.5, 0.994, 0.2],
        [0.0, 0.0, 180.0],
        [1.0, 1.0, 2.9],
        [0.497, 0.213, 357.1],
    ],
)
def test_edges_of_the_tile_and_north_are_no_barrier(truth, how):
    pose, _ = refined(bump(truth), truth, how)
    assert (pose[:2] >= 0).all()
    assert (pose[:2] <= 1).all()
    assert 0 <= pose[2] < 360
    least = (0.003, 0.3) if how == "fine" else (1e-4, 0.01)
    np.testing.assert_allclose(pose[:2], truth[:2], atol=least[0])
    assert abs((pose[2] - truth[2] + 180) % 360 - 180) <= least[1]


def test_the_finest_step_is_in_metres_or_a_share_of_the_tile():
    truth = [0.41, 0.43, 77.0]
    seen = []

    def spy(poses):
        seen.append(poses)
        return bump(truth)(poses)

    for tile_metres, expected in ((72.5, 0.25 / 72.5), (None, 1 / 256)):
        seen.clear()
        refined(spy, truth, "fine", tile_metres=tile_metres)
        last = seen[-1]
        assert len(last) == 27
        assert np.diff(np.unique(last[:, 0].numpy().round(9))).min() == pytest.approx(expected)
        assert np.diff(np.unique(last[:, 2].numpy().round(9))).min() == pytest.approx(0.5)


def test_a_grid_that_is_fine_enough_is_left_as_it_is():
    grid = PoseGrid(8, 8, 720, extent=(0.49, 0.49, 0.51, 0.51))
    truth = [0.5003, 0.4994, 10.2]
    pose, _ = refined(bump(truth), truth, "fine", grid)
    assert pose.tolist() in grid.poses().tolist()


@pytest.mark.parametrize("how", ["fine", "continuous"])
def test_priors_are_kept_and_their_edges_reached(how):
    """The peak lies outside the prior: the answer is the point of the prior that is nearest."""
    truth, centre, radius = [0.7, 0.5, 40.0], (0.5, 0.5), 0.13
    prior = PosePrior(heading_prior=(10.0, 20.0), place_prior=(*centre, radius))
    scores = on_grid(bump(truth, (0.2, 0.2, 30.0)))
    poses = GRID.poses()
    out = np.hypot(poses[:, 0] - 0.5, poses[:, 1] - 0.5) > radius
    out |= np.abs((poses[:, 2] - 10 + 180) % 360 - 180) > 20
    scores[out.reshape(GRID.shape)] = -np.inf
    modes, _ = find_modes(scores, GRID)
    found, _ = refine_modes(bump(truth, (0.2, 0.2, 30.0)), modes, GRID, prior, how, 72.5)
    assert (np.hypot(*(found[:, :2] - centre).T) <= radius + 1e-12).all()
    turn = np.abs((found[:, 2] - 10 + 180) % 360 - 180)
    assert (turn <= 20 + 1e-9).all()
    np.testing.assert_allclose(found[0], [0.63, 0.5, 30.0], atol=2e-3)


def test_a_known_heading_stays():
    grid = PoseGrid.parse("21x21x1")
    pose, _ = refined(bump([0.41, 0.43, 9.0]), None, grid=grid)
    assert pose[2] == 0.0
    np.testing.assert_allclose(pose[:2], [0.41, 0.43], atol=1e-4)
    prior = PosePrior(heading_prior=(90.0, 0.0))
    poses = torch.tensor([[0.5, 0.5, 123.0], [0.5, 0.5, -10.0]], dtype=torch.float64)
    assert prior.project(poses)[:, 2].tolist() == [90.0, 90.0]


def test_projection_wraps_headings_and_keeps_gradients():
    poses = torch.tensor(
        [[0.5, 0.5, -1e-20], [1.2, -0.1, 725.0], [0.3, 0.3, 360.0]], dtype=torch.float64
    ).requires_grad_()
    inside = PosePrior().project(poses)
    assert inside.tolist() == [[0.5, 0.5, 0.0], [1.0, 0.0, 5.0], [0.3, 0.3, 0.0]]
    prior = PosePrior((0.2, 0.2, 0.8, 0.8), (0.0, 30.0), (0.5, 0.5, 0.1))
    start = torch.tensor([[0.5, 0.5, 20.0], [0.7, 0.6, 20.0]], dtype=torch.float64)
    start.requires_grad_()
    (gradient,) = torch.autograd.grad(prior.project(start).sum(), start)
    assert torch.isfinite(gradient).all()
    assert gradient[0].tolist() == [1.0, 1.0, 1.0]


@pytest.mark.parametrize(
    "prior", [(0.5, 0.5, 0.1), (-0.2, 0.5, 0.4), (1.3, 1.2, 0.7), (0.95, 0.5, 0.3), (0.5, 0.5, 0)]
)
def test_a_place_lies_in_the_extent_and_the_prior_wherever_its_centre_is(prior):
    rng = np.random.default_rng(0)
    poses = torch.from_numpy(rng.uniform(-0.5, 1.5, (500, 3))).requires_grad_()
    inside = PosePrior(place_prior=prior).project(poses)
    assert ((inside[:, :2] >= 0) & (inside[:, :2] <= 1)).all()
    away = inside[:, :2].detach().numpy() - prior[:2]
    assert (np.hypot(*away.T) <= prior[2] + 1e-12).all()
    again = PosePrior(place_prior=prior).project(inside)
    torch.testing.assert_close(again, inside, rtol=0, atol=1e-12)
    (gradient,) = torch.autograd.grad(inside.sum(), poses)
    assert torch.isfinite(gradient).all()
    there = (poses[:, :2] - poses.new_tensor(prior[:2])).square().sum(dim=1) <= prior[2] ** 2
    there &= ((poses[:, :2] >= 0) & (poses[:, :2] <= 1)).all(dim=1)
    torch.testing.assert_close(inside[there, :2], poses[there, :2], rtol=0, atol=1e-15)
    assert prior[2] == 0 or there.any()


# The modes.


@pytest.mark.parametrize("spoilt", [np.nan, np.inf])
@pytest.mark.parametrize("where", [(0, 0, 0), slice(None)])
def test_scores_that_are_not_finite_are_refused(spoilt, where):
    scores = np.zeros(GRID.shape, dtype=np.float32)
    scores[where] = spoilt
    with pytest.raises(RunError, match=f"the best score is {spoilt}; it must be finite"):
        find_modes(scores, GRID)
    with pytest.raises(RunError, match="the best score is -inf"):
        find_modes(np.full(GRID.shape, -np.inf, dtype=np.float32), GRID)


def test_modes_are_peaks_apart_from_each_other():
    truth, other = [0.3, 0.3, 350.0], [0.8, 0.7, 120.0]
    scores = on_grid(bump(truth, other=other))
    modes, values = find_modes(scores, GRID)
    best = np.unravel_index(scores.argmax(), scores.shape)
    np.testing.assert_array_equal(modes[0], GRID.poses()[GRID.index(*map(int, best))])
    assert values[0] == scores.max()
    assert within_reach(np.array(other), modes[1:2], GRID)[0]
    for m, mode in enumerate(modes):
        assert not within_reach(mode, np.delete(modes, m, axis=0), GRID).any()


def test_of_equal_scores_the_first_candidate_comes_first():
    modes, values = find_modes(np.zeros(GRID.shape, dtype=np.float32), GRID)
    np.testing.assert_array_equal(modes[0], GRID.poses()[0])
    assert (len(modes), values.tolist()) == (MODES, [0.0] * MODES)


def test_candidates_that_a_prior_left_out_are_no_modes():
    scores = np.full(GRID.shape, -np.inf, dtype=np.float32)
    scores[3, 4, 5] = -0.5
    modes, values = find_modes(scores, GRID)
    assert modes.tolist() == [GRID.poses()[GRID.index(3, 4, 5)].tolist()]
    assert values.tolist() == [-0.5]


def test_peaks_lie_across_north():
    grid = PoseGrid(1, 1, 8)
    modes, _ = find_modes(np.array([[[5, 2, 1, 2, 3, 2, 1, 4]]], dtype=np.float32), grid)
    assert modes[:, 2].tolist() == [0.0, 180.0]


def test_a_second_mode_that_is_better_between_candidates_wins():
    """The grid prefers the broad peak; the sharp one is higher, between its candidates."""
    sharp, broad = [0.3095, 0.3095, 42.0], GRID.poses()[GRID.index(15, 15, 30)].tolist()

    def score(poses):
        return torch.maximum(bump(sharp, (0.02, 0.02, 4.0))(poses), 0.9 * bump(broad)(poses))

    scores = on_grid(score)
    assert within_reach(np.array(broad), find_modes(scores, GRID)[0], GRID)[0]
    pose, value = refined(score, sharp, "fine")
    assert within_reach(np.array(sharp), pose[None], GRID)[0]
    assert value > 0.95


# The steps.


def test_no_answer_scores_below_its_start():
    """On a rough surface, where gradients mislead."""
    generator = torch.Generator().manual_seed(0)
    waves = torch.randn(20, 3, generator=generator, dtype=torch.float64) * 40

    def rough(poses):
        return torch.cos((poses * torch.tensor([1.0, 1.0, 0.01])) @ waves.T).sum(dim=1)

    modes, values = map(torch.from_numpy, find_modes(on_grid(rough), GRID))
    assert len(modes) == MODES
    finest = np.array([0.25 / 72.5, 0.25 / 72.5, 0.5])
    fine, fine_values = coarse_to_fine(rough, modes, values, STEPS, finest, PosePrior())
    assert (fine_values > values).all()
    np.testing.assert_allclose(rough(fine), fine_values)
    for pose, value in zip(fine, fine_values, strict=True):
        reached, top = gradient_ascent(rough, pose, finest, PosePrior())
        assert top > value
        assert rough(reached[None]).item() == pytest.approx(top)
    _, answer = refine_modes(rough, modes.numpy(), GRID, PosePrior(), "fine", 72.5)
    _, best = refine_modes(rough, modes.numpy(), GRID, PosePrior(), "continuous", 72.5)
    assert answer[0] == fine_values.max()
    assert best[0] > answer[0]


@pytest.mark.parametrize("how", ["fine", "continuous"])
def test_refined_modes_that_meet_are_one_answer(how):
    """Two candidates beyond each other's reach, and a peak in the middle that both climb."""
    grid = PoseGrid(1, 7, 1)
    truth = [0.5, 0.5, 0.0]
    modes = np.array([[grid.u[column], 0.5, 0.0] for column in (2, 4)])
    assert not within_reach(modes[0], modes[1:], grid).any()
    poses, scores = refine_modes(bump(truth), modes, grid, PosePrior(), how)
    assert len(poses) == len(scores) == 1
    assert scores[0] > bump(truth)(torch.from_numpy(modes)).max()


def test_of_poses_within_reach_the_better_one_is_kept():
    poses = np.array([[0.2, 0.2, 10], [0.8, 0.8, 0], [0.25, 0.2, 350], [0.2, 0.2, 90]], float)
    kept, scores = non_maximum_suppression(poses, np.array([0.5, 0.7, 0.6, 0.4]), GRID)
    assert kept.tolist() == poses[[1, 2, 3]].tolist()
    assert scores.tolist() == [0.7, 0.6, 0.4]
    assert len(non_maximum_suppression(poses, np.array([0.5, 0.7, 0.6, 0.4]), GRID, most=2)[0]) == 2


def test_a_flat_score_moves_nothing():
    def flat(poses):
        return poses.sum(dim=1) * 0.0

    start = torch.tensor([[0.31, 0.52, 47.0]], dtype=torch.float64)
    poses, _ = coarse_to_fine(flat, start, flat(start), STEPS, STEPS / 8, PosePrior())
    assert torch.equal(poses, start)
    assert gradient_ascent(flat, start[0], STEPS, PosePrior())[0].tolist() == start[0].tolist()


def test_steps_of_grids():
    assert grid_steps(GRID) == pytest.approx((1 / 21, 1 / 21, 5.625))
    assert grid_steps(PoseGrid(3, 5, 1, places="endpoints")) == (0.25, 0.5, 0.0)
    assert grid_steps(PoseGrid(1, 1, 4)) == (0.0, 0.0, 90.0)


def test_names_of_refinements():
    assert check_refine(DEFAULT) == DEFAULT
    with pytest.raises(ConfigError, match="one of none, mean, fine, continuous"):
        check_refine("finest")
