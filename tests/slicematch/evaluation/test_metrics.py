"""Errors of poses by hand, and oracle errors against the distance to every candidate."""

import numpy as np
import pytest
from slicematch.evaluation.metrics import heading_error_deg, oracle_error, pose_errors, recall

from slicemask import PoseGrid
from slicemask.errors import PoseError


@pytest.mark.parametrize(
    ("heading_deg", "east_m", "north_m", "lateral_m", "longitudinal_m"),
    [
        (0, 3, 4, 3, 4),
        (90, 3, 4, 4, 3),
        (180, 3, -4, 3, 4),
        (270, -3, 4, 4, 3),
        # Off the axes: folding the signs before the turn would exchange these two.
        (45, 3, 3, 0, np.sqrt(18)),
        (45, 3, -3, np.sqrt(18), 0),
        (135, 3, -3, 0, np.sqrt(18)),
        (225, -2, -2, 0, np.sqrt(8)),
    ],
)
def test_errors_across_and_along_the_true_heading(
    heading_deg, east_m, north_m, lateral_m, longitudinal_m
):
    tile_metres = 50.0
    truth = [0.4, 0.6, heading_deg]
    # The estimate's own heading must not matter.
    estimate = [0.4 + east_m / tile_metres, 0.6 - north_m / tile_metres, heading_deg + 77]
    errors = pose_errors([estimate], [truth], tile_metres)
    assert errors.lateral_m == pytest.approx([lateral_m], abs=1e-9)
    assert errors.longitudinal_m == pytest.approx([longitudinal_m], abs=1e-9)
    assert errors.place_m == pytest.approx([np.hypot(east_m, north_m)])
    assert errors.heading_deg == pytest.approx([77])


def test_each_sample_has_its_own_metres():
    errors = pose_errors([[0.5, 0.6, 0]] * 2, [[0.5, 0.5, 0]] * 2, [10.0, 70.0])
    assert errors.place_m == pytest.approx([1.0, 7.0])


@pytest.mark.parametrize(
    ("estimate", "truth", "error"),
    [(10, 350, 20), (350, 10, 20), (0, 180, 180), (0, 360, 0), (270, 0, 90), (5, 5, 0)],
)
def test_headings_differ_the_short_way_round(estimate, truth, error):
    assert heading_error_deg(estimate, truth) == error


def test_recalls_are_strict():
    assert recall([0.5, 1.0, 4.9, 5.0], 1) == 0.25
    assert recall([0.5, 1.0, 4.9, 5.0], 5) == 0.75


def test_summary():
    truths = np.tile([0.5, 0.5, 0.0], (4, 1))
    east_m = np.array([0.5, 1.0, 2.0, 8.5])
    estimates = truths + np.stack([east_m / 100, np.zeros(4), [0.5, 355, 20, 4]], axis=1)
    assert pose_errors(estimates, truths, 100.0).summary() == pytest.approx(
        {
            "place_mean_m": 3.0,
            "place_median_m": 1.5,
            "heading_mean_deg": 7.375,
            "heading_median_deg": 4.5,
            "lateral_recall_1m": pytest.approx(0.25),
            "lateral_recall_3m": 0.75,
            "lateral_recall_5m": 0.75,
            "longitudinal_recall_1m": 1.0,
            "longitudinal_recall_3m": 1.0,
            "longitudinal_recall_5m": 1.0,
            "heading_recall_1deg": 0.25,
            "heading_recall_3deg": 0.25,
            "heading_recall_5deg": 0.5,
        }
    )


@pytest.mark.parametrize(
    "grid",
    [
        PoseGrid(4, 5, 8),
        PoseGrid(3, 3, 1),
        PoseGrid(5, 4, 6, extent=(0.25, 0.25, 0.75, 0.5)),
        PoseGrid(3, 4, 5, places="endpoints"),
    ],
    ids=str,
)
def test_the_oracle_error_is_the_least_error_of_any_candidate(grid):
    rng = np.random.default_rng(0)
    truths = rng.uniform(0, [1, 1, 360], (50, 3))
    truths[:3, 2] = 0.0, 359.999, 180.0
    tile_metres = rng.uniform(50, 80, 50)
    candidates = rng.permutation(grid.poses())
    oracle = oracle_error(candidates, truths, tile_metres)
    every = [pose_errors(np.tile(k, (50, 1)), truths, tile_metres) for k in candidates]
    assert oracle.place_m == pytest.approx(np.min([e.place_m for e in every], axis=0))
    assert oracle.heading_deg == pytest.approx(np.min([e.heading_deg for e in every], axis=0))


def test_the_oracle_error_of_candidates_within_a_prior():
    """Headings from 350 to 10 degrees, in whatever order."""
    candidates = [[0.5, 0.5, h] for h in (5, 350, 0, 355, 10)]
    oracle = oracle_error(candidates, [[0.5, 0.5, h] for h in (357, 180, 340, 12)], 1.0)
    assert oracle.heading_deg.tolist() == [2, 170, 10, 2]
    assert oracle.summary() == {
        "place_mean_m": 0.0,
        "place_median_m": 0.0,
        "heading_mean_deg": 46.0,
        "heading_median_deg": 6.0,
    }


@pytest.mark.parametrize(
    ("estimates", "truths", "message"),
    [
        ([], [], r"true poses have shape \(0,\)"),
        ([[0.5, 0.5]], [[0.5, 0.5, 0]], r"estimated poses have shape \(1, 2\)"),
        ([[0.5, 0.5, 0]] * 2, [[0.5, 0.5, 0]], "2 estimated poses for 1 true ones"),
        ([[0.5, np.nan, 0]], [[0.5, 0.5, 0]], "estimated poses have .* in row 0; expected finite"),
    ],
)
def test_poses_that_cannot_be_compared(estimates, truths, message):
    with pytest.raises(PoseError, match=message):
        pose_errors(estimates, truths, 1.0)


def test_there_is_no_recall_of_nothing():
    with pytest.raises(PoseError, match="at least one sample is needed"):
        recall([], 1)
