"""The belief away from all hypotheses: it moves with the camera, and gives places up to them."""

import numpy as np
import pytest
from slicematch.data.maps import AerialMap
from slicematch.localization.on_map import PlaceOnGlobe
from slicematch.tracking.elsewhere import LEAST_MASS, Elsewhere
from slicematch.tracking.fixes import PlacedFix
from slicematch.tracking.hypotheses import Hypothesis
from slicematch.tracking.local_scores import LocalScorer
from slicematch.tracking.odometry import MotionNoise, Odometry, mean_move
from slicematch.tracking.tiles import TrackTiles

pytest.importorskip("rasterio")


@pytest.fixture(scope="module")
def scorer(localizer, cache):
    return LocalScorer(localizer, cache)


@pytest.fixture
def elsewhere(scorer, mapped):
    """At the map's middle, within 15 m, heading unknown."""
    opened = AerialMap.open(mapped.map)
    south, west, north, east = opened.bounds()
    start = PlaceOnGlobe((south + north) / 2, (west + east) / 2, 15.0)
    tiles = TrackTiles(scorer, opened, (start.lat, start.lon), scorer.localizer.config.tile_side_m)
    yield Elsewhere(scorer, tiles, start, None, MotionNoise(), np.random.default_rng(0))
    tiles.close()


@pytest.fixture(scope="module")
def ground(localizer, mapped):
    return localizer.encode_ground(sorted(mapped.folder.iterdir())[0])


def cloud(pose, probability=1.0):
    states = np.tile([*pose, 1.0, 0.0], (10, 1))
    return Hypothesis(states, np.full(10, 0.1), probability)


def test_it_begins_with_what_is_known_of_the_start(elsewhere, ground):
    search = elsewhere.search(ground, [], None, 0.0)
    assert search.prior.sum() == pytest.approx(1.0)
    square = np.square(search.poses[:, :2]).sum(axis=1)
    fallen = np.log(search.prior) + square / (2 * 15.0**2)
    np.testing.assert_allclose(fallen, fallen[0], atol=1e-9)
    assert np.ptp(search.prior.reshape(-1, 32), axis=1).max() < 1e-12  # no heading is likelier


def test_a_start_that_no_image_was_of_moves_on_too(elsewhere, ground):
    for _ in range(4):
        elsewhere.move(Odometry(10.0), 0.25, 1.0, 0.0)
    elsewhere.probability = 0.1
    search = elsewhere.search(ground, [cloud([0.0, 0.0, 0.0])], None, 0.0)
    ahead = np.abs((search.poses[:, 2] - 90.0 + 180) % 360 - 180) < 1.0  # to the east
    mean = search.prior[ahead] @ search.poses[ahead, :2] / search.prior[ahead].sum()
    np.testing.assert_allclose(mean, [10.0, 0.0], atol=2.5)


@pytest.mark.parametrize(
    "odometry", [Odometry(8.0), Odometry(6.0, 40.0), Odometry(0.0, -30.0), Odometry(5.0, 20.0, 2.0)]
)
def test_it_moves_as_particles_do(elsewhere, ground, odometry):
    search = elsewhere.search(ground, [], None, 0.0)
    peak = np.abs(search.poses - [-2.5, -7.6, 45.0]).sum(axis=1).argmin()
    likely = np.zeros(len(search.prior))
    likely[peak] = 1.0
    elsewhere.keep(search.tile, likely)
    elsewhere.probability = 0.1  # so that the tile around the hypothesis is searched
    state = np.array([[*search.poses[peak], 1.02, 0.5]])
    for _ in range(4):
        elsewhere.move(odometry, 0.25, 1.02, 0.5)
        state = mean_move(state, odometry, 0.25)
    moved = elsewhere.search(ground, [cloud([0.0, 0.0, 250.0])], None, 0.0)
    near = np.hypot(*(moved.poses[:, :2] - state[0, :2]).T) < 6.0
    near &= np.abs((moved.poses[:, 2] - state[0, 2] + 180) % 360 - 180) < 12.0
    kept = moved.prior[near].sum()
    assert kept > 0.8  # the rest has come to the candidates around, as between them it is divided
    mean = moved.prior[near] @ moved.poses[near, :2] / kept
    np.testing.assert_allclose(mean, state[0, :2], atol=1.0)


def test_places_that_are_likely_become_hypotheses_and_are_not_elsewhere_any_more(elsewhere, ground):
    search = elsewhere.search(ground, [], None, 0.0)
    likelihood = np.full(len(search.prior), 1e-3)
    wanted = search.poses[1000], search.poses[4000]
    for pose, more in zip(wanted, (1.0, 0.5), strict=True):
        likelihood[np.abs(search.poses - pose).sum(axis=1).argmin()] = more / 1e-3
    found = search.hypotheses(likelihood, 0.5, 40)
    assert len(found) >= 2
    assert all(one.probability >= LEAST_MASS for one in found)
    total = sum(one.probability for one in found)
    assert total + elsewhere.probability == pytest.approx(0.5)
    means = np.array([one.mean() for one in found])
    for pose in wanted:
        assert np.hypot(*(means[:, :2] - pose[:2]).T).min() < 3.0
    again, checked = elsewhere.search(ground, found, None, 0.0), []
    for one in found:
        mean = one.mean()
        here = np.hypot(*(again.poses[:, :2] - mean[:2]).T) < 3.7
        here &= np.abs((again.poses[:, 2] - mean[2] + 180) % 360 - 180) < 6.0
        checked.append(here.any())
        assert not again.prior[here].any()
    assert any(checked)  # the tile around the likeliest one does not show all of them


def test_a_fix_says_where_to_search(elsewhere, ground):
    search = elsewhere.search(ground, [], None, 0.0)
    elsewhere.keep(search.tile, search.prior)
    elsewhere.probability = 0.9
    here = cloud([0.0, 0.0, 0.0])
    fix = PlacedFix(18.0, -18.0, 3.0, 0.0)
    found = elsewhere.search(ground, [here], fix, 1.0)
    assert np.hypot(found.tile.east_m - 18.0, found.tile.north_m + 18.0) < found.tile.side_m / 4
    likeliest = found.poses[found.prior.argmax(), :2]
    np.testing.assert_allclose(likeliest, [18.0, -18.0], atol=3.0)


def test_where_there_is_no_map_nothing_is_found(elsewhere, ground):
    assert elsewhere.search(ground, [cloud([5000.0, 0.0, 0.0])], None, 0.0) is None
