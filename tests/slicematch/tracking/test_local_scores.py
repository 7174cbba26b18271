"""Scores around a belief are those of the closed form at the same poses."""

import numpy as np
import pytest
import torch
from slicematch.scoring.scores import score_candidates
from slicematch.tracking.local_scores import LocalScorer


@pytest.fixture(scope="module")
def scorer(localizer, cache):
    return LocalScorer(localizer, cache)


@pytest.fixture(scope="module")
def encoded(localizer, images):
    ground, aerial = images
    return localizer.encode_ground(ground), localizer.encode_aerial(aerial)


@pytest.fixture(scope="module")
def pair(scorer, encoded):
    ground, tile = encoded
    return ground, scorer.describe(tile)


@pytest.mark.parametrize(
    ("pose", "spread"),
    [
        ([0.5, 0.5, 10.0], [0.02, 0.02, 6.0]),
        ([0.28, 0.7, 355.0], [0.06, 0.05, 20.0]),  # near the edge, across north
        ([0.5, 0.45, 90.0], [0.2, 0.2, 180.0]),  # all headings
    ],
)
def test_candidates_have_the_scores_of_the_closed_form(
    localizer, scorer, encoded, pair, pose, spread
):
    volume = scorer.around(*pair, np.array(pose), np.array(spread))
    rows, columns, headings = volume.scores.shape
    index = np.array([(0, 0, 0), (rows // 2, columns // 2, headings // 2), (-1, -1, -1)])
    index %= [rows, columns, headings]
    first, steps = np.array(volume.first), np.array(volume.steps)
    v, u, heading_deg = (first + steps * index).T
    poses = np.stack([u, v, heading_deg], axis=1)
    with torch.no_grad():
        exact = localizer.pair_scorer(*encoded)(torch.from_numpy(poses)).numpy()
    np.testing.assert_allclose(volume.scores[tuple(index.T)], exact, atol=1e-5)
    np.testing.assert_allclose(volume.at(poses), exact, atol=1e-5)
    assert volume.round == (spread[2] == 180.0)
    # What was asked for lies inside.
    again = np.array([pose]) + np.array([0, 0, 360.0])
    assert volume.at(np.array([pose])) == pytest.approx(volume.at(again))


def test_a_search_scores_the_whole_tile(localizer, scorer, encoded, pair):
    volume = scorer.whole(*pair)
    poses = scorer.coarse_grid.poses()[::997]
    np.testing.assert_allclose(volume.at(poses), volume.scores.ravel()[::997], atol=1e-5)
    with torch.no_grad():
        exact = localizer.pair_scorer(*encoded)(torch.from_numpy(poses)).numpy()
    np.testing.assert_allclose(volume.scores.ravel()[::997], exact, atol=1e-5)


def test_what_is_kept_of_a_tile_gives_the_scores_of_scoring_it_anew(scorer, encoded):
    ground, tile = encoded
    attention = torch.rand(1, 1, *tile.features.shape[-2:])  # one map for all slices
    attention[..., :5, :] = 0  # where nothing is seen
    places, headings = np.array([600, 0, 601, 2303]), np.array([63, 0, 5])
    kept = scorer.fine.describe(tile.features, attention)
    kept.learn(places[:2])
    found = kept.scores(ground, places, headings)
    window = scorer.fine.window(places, headings)
    expected = score_candidates(ground, tile.features, attention, window)[0]
    np.testing.assert_allclose(found, expected, atol=1e-5)
    torch.testing.assert_close(kept.scores(ground, places, headings), found)
