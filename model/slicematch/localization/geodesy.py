"""Estimates on the globe: latitude and longitude, and GeoJSON (RFC 7946)."""

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyproj
import shapely
from shapely.geometry.polygon import orient

from slicemask.errors import OutputError
from slicemask.files import check_target, write_text
from slicematch.errors import ConfigError
from slicematch.evaluation.metrics import turn_deg
from slicematch.localization.probabilities import CONFIDENCE, ellipse

if TYPE_CHECKING:
    from slicematch.localization.localizer import Estimate

_WGS84 = pyproj.Geod(ellps="WGS84")
# Corners of the polygon that stands for an ellipse.
_CORNERS = 64
# Nearer to a pole than a degree, a tile's north is no longer one direction.
_MOST_LATITUDE = 89.0


def offset_position(
    centre: tuple[float, float], east_m: float, north_m: float
) -> tuple[float, float]:
    """Latitude and longitude of a point by its offset from another: the geodesic on WGS 84.

    Parameters
    ----------
    centre : (latitude, longitude)
        Degrees.
    east_m, north_m : float
        Metres on the ground.

    Returns
    -------
    latitude, longitude : float
        Degrees, the longitude in [-180, 180].

    Raises
    ------
    ConfigError
        If the centre is no place on the globe, or is a pole.

    Examples
    --------
    >>> latitude, longitude = offset_position((52.0, 4.36), 0.0, 111.2)
    >>> round(latitude, 4), round(longitude, 4)
    (52.001, 4.36)
    """
    latitude, longitude = check_centre(centre)
    azimuth_deg = math.degrees(math.atan2(east_m, north_m))
    found_longitude, found_latitude, _ = _WGS84.fwd(
        longitude, latitude, azimuth_deg, math.hypot(east_m, north_m)
    )
    return float(found_latitude), float(found_longitude)


def check_centre(centre: tuple[float, float]) -> tuple[float, float]:
    """The latitude and longitude of a tile's centre, or ConfigError if they cannot be."""
    latitude, longitude = (float(value) for value in centre)
    if not (abs(latitude) <= _MOST_LATITUDE and abs(longitude) <= 180.0):
        raise ConfigError(
            f"the tile's centre is {latitude:g},{longitude:g}; it must be a latitude from "
            f"-{_MOST_LATITUDE:g} to {_MOST_LATITUDE:g} and a longitude from -180 to 180 degrees"
        )
    return latitude, longitude


def feature_collection(
    estimate: "Estimate", metres_per_pixel: float, centre: tuple[float, float]
) -> dict[str, Any]:
    """An estimate as a GeoJSON FeatureCollection: its point, and its ellipse of uncertainty.

    Parameters
    ----------
    estimate : Estimate
        In a tile with north up.
    metres_per_pixel : float
        Of the tile as it was handed in.
    centre : (latitude, longitude)
        Of the tile, degrees.

    Returns
    -------
    collection : dict
        Plain values, ready for `json.dump`. The point's properties are those of
        `Estimate.as_dict`; the polygon is the ellipse that holds 95 % of the mode that the
        estimate is the best pose of, if its places are normally distributed. Positions are
        (longitude, latitude), rings closed and counter-clockwise; a polygon across the
        antimeridian is cut in two.

    Raises
    ------
    ConfigError
        If the centre or the resolution cannot be.
    """
    content = estimate.as_dict(metres_per_pixel, centre)
    position = [content["longitude"], content["latitude"]]
    covariance = np.array(content["covariance"])[:2, :2]
    major_m, minor_m, azimuth_deg = ellipse(covariance)
    point = {"type": "Point", "coordinates": position}
    features = [_feature(point, kind="estimate", **content)]
    if minor_m > 0:  # a place that is known along an axis has no ellipse
        polygon = _ellipse_geometry(position, major_m, minor_m, azimuth_deg)
        features.append(
            _feature(
                polygon,
                kind="uncertainty",
                confidence=CONFIDENCE,
                major_m=major_m,
                minor_m=minor_m,
                azimuth_deg=azimuth_deg,
            )
        )
    return {"type": "FeatureCollection", "features": features}


def save_geojson(collection: dict[str, Any], path: str | Path) -> None:
    """Write a collection; a file already there is replaced.

    Raises
    ------
    OutputError
        If the suffix is neither ``.geojson`` nor ``.json``, or the file cannot be written;
        nothing is left behind.
    """
    text = json.dumps(collection, indent=1, allow_nan=False) + "\n"
    write_text(check_geojson_target(path), text, OutputError)


def check_geojson_target(path: str | Path) -> Path:
    """Return the path of a GeoJSON file to be written, or raise OutputError if it cannot be one."""
    return check_target(path, (".geojson", ".json"), OutputError)


def _feature(geometry: dict[str, Any], **properties: Any) -> dict[str, Any]:
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _ellipse_geometry(
    position: list[float], major_m: float, minor_m: float, azimuth_deg: float
) -> dict[str, Any]:
    """The ellipse around (longitude, latitude) as a GeoJSON geometry."""
    turn = np.linspace(0.0, 2.0 * np.pi, _CORNERS, endpoint=False)
    along, across = major_m * np.cos(turn), minor_m * np.sin(turn)
    azimuth = azimuth_deg + np.degrees(np.arctan2(across, along))
    longitude, latitude = (np.full(_CORNERS, value) for value in position)
    around, north, _ = _WGS84.fwd(longitude, latitude, azimuth, np.hypot(along, across))
    # Unwrapped around the centre, so that the ring is whole; then cut where it leaves the map.
    east = position[0] + turn_deg(np.asarray(around), position[0])
    parts = []
    for shift in (0.0, -360.0, 360.0):
        moved = shapely.Polygon(np.column_stack([east + shift, north]))
        part = moved.intersection(shapely.box(-180.0, -90.0, 180.0, 90.0))
        if part.area > 0:
            parts.append(orient(part))
    geometry = parts[0] if len(parts) == 1 else shapely.MultiPolygon(parts)
    return shapely.geometry.mapping(geometry)
