"""Latitude, longitude and GeoJSON, held to RFC 7946."""

import json
import math

import numpy as np
import pyproj
import pytest
import shapely
from slicematch.errors import ConfigError
from slicematch.localization.estimate import Estimate
from slicematch.localization.geodesy import offset_position
from slicematch.localization.modes import Mode, within_reach
from slicematch.localization.outputs import feature_collection

from slicemask import PoseGrid

GRID = PoseGrid.parse("41x41x8")
DELFT = (52.0, 4.36)


def estimate(u=0.7, v=0.4, spread=(0.03, 0.02)):
    """An estimate whose probabilities are normal around a pose: wide to the east."""
    away = (GRID.poses()[:, :2] - (u, v)) / spread
    scores = (-0.5 * (away**2).sum(axis=1)).reshape(GRID.shape)
    modes = (Mode(np.array([u, v, 30.0]), 0.9, 0.8), Mode(np.array([0.1, 0.1, 5.0]), 0.5, 0.1))
    return Estimate(modes, scores, GRID, 640, temperature=1.0)


@pytest.mark.parametrize("centre", [DELFT, (-33.9, 151.2), (0.0, 0.0), (70.0, -179.9999)])
@pytest.mark.parametrize("offset", [(30.0, 0.0), (0.0, -40.0), (-25.0, 17.0), (0.0, 0.0)])
def test_positions_are_where_the_geodesic_says(centre, offset):
    latitude, longitude = offset_position(centre, *offset)
    assert -180 <= longitude <= 180
    # Back in metres, in a projection that owes nothing to the geodesic's forward problem.
    local = pyproj.Transformer.from_crs(
        "EPSG:4326", f"+proj=aeqd +lat_0={centre[0]} +lon_0={centre[1]} +ellps=WGS84"
    )
    np.testing.assert_allclose(local.transform(latitude, longitude), offset, atol=1e-6)


@pytest.mark.parametrize("centre", [(91.0, 0.0), (89.5, 0.0), (0.0, 180.5), (math.nan, 0.0)])
def test_centres_that_cannot_be(centre):
    with pytest.raises(ConfigError, match=r"the tile's centre is .* a latitude from -89 to 89"):
        offset_position(centre, 0.0, 0.0)


def check_ring(ring):
    """RFC 7946, 3.1.6: closed, at least four positions, counter-clockwise."""
    assert len(ring) >= 4
    assert ring[0] == ring[-1]
    assert all(len(position) == 2 for position in ring)
    assert all(-180 <= lon <= 180 and -90 <= lat <= 90 for lon, lat in ring)
    assert shapely.LinearRing(ring).is_ccw
    assert shapely.Polygon(ring).is_valid


def test_the_collection_is_geojson():
    content = json.loads(json.dumps(feature_collection(estimate(), 0.1, DELFT), allow_nan=False))
    assert set(content) == {"type", "features"}
    assert content["type"] == "FeatureCollection"
    point, area = content["features"]
    for feature in (point, area):
        assert set(feature) == {"type", "geometry", "properties"}
        assert feature["type"] == "Feature"
    assert point["geometry"]["type"] == "Point"
    longitude, latitude = point["geometry"]["coordinates"]
    assert (latitude, longitude) == offset_position(DELFT, 0.2 * 64, 0.1 * 64)
    properties = point["properties"]
    assert {"heading_deg", "score", "u", "v", "probability", "covariance"} <= set(properties)
    assert properties["heading_deg"] == 30.0
    (other,) = properties["other_modes"]
    assert (other["latitude"], other["longitude"]) == offset_position(DELFT, -0.4 * 64, 0.4 * 64)
    assert area["geometry"]["type"] == "Polygon"
    (ring,) = area["geometry"]["coordinates"]
    check_ring(ring)
    # GDAL's reader, by way of shapely, sees what was written.
    shape = shapely.from_geojson(json.dumps(area["geometry"]))
    assert shape.contains(shapely.Point(longitude, latitude))


def test_the_ellipse_holds_what_it_says():
    made = estimate()
    _, area = feature_collection(made, 0.1, DELFT)["features"]
    properties = area["properties"]
    side = 64.0
    variances = np.array([0.03, 0.02]) ** 2 + (1 / 41) ** 2 / 12
    half_axes = np.sqrt(5.991 * variances) * side
    assert properties["azimuth_deg"] == pytest.approx(90, abs=1)
    assert properties["major_m"] == pytest.approx(half_axes[0], rel=0.03)
    assert properties["minor_m"] == pytest.approx(half_axes[1], rel=0.03)
    surface, _ = pyproj.Geod(ellps="WGS84").geometry_area_perimeter(
        shapely.geometry.shape(area["geometry"])
    )
    full = np.pi * properties["major_m"] * properties["minor_m"]
    assert full * 0.99 < surface < full  # positive: counter-clockwise
    # The candidates around the answer that lie in it hold some 95 % of what is near.
    shape, poses = shapely.geometry.shape(area["geometry"]), GRID.poses()
    some = np.flatnonzero(within_reach(made.pose, poses, GRID))
    inside = [
        shape.contains(
            shapely.Point(offset_position(DELFT, (u - 0.5) * side, (0.5 - v) * side)[::-1])
        )
        for u, v, _ in poses[some]
    ]
    weights = made.probabilities.ravel()[some]
    assert weights[inside].sum() / weights.sum() > 0.9


def test_an_ellipse_across_the_antimeridian_is_cut_in_two():
    _, area = feature_collection(estimate(0.5, 0.5), 0.1, (10.0, 180.0))["features"]
    assert area["geometry"]["type"] == "MultiPolygon"
    parts = area["geometry"]["coordinates"]
    assert len(parts) == 2
    for (ring,) in parts:
        check_ring(ring)
    assert sorted(max(ring, key=lambda p: abs(p[0]))[0] for (ring,) in parts) == [-180.0, 180.0]


def test_a_known_place_has_no_ellipse():
    known = Estimate(
        (Mode(np.array([0.5, 0.5, 0.0]), 1.0, 1.0),), np.zeros((1, 1, 1)), PoseGrid(1, 1, 1), 8, 0.1
    )
    (point,) = feature_collection(known, 0.1, DELFT)["features"]
    np.testing.assert_allclose(point["geometry"]["coordinates"], DELFT[::-1])
