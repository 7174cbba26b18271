"""Satellite fixes as weak evidence."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from slicematch.tracking.fixes import ACCURACY_M, LASTS_S, LEAST_M, WRONG, PlacedFix, deviation_of


@given(
    east_m=st.floats(-100, 100),
    north_m=st.floats(-100, 100),
    deviation_m=st.floats(LEAST_M, 200),
)
def test_a_prior_is_at_most_1_in_all_and_rules_nothing_out(east_m, north_m, deviation_m):
    side = np.linspace(-35, 35, 15)
    places = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    fix = PlacedFix(east_m, north_m, deviation_m, 0.0)
    prior = fix.prior(places, 25.0)
    assert prior.sum() <= 1.0 + 1e-9
    assert prior.min() >= WRONG / len(places) * (1 - 1e-9)
    likely = fix.likelihood(places)
    assert likely.min() >= WRONG
    assert likely.max() <= 1.0 + 1e-12


def test_the_prior_of_a_fix_in_the_tile_is_there_and_of_one_far_away_is_nowhere():
    side = np.linspace(-35, 35, 15)
    places = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    near = PlacedFix(10.0, -10.0, 5.0, 0.0).prior(places, 25.0)
    assert places[near.argmax()] == pytest.approx([10.0, -10.0])
    assert near.sum() == pytest.approx(1.0, abs=0.02)
    far = PlacedFix(300.0, 0.0, 5.0, 0.0).prior(places, 25.0)
    assert far.sum() == pytest.approx(WRONG, rel=0.01)


def test_errors_have_a_heavy_tail():
    """Beyond k deviations lie (1 + k^2 / 3)^(-3/2): the integral in two dimensions."""
    fix = PlacedFix(0.0, 0.0, 5.0, 0.0)
    step = 0.5
    side = np.arange(-200.0, 200.0, step) + step / 2
    places = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    density = (fix.likelihood(places) - WRONG) / (1.0 - WRONG) * step**2 / (2.0 * np.pi * 25.0)
    away = np.hypot(*places.T) / 5.0
    for deviations in (2.0, 4.0, 8.0):
        beyond = 1.0 - density[away <= deviations].sum()
        assert beyond == pytest.approx((1.0 + deviations**2 / 3.0) ** -1.5, abs=2e-3)


def test_fixes_do_not_average_while_their_error_lasts():
    def fix(time_s):
        return PlacedFix(0.0, 0.0, 5.0, time_s)

    assert sum(fix(0.1 * (k + 1)).share_after(0.1 * k) for k in range(200)) == pytest.approx(1.0)
    assert fix(5 * LASTS_S).share_after(0.0) == 1.0
    assert fix(1.0).share_after(2.0) == 0.0  # a clock that ran backwards


def test_what_a_fix_says_fades_as_the_camera_goes_on():
    fix = PlacedFix(1.0, 2.0, 3.0, 10.0)
    assert fix.after(0.0) == fix
    assert fix.after(4.0).deviation_m == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("said", "taken"),
    [
        (None, ACCURACY_M), (math.nan, ACCURACY_M), (-1.0, ACCURACY_M), (0.0, ACCURACY_M),
        (math.inf, ACCURACY_M), (0.02, LEAST_M), (7.5, 7.5),
    ],
)  # fmt: skip
def test_a_fix_is_as_accurate_as_it_says_within_reason(said, taken):
    assert deviation_of(said) == taken
