"""Negatives off the training grid: where they lie."""

import numpy as np
import torch
from slicematch.localization.modes import grid_steps
from slicematch.priors import PosePrior
from slicematch.scoring.scores import score_candidates, score_masks
from slicematch.training.negatives import OFFSETS, jittered_candidates, near_poses

from slicemask import Frustum, PoseGrid, slice_masks

GRID = PoseGrid.parse("3x4x8")


def turn(difference_deg):
    return (difference_deg + 180) % 360 - 180


def test_a_jittered_grid_is_the_grid_moved_within_a_cell():
    jittered = jittered_candidates(GRID.poses(), GRID, PosePrior(), Frustum(360, 4), 4, seed=0)
    assert len(jittered) == OFFSETS
    offsets = []
    for candidates in jittered:
        away = candidates.poses - GRID.poses()
        away[:, 2] = turn(away[:, 2])
        np.testing.assert_allclose(away, np.broadcast_to(away[0], away.shape), atol=1e-9)
        assert (np.abs(away[0]) <= np.array(grid_steps(GRID)) / 2).all()
        assert ((candidates.poses[:, :2] >= 0) & (candidates.poses[:, :2] <= 1)).all()
        offsets.append(away[0])
    assert len(np.unique(np.round(offsets, 9), axis=0)) == OFFSETS
    again = jittered_candidates(GRID.poses(), GRID, PosePrior(), Frustum(360, 4), 4, seed=0)
    other = jittered_candidates(GRID.poses(), GRID, PosePrior(), Frustum(360, 4), 4, seed=1)
    np.testing.assert_array_equal(jittered[3].poses, again[3].poses)
    assert (jittered[3].poses != other[3].poses).any()


def test_jittered_candidates_have_their_own_masks():
    frustum = Frustum(360, 4)
    candidates = jittered_candidates(GRID.poses(), GRID, PosePrior(), frustum, 4, seed=0)[5]
    generator = torch.Generator().manual_seed(0)
    ground = torch.randn(1, 4, 3, generator=generator)
    features = torch.randn(1, 3, 4, 4, generator=generator)
    attention = torch.rand(1, 4, 4, 4, generator=generator)
    ground = ground / ground.norm(dim=-1, keepdim=True)
    masks = torch.from_numpy(slice_masks(candidates.poses, frustum, 4, "rays"))
    expected = score_masks(ground, features, attention, masks[None])
    found = score_candidates(ground, features, attention, candidates)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-5)


def test_known_and_bounded_headings_are_kept():
    frustum = Frustum(360, 4)
    for grid, prior in ((GRID, (90.0, 0.0)), (PoseGrid.parse("3x4x1"), None)):
        heading = 90.0 if prior else 0.0
        poses = grid.poses()[grid.poses()[:, 2] == heading]
        for candidates in jittered_candidates(
            poses, grid, PosePrior(heading_prior=prior), frustum, 4, seed=0
        ):
            assert (candidates.poses[:, 2] == heading).all()
    poses = GRID.poses()[GRID.poses()[:, 2] == 0.0]
    prior = PosePrior(heading_prior=(0.0, 10.0))
    turns = [
        turn(some.poses[0, 2]) for some in jittered_candidates(poses, GRID, prior, frustum, 4, 0)
    ]
    assert max(np.abs(turns)) <= 10 + 1e-9
    assert min(turns) < 0 < max(turns)


def test_near_poses_lie_within_a_step_of_the_truth_and_in_the_domain():
    truths = torch.tensor([[0.5, 0.5, 1.0], [0.0, 1.0, 180.0]], dtype=torch.float64)
    poses = near_poses(truths, 500, GRID, PosePrior())
    assert poses.shape == (2, 500, 3)
    assert ((poses[..., :2] >= 0) & (poses[..., :2] <= 1)).all()
    away = (poses - truths[:, None]).numpy()
    away[..., 2] = turn(away[..., 2])
    steps = np.array(grid_steps(GRID))
    assert (np.abs(away) <= steps + 1e-9).all()
    assert (np.abs(away[0]).max(axis=0) > 0.95 * steps).all()

    prior = PosePrior(heading_prior=(0.0, 0.0), place_prior=(0.5, 0.5, 0.1))
    poses = near_poses(truths[:1], 50, GRID, prior)[0].numpy()
    assert (poses[:, 2] == 0).all()
    assert np.hypot(*(poses[:, :2] - 0.5).T).max() <= 0.1 + 1e-9
