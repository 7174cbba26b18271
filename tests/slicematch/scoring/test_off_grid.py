"""Scores off the grid, held against those of dense masks."""

import numpy as np
import pytest
import torch
from slicematch.network.aggregation import unit
from slicematch.scoring.off_grid import PairScorer
from slicematch.scoring.scores import score_masks

from slicemask import Frustum, slice_masks


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize(
    "frustum",
    [
        Frustum(360, 8),
        Frustum(81.5, 5, "pinhole"),
        Frustum(90, 4),
        Frustum(360, 1),
        Frustum(360, 4, bands=(0.1, 0.3)),
        Frustum(81.5, 3, "pinhole", bands=(0.2,)),
        Frustum(90, 1, bands=(0.25,)),
    ],
)
def test_the_score_is_that_of_dense_masks(frustum, shared):
    parts = frustum.slices * frustum.band_count
    generator = torch.Generator().manual_seed(0)
    ground = unit(torch.randn(1, parts, 7, generator=generator))
    features = torch.randn(1, 7, 6, 6, generator=generator)
    attention = torch.rand(1, 1 if shared else parts, 6, 6, generator=generator)
    scorer = PairScorer(ground[0], features[0], attention[0], frustum)
    rng = np.random.default_rng(0)
    poses = np.column_stack([rng.random((40, 2)), rng.uniform(0, 360, 40)])
    # At the corner, looking out of the tile, there is nothing to see.
    poses[:2] = [[1.0, 1.0, 135.0], [0.0, 0.0, 315.0]]
    masks = torch.from_numpy(slice_masks(poses, frustum, 6, "rays"))
    expected = score_masks(ground, features, attention, masks[None])[0]
    tensor = torch.from_numpy(poses).requires_grad_()
    found = scorer(tensor)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-6)
    if frustum.hfov_deg <= 90:
        assert found[:2].tolist() == [0.0, 0.0]

    (gradient,) = torch.autograd.grad(found[2:].sum(), tensor)
    other = torch.from_numpy(poses[2:]).requires_grad_()
    dense = slice_masks(other, frustum, 6, "rays")
    score_masks(ground, features, attention, dense[None])[0].sum().backward()
    torch.testing.assert_close(gradient[2:], other.grad, rtol=1e-3, atol=1e-4)


def test_a_sliver_counts_as_much_off_the_grid_as_on_it():
    """A camera that nearly touches the edge sees a millionth of a cell: its mean is as long."""
    frustum = Frustum(20, 1)
    generator = torch.Generator().manual_seed(0)
    ground = unit(torch.randn(1, 1, 7, generator=generator))
    features = torch.randn(1, 7, 6, 6, generator=generator)
    attention = torch.rand(1, 1, 6, 6, generator=generator)
    poses = np.array([[0.9999, 0.25, 90.0]])
    masks = torch.from_numpy(slice_masks(poses, frustum, 6, "rays"))
    assert 0 < masks.sum() < 1e-5
    found = PairScorer(ground[0], features[0], attention[0], frustum)(torch.from_numpy(poses))
    expected = score_masks(ground, features, attention, masks[None])[0]
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-6)
    assert abs(found.item()) > 1e-3


def test_contributions_are_those_of_each_part_alone():
    frustum = Frustum(360, 4, bands=(0.1, 0.3))
    generator = torch.Generator().manual_seed(0)
    ground = unit(torch.randn(12, 7, generator=generator))
    features = torch.randn(7, 6, 6, generator=generator)
    attention = torch.rand(12, 6, 6, generator=generator)
    scorer = PairScorer(ground, features, attention, frustum)
    poses = torch.tensor([[0.3, 0.4, 10.0], [1.0, 1.0, 135.0]], dtype=torch.float64)
    found = scorer.contributions(poses)
    assert found.shape == (2, 4, 3)
    torch.testing.assert_close(found.sum(dim=(1, 2)), scorer(poses))
    # Without the ground descriptors of the others, a part's contribution is the whole score.
    for part, (n, b) in enumerate(np.ndindex(4, 3)):
        alone = torch.zeros_like(ground)
        alone[part] = ground[part]
        only = PairScorer(alone, features, attention, frustum).contributions(poses)
        # The score is over the length of all ground descriptors, here of 12 unit vectors or one.
        expected = only[:, n, b] / 12**0.5
        torch.testing.assert_close(found[:, n, b], expected, rtol=1e-5, atol=1e-7)
        assert (only.flatten(1).count_nonzero(dim=1) <= 1).all()
