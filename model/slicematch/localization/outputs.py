"""Files of an estimate: GeoJSON (RFC 7946)."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from slicemask.errors import OutputError
from slicemask.files import check_target, write_text
from slicematch.localization.estimate import Estimate
from slicematch.localization.probabilities import CONFIDENCE, ellipse

GEOJSON_SUFFIXES = (".geojson", ".json")


def feature_collection(
    estimate: Estimate, metres_per_pixel: float, centre: tuple[float, float]
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
        If the centre or the resolution is invalid.
    """
    from slicematch.localization.geodesy import ellipse_geometry  # here, for pyproj's sake

    content = estimate.as_dict(metres_per_pixel, centre)
    position = [content["longitude"], content["latitude"]]
    covariance = np.array(content["covariance"])[:2, :2]
    major_m, minor_m, azimuth_deg = ellipse(covariance)
    point = {"type": "Point", "coordinates": position}
    features = [_feature(point, kind="estimate", **content)]
    if minor_m > 0:  # a place that is known along an axis has no ellipse
        polygon = ellipse_geometry(position, major_m, minor_m, azimuth_deg)
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
    """Return the path of a GeoJSON file to be written, or raise OutputError if it is invalid."""
    return check_target(path, GEOJSON_SUFFIXES, OutputError)


def _feature(geometry: dict[str, Any], **properties: Any) -> dict[str, Any]:
    return {"type": "Feature", "geometry": geometry, "properties": properties}
