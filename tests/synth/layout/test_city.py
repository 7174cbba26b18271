"""What a city is made of, and that a seed is a city."""

import numpy as np
import shapely

from slicemask.synth.layout.city import lay_out_city
from slicemask.synth.layout.elements import Kind


def test_a_seed_is_a_city(city):
    assert lay_out_city(5, 120.0) == city
    other = lay_out_city(6, 120.0)
    assert other.style != city.style
    assert [street.line for street in other.streets] != [street.line for street in city.streets]


def test_streets_and_footprints_are_shapely_geometry_apart_from_each_other(city):
    roads = shapely.union_all([street.carriageway for street in city.streets])
    footprints = [building.footprint for building in city.buildings]
    assert len(city.streets) > 5
    assert len(footprints) > 30
    assert shapely.intersection(shapely.union_all(footprints), roads).area < 1e-6
    assert 0.12 < roads.area / 240.0**2 < 0.6


def test_there_is_everything_that_a_city_has():
    cities = [lay_out_city(seed, 150.0) for seed in range(3)]
    kinds = {area.kind for city in cities for area in city.areas}
    assert {Kind.ASPHALT, Kind.PAVING, Kind.GRASS, Kind.PLAIN} <= kinds
    assert {b.roof for city in cities for b in city.buildings} == {"flat", "gable", "hip"}
    for city in cities:
        heights = np.array([building.top_m for building in city.buildings])
        assert heights.std() > 2
        assert len({building.facade.colour for building in city.buildings}) > 20
        assert min(map(len, (city.trees, city.landmarks, city.lamps, city.cars_aerial))) > 3
        turned = {round(street.line.coords[0][0]) for street in city.streets}
        assert len(turned) > 3


def test_cars_stand_clear_of_cameras_and_of_each_other(city, cameras):
    clear = city.clear_of_cars(cameras)
    places = np.array([(car.x, car.y) for car in clear.cars_ground])
    apart = np.linalg.norm(places[:, None] - cameras[None], axis=-1)
    assert apart.min() > 5.0
    assert 0 < len(city.cars_ground) - len(clear.cars_ground) < len(city.cars_ground) / 2
    assert clear.cars_aerial == city.cars_aerial
    between = np.linalg.norm(places[:, None] - places[None], axis=-1)
    assert between[~np.eye(len(places), dtype=bool)].min() > 1.7


def test_traffic_keeps_to_the_right(city):
    street = max(city.streets, key=lambda street: street.line.length)
    ahead, back = street.drive(0), street.drive(street.lanes // 2)
    start = shapely.Point(street.line.coords[0])
    assert ahead.project(start) < back.project(start)
    middle = street.line.interpolate(0.5, normalized=True)
    along = np.subtract(
        street.line.interpolate(street.line.length / 2 + 1).coords[0], middle.coords[0]
    )
    aside = np.subtract(ahead.interpolate(ahead.project(middle)).coords[0], middle.coords[0])
    assert along[0] * aside[1] - along[1] * aside[0] < 0  # to the right of the way it goes
