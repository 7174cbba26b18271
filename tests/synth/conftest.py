"""A small city, its two scenes, and small data sets of both formats, made once."""

import numpy as np
import pytest

from slicemask.synth import generate_kitti, generate_vigor
from slicemask.synth.layout.city import lay_out_city
from slicemask.synth.render.scene import build_scene

VIGOR = {"cities": 2, "panoramas": 5, "seed": 3, "panorama_size": (256, 128), "tile_size": 160}
KITTI = {"frames": 5, "seed": 3, "image_size": (414, 125), "tile_size": 640}


@pytest.fixture(scope="session")
def city():
    """A city of 240 m a side, clear of cars around `cameras`."""
    return lay_out_city(5, 120.0)


@pytest.fixture(scope="session")
def cameras(city):
    """Places on lanes, float64 [12, 2], in the inner part of the city."""
    rng = np.random.default_rng(0)
    lanes = [lane for lane in city.drives() if lane.length > 60]
    places = []
    while len(places) < 12:
        lane = lanes[rng.integers(len(lanes))]
        point = lane.interpolate(rng.uniform(0.1, 0.9), normalized=True)
        if max(abs(point.x), abs(point.y)) < 80:
            places.append((point.x, point.y))
    return np.array(places)


@pytest.fixture(scope="session")
def ground_scene(city, cameras):
    return build_scene(city.clear_of_cars(cameras), "ground")


@pytest.fixture(scope="session")
def aerial_scene(city):
    return build_scene(city, "aerial")


@pytest.fixture(scope="session")
def vigor_tree(tmp_path_factory):
    """Root of a VIGOR tree of two cities, rendered by one process."""
    root = tmp_path_factory.mktemp("vigor")
    generate_vigor(root, jobs=1, **VIGOR)
    return root


@pytest.fixture(scope="session")
def kitti_tree(tmp_path_factory):
    """Root of a KITTI tree, rendered by one process."""
    root = tmp_path_factory.mktemp("kitti")
    generate_kitti(root, jobs=1, **KITTI)
    return root


@pytest.fixture(scope="session")
def vigor_options():
    return VIGOR


@pytest.fixture(scope="session")
def kitti_options():
    return KITTI
