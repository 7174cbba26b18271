"""Files of a track: TUM, KITTI, GeoJSON, CSV and MCAP, by the suffix."""

import csv
import io
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slicemask.errors import OutputError
from slicemask.files import atomic_write, check_target
from slicematch.localization.geodesy import ellipse_geometry
from slicematch.tracking.track_estimate import TrackEstimate


@dataclass(frozen=True)
class Track:
    """Poses over time.

    Attributes
    ----------
    times_s : sequence of float
        By the recording's clock.
    estimates : sequence of TrackEstimate
        As many.
    origin : (latitude, longitude)
        Of the frame of metres: azimuthal equidistant around it, x east, y north.
    """

    times_s: Sequence[float]
    estimates: Sequence[TrackEstimate]
    origin: tuple[float, float]


def check_track_target(path: str | Path) -> Path:
    """Return the path of a track to be written, or raise OutputError if it is invalid."""
    path = check_target(path, tuple(_WRITERS), OutputError)
    if path.suffix.lower() == ".mcap":
        from slicematch.tracking import mcap_output

        mcap_output.check_installed(path)
    return path


def write_track(track: Track, path: str | Path) -> None:
    """Write a track, whole or not at all.

    Parameters
    ----------
    track : Track
    path : path
        ``.tum``: time, x, y, z and a quaternion a line, in metres east, north and up of the origin,
        the quaternion that of a body whose x axis looks ahead. ``.txt``: KITTI's, the twelve
        numbers of a camera's pose a line, x to the east, y down, z to the north of the origin.
        ``.geojson``: the track, each pose, and its ellipse of 95 %. ``.csv``: a row for each pose,
        with its covariance (cov_ee is east with east, cov_en east with north, cov_eh with heading;
        metres and degrees). ``.mcap``: ROS 2 messages geometry_msgs/PoseWithCovarianceStamped on
        ``/slicemask/pose`` and sensor_msgs/NavSatFix on ``/slicemask/fix``.

    Raises
    ------
    OutputError
        If the suffix is another, or the file cannot be written; nothing is left behind.
    """
    path = check_track_target(path)
    with atomic_write(path, OutputError) as partial:
        partial.write_bytes(_WRITERS[path.suffix.lower()](track))


def yaw_quaternion(heading_deg: float) -> tuple[float, float, float, float]:
    """A heading as the quaternion (x, y, z, w) of a body in a frame of east, north and up.

    Examples
    --------
    >>> [round(value, 3) for value in yaw_quaternion(90.0)]
    [0.0, 0.0, 0.0, 1.0]
    """
    half = math.radians(90.0 - heading_deg) / 2.0
    return 0.0, 0.0, math.sin(half), math.cos(half)


def _tum(track: Track) -> bytes:
    lines = []
    for time_s, one in zip(track.times_s, track.estimates, strict=True):
        mode = one.modes[0]
        numbers = [mode.east_m, mode.north_m, 0.0, *yaw_quaternion(one.heading_deg)]
        lines.append(f"{time_s:.6f} " + " ".join(f"{value:.6f}" for value in numbers))
    return _text(lines)


def _kitti(track: Track) -> bytes:
    lines = []
    for one in track.estimates:
        mode, angle = one.modes[0], math.radians(one.heading_deg)
        sin, cos = math.sin(angle), math.cos(angle)
        matrix = [cos, 0, sin, mode.east_m, 0, 1, 0, 0, -sin, 0, cos, mode.north_m]
        lines.append(" ".join(f"{value:.6f}" for value in matrix))
    return _text(lines)


def _csv(track: Track) -> bytes:
    rows = [
        one.as_row() | {"time_s": round(time_s, 6)}
        for time_s, one in zip(track.times_s, track.estimates, strict=True)
    ]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def _geojson(track: Track) -> bytes:
    features: list[dict[str, Any]] = []
    positions = []
    for time_s, one in zip(track.times_s, track.estimates, strict=True):
        row = one.as_row() | {"time_s": round(time_s, 6)}
        position = [row.pop("lon"), row.pop("lat")]
        positions.append(position)
        point = {"type": "Point", "coordinates": position}
        features.append(_feature(point, kind="pose", **row))
        major_m, minor_m = row["ellipse_major_m"], row["ellipse_minor_m"]
        if minor_m > 0:
            polygon = ellipse_geometry(position, major_m, minor_m, row["ellipse_azimuth_deg"])
            features.append(_feature(polygon, kind="uncertainty", time_s=row["time_s"]))
    if len(positions) > 1:
        line = {"type": "LineString", "coordinates": positions}
        features.insert(0, _feature(line, kind="track"))
    collection = {"type": "FeatureCollection", "features": features}
    return (json.dumps(collection, allow_nan=False) + "\n").encode()


def _feature(geometry: dict[str, Any], **properties: Any) -> dict[str, Any]:
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _text(lines: list[str]) -> bytes:
    return ("\n".join(lines) + "\n").encode()


def _mcap(track: Track) -> bytes:
    from slicematch.tracking.mcap_output import mcap_bytes

    return mcap_bytes(track)


_WRITERS: dict[str, Callable[[Track], bytes]] = {
    ".tum": _tum,
    ".txt": _kitti,
    ".geojson": _geojson,
    ".csv": _csv,
    ".mcap": _mcap,
}
