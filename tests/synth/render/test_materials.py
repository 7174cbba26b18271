"""Patterns and geometry that pictures are made of."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from slicemask.synth.layout.elements import Building, Facade
from slicemask.synth.render import meshes
from slicemask.synth.render.patterns import noise, pulse


@given(
    x=st.floats(-50, 50),
    period=st.floats(0.3, 4),
    duty=st.floats(0.05, 0.95),
    width=st.floats(0.05, 9),
)
def test_pulse_is_the_mean_of_stripes_over_a_pixel(x, period, duty, width):
    samples = x + width * ((np.arange(20_000) + 0.5) / 20_000 - 0.5)
    expected = np.mean((samples / period) % 1.0 < duty)
    found = pulse(np.float32([x]), period, duty, np.float32([width]))
    assert found[0] == pytest.approx(expected, abs=2e-3 + 3e-5 * 50 / width)


def test_noise_is_smooth_and_fades_where_pixels_are_wider():
    x = np.linspace(0, 50, 5001, dtype=np.float32)
    fine = noise(x, 0 * x, 1.0, np.full_like(x, 0.01))
    assert np.abs(np.diff(fine)).max() < 0.05
    assert fine.std() > 0.2
    assert not noise(x, 0 * x, 1.0, np.full_like(x, 1.6)).any()


def area(soup):
    a, b, c = np.moveaxis(soup, 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


def test_prisms_have_the_areas_of_their_polygons_and_walls():
    ring = shapely.Point(0, 0).buffer(5).difference(shapely.box(-1, -1, 1, 1))
    soup, owner, side = meshes.prisms(
        meshes.as_polygons([ring, shapely.box(10, 0, 14, 3)]), [0.0, 1.0], [2.0, 5.0]
    )
    assert area(soup[~side & (owner == 0)]) == pytest.approx(ring.area)
    assert area(soup[side & (owner == 0)]) == pytest.approx(2.0 * ring.length)
    assert area(soup[side & (owner == 1)]) == pytest.approx(4.0 * 14.0)
    # Corner 0 is where lengths along a wall are measured from; corner 1 lies at its far end.
    run = np.linalg.norm((soup[side & (owner == 1)][:, 1] - soup[side & (owner == 1)][:, 0])[:, :2],
                         axis=1)  # fmt: skip
    assert set(np.round(run, 6)) == {3.0, 4.0}


@pytest.mark.parametrize("roof", ["gable", "hip"])
def test_pitched_roofs_cover_their_walls_and_rise_to_a_ridge(roof):
    house = shapely.affinity.rotate(shapely.box(0, 0, 12, 8), 33)
    grey = (0.5, 0.5, 0.5)
    building = Building(house, 6.0, Facade(grey, grey, grey), grey, roof)
    slopes, gables = meshes.pitched_roof(building)
    covered = shapely.union_all([shapely.Polygon(t[:, :2]).buffer(1e-9) for t in slopes])
    assert covered.covers(house)
    assert slopes[..., 2].max() == pytest.approx(6.0 + 0.55 * 4)
    assert len(gables) == (2 if roof == "gable" else 0)
