"""Suburbs, open country, roundabouts, roads, seasons: what stands where."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from slicemask.synth.layout.city import MARKING_M
from slicemask.synth.layout.elements import Kind
from slicemask.synth.render.foliage import SPECIES, foliage
from slicemask.synth.vary.country import FIELDS, lay_out_country
from slicemask.synth.vary.places import in_season, lay_out
from slicemask.synth.vary.roads import PAVEMENTS, repave
from slicemask.synth.vary.season import Season, dress
from slicemask.synth.vary.suburbs import lay_out_suburb
from slicemask.synth.vary.switches import SWITCHES, Variation
from slicemask.synth.vary.trees import Flora, grow

ALL = tuple(SWITCHES)
LAYOUTS = {"suburbs": lay_out_suburb, "country": lay_out_country}


def places(name, count=5):
    return [LAYOUTS[name]((k,), 150.0, Variation(ALL, (k,))) for k in range(count)]


@pytest.fixture(scope="module")
def suburbs():
    return places("suburbs")


@pytest.fixture(scope="module")
def countries():
    return places("country")


def test_a_seed_is_a_place(suburbs, countries):
    assert places("suburbs", 1)[0] == suburbs[0]
    assert places("country", 1)[0] == countries[0]
    assert suburbs[0] != suburbs[1]


@pytest.mark.parametrize("name", ["suburbs", "countries"])
def test_houses_and_trunks_stand_off_the_roads(name, request):
    for city in request.getfixturevalue(name):
        roads = shapely.union_all([street.carriageway for street in city.streets])
        houses = [building.footprint for building in city.buildings]
        assert shapely.union_all(houses).intersection(roads).area < 1e-6
        trunks = np.array([(tree.x, tree.y) for tree in city.trees])
        islands = shapely.union_all(city.islands)
        on_road = shapely.contains_xy(roads, trunks) & ~shapely.contains_xy(islands, trunks)
        assert not on_road.any()
        assert all(tree.species in SPECIES for tree in city.trees)


def test_suburbs_have_detached_houses_with_drives(suburbs):
    for city in suburbs:
        assert len(city.buildings) > 15
        assert max(building.top_m for building in city.buildings) < 12
        kinds = {area.kind for area in city.areas}
        assert kinds & {Kind.GRASS, Kind.MEADOW}
        assert kinds & {Kind.CONCRETE, Kind.GRAVEL, Kind.TAR, Kind.DIRT}


def test_country_is_fields_and_woods_along_few_roads(countries):
    for city in countries:
        roads = shapely.union_all([street.carriageway for street in city.streets])
        assert 0.01 < roads.area / 300.0**2 < 0.15
        assert len(city.buildings) < 60
    found = {area.kind for city in countries for area in city.areas}
    assert {kind for kind, _ in FIELDS.values()} <= found
    assert sum(bool(city.backdrops) for city in countries) > 1


def test_lanes_end_at_the_islands_of_roundabouts(suburbs):
    with_islands = [city for city in suburbs if city.islands]
    assert with_islands
    for city in with_islands:
        islands = shapely.union_all(city.islands)
        assert min(lane.distance(islands) for lane in city.drives()) > 1.0
        for car in (*city.cars_ground, *city.cars_aerial):
            assert islands.distance(shapely.Point(car.x, car.y)) > 2.0


@pytest.mark.parametrize("names", [("suburbs",), ("country",), ("suburbs", "country")])
def test_kinds_of_places_take_turns(names):
    variation = Variation(names, (3,))
    kinds = len(names) + 1
    cities = [lay_out((3, 0, 1000 + k), 90.0, variation, k) for k in range(kinds)]
    # Today's cities alone have leaves without a species.
    assert [any(not tree.species for tree in city.trees) for city in cities].count(True) == 1
    # Switched off, they are the city of today.
    assert lay_out((5,), 120.0, Variation((), (5,)), 0).base[0] is Kind.ASPHALT


def test_roads_are_paved_anew_and_their_markings_fade_or_go(city):
    drawn = [repave(city, np.random.default_rng(seed)) for seed in range(12)]
    assert len({one.base[0] for one in drawn}) > 1
    assert {one.base[0] for one in drawn} <= {kind for kind, *_ in PAVEMENTS.values()}
    before = [area for area in city.areas if area.top_m == MARKING_M]
    counts = [sum(area.top_m == MARKING_M for area in one.areas) for one in drawn]
    assert min(counts) < 0.5 * len(before)
    assert max(counts) == len(before)
    assert drawn[0].buildings == city.buildings


def test_trees_stay_in_their_places_and_get_species(city):
    rng = np.random.default_rng(1)
    grown = grow(city, Flora.draw(rng), rng)
    assert [(t.x, t.y) for t in grown.trees] == [(t.x, t.y) for t in city.trees]
    assert len({tree.species for tree in grown.trees}) > 1


@pytest.mark.parametrize("name", SPECIES)
def test_crowns_have_the_size_that_was_drawn(name):
    rng = np.random.default_rng(0)
    tree = replace(Flora.draw(rng).tree(10.0, -4.0, rng, name), height_m=10.0, radius_m=4.0)
    for fine in (False, True):
        soup = np.concatenate([part[0] for part in foliage([tree], [fine])]).reshape(-1, 3)
        reach = np.hypot(soup[:, 0] - 10.0, soup[:, 1] + 4.0)
        assert 2.5 < reach.max() < 7.0
        assert 7.0 < soup[:, 2].max() < 12.5
        assert soup[:, 2].min() > -1.5


def test_a_season_turns_leaves_and_grass_and_bares_trees(suburbs):
    city = suburbs[0]
    red, straw = (0.8, 0.1, 0.1), (0.7, 0.6, 0.3)
    autumn = dress(city, Season((red,), 1.0, 0.5, straw, 1.0), np.random.default_rng(0))
    assert [(t.x, t.y) for t in autumn.trees] == [(t.x, t.y) for t in city.trees]
    bare = [tree.species for tree in autumn.trees].count("bare")
    deciduous = sum(tree.species in ("broad", "wood", "sparse") for tree in city.trees)
    assert bare > 0.3 * deciduous
    redness = [np.mean([t.colour[0] - t.colour[1] for t in one.trees]) for one in (city, autumn)]
    assert redness[1] > redness[0] + 0.02
    grass = [np.mean([a.colour for a in one.areas if a.kind is Kind.GRASS], axis=0)
             for one in (city, autumn)]  # fmt: skip
    assert grass[1] == pytest.approx(0.2 * grass[0] + 0.8 * np.array(straw), abs=0.02)


def test_half_of_the_places_are_seen_in_one_season_by_both(city):
    same = [
        in_season(city, variation, "ground").trees == in_season(city, variation, "aerial").trees
        for variation in (Variation(("season",), (seed,)) for seed in range(24))
    ]
    assert 5 < sum(same) < 19
    assert in_season(city, Variation((), (0,)), "ground") is city
