"""Places on the globe: latitude and longitude, on WGS 84."""

import logging
import math
from typing import Any

import numpy as np
import pyproj
import shapely
from shapely.geometry.polygon import orient

from slicematch.angles import angle_difference_deg
from slicematch.errors import ConfigError

log = logging.getLogger(__name__)

_WGS84 = pyproj.Geod(ellps="WGS84")
# Corners of the polygon that stands for an ellipse.
_CORNERS = 64
# Nearer to a pole than a degree, a tile's north is no longer one direction.
_MOST_LATITUDE = 89.0
# Web maps end here, and so do their tiles.
_MAP_LATITUDE = 85.06


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


def offset_m(centre: tuple[float, float], place: tuple[float, float]) -> tuple[float, float]:
    """East and north of a place from a centre, metres: the inverse of `offset_position`.

    Parameters
    ----------
    centre, place : (latitude, longitude)
        Degrees.

    Examples
    --------
    >>> east, north = offset_m((52.0, 4.36), offset_position((52.0, 4.36), 30.0, -40.0))
    >>> round(east, 6), round(north, 6)
    (30.0, -40.0)
    """
    azimuth_deg, _, length = _WGS84.inv(centre[1], centre[0], place[1], place[0])
    azimuth = math.radians(azimuth_deg)
    return float(length * math.sin(azimuth)), float(length * math.cos(azimuth))


def check_centre(
    centre: tuple[float, float], what: str = "the tile's centre"
) -> tuple[float, float]:
    """Return the latitude and longitude of a tile's centre, degrees.

    A latitude beyond web maps, with a longitude that would be a latitude, is logged: the two are
    almost surely swapped.

    Raises
    ------
    ConfigError
        If it is no place on the globe, or is too near to a pole.
    """
    latitude, longitude = (float(value) for value in centre)
    could_be_swapped = abs(longitude) <= _MAP_LATITUDE and abs(latitude) <= 180.0
    swapped = f"{longitude:g},{latitude:g}"
    if not (abs(latitude) <= _MOST_LATITUDE and abs(longitude) <= 180.0):
        hint = f"; if the two are swapped, give {swapped}" if could_be_swapped else ""
        raise ConfigError(
            f"{what} is {latitude:g},{longitude:g}; it must be a latitude from "
            f"-{_MOST_LATITUDE:g} to {_MOST_LATITUDE:g} and a longitude from -180 to 180 degrees"
            f"{hint}"
        )
    if abs(latitude) > _MAP_LATITUDE and could_be_swapped:
        log.warning(
            "%s is at latitude %g, beyond all web maps; latitude comes first: if the two are "
            "swapped, give %s",
            what,
            latitude,
            swapped,
        )
    return latitude, longitude


def ellipse_geometry(
    position: list[float], major_m: float, minor_m: float, azimuth_deg: float
) -> dict[str, Any]:
    """The ellipse around (longitude, latitude) as a GeoJSON geometry."""
    angle = np.linspace(0.0, 2.0 * np.pi, _CORNERS, endpoint=False)
    along, across = major_m * np.cos(angle), minor_m * np.sin(angle)
    azimuth = azimuth_deg + np.degrees(np.arctan2(across, along))
    longitude, latitude = (np.full(_CORNERS, value) for value in position)
    around, north, _ = _WGS84.fwd(longitude, latitude, azimuth, np.hypot(along, across))
    # Unwrapped around the centre, so that the ring is whole; then cut where it leaves the map.
    east = position[0] + angle_difference_deg(np.asarray(around), position[0])
    parts = []
    for shift in (0.0, -360.0, 360.0):
        moved = shapely.Polygon(np.column_stack([east + shift, north]))
        part = moved.intersection(shapely.box(-180.0, -90.0, 180.0, 90.0))
        if part.area > 0:
            parts.append(orient(part))
    geometry = parts[0] if len(parts) == 1 else shapely.MultiPolygon(parts)
    return shapely.geometry.mapping(geometry)
