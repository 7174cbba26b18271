"""Where photographs say they were taken: EXIF's GPS, or latitude and longitude in their names."""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import ExifTags, Image

from slicematch.data.errors import SampleError

# As in "pano,41.87654,-87.63210,.jpg"; fewer digits are dates, sizes and other numbers.
_IN_NAME = re.compile(r"(?<![\d.])(-?\d{1,2}\.\d{4,})[,_](-?\d{1,3}\.\d{4,})(?!\d)")


@dataclass(frozen=True)
class Fix:
    """A position, and what else a photograph says of its camera.

    Attributes
    ----------
    lat, lon : float
        Degrees on WGS 84.
    accuracy_m : float or None
        How far that may be off, as the receiver reckons it.
    heading_deg : float or None
        Of the image's centre column, clockwise from north; a compass that says magnetic north is
        taken as it is.
    """

    lat: float
    lon: float
    accuracy_m: float | None = None
    heading_deg: float | None = None


def read_fix(path: str | Path) -> Fix:
    """Where a photograph says it was taken.

    Parameters
    ----------
    path : path
        Of an image with GPS in its EXIF data, or whose name holds latitude and longitude, such as
        ``pano,41.87654,-87.63210,.jpg``. EXIF goes first.

    Returns
    -------
    Fix

    Raises
    ------
    SampleError
        If the file cannot be read, or says nothing of its place.
    """
    path = Path(path)
    try:
        with Image.open(path) as image:
            tags = image.getexif().get_ifd(ExifTags.IFD.GPSInfo)
    except FileNotFoundError as error:
        raise SampleError(f"{path}: there is no such file") from error
    except (OSError, SyntaxError, ValueError) as error:  # broken EXIF raises any of these
        raise SampleError(f"{path}: cannot be read as an image ({error})") from error
    lat = _degrees(tags, ExifTags.GPS.GPSLatitude, ExifTags.GPS.GPSLatitudeRef, "S")
    lon = _degrees(tags, ExifTags.GPS.GPSLongitude, ExifTags.GPS.GPSLongitudeRef, "W")
    heading_deg = _number(tags.get(ExifTags.GPS.GPSImgDirection))
    if lat is not None and lon is not None and (lat, lon) != (0.0, 0.0):  # without reception
        accuracy_m = _number(tags.get(ExifTags.GPS.GPSHPositioningError))
        return Fix(lat, lon, accuracy_m or None, heading_deg)
    if named := _IN_NAME.search(path.name):
        return Fix(float(named[1]), float(named[2]), heading_deg=heading_deg)
    raise SampleError(
        f"{path}: says nothing of where it was taken: there is no GPS in its EXIF data and no "
        "latitude and longitude in its name; say where (--near LAT,LON), or list it in a table"
    )


def _degrees(tags: dict[int, Any], tag: int, reference: int, negative: str) -> float | None:
    """Degrees, minutes and seconds as signed degrees."""
    try:
        parts = [float(part) for part in tags[tag]]
        whole = sum(part / 60.0**place for place, part in enumerate(parts))
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        return None
    if not math.isfinite(whole):
        return None
    letter = tags.get(reference, "")
    letter = letter.decode(errors="replace") if isinstance(letter, bytes) else str(letter)
    return -whole if letter.strip("\0 ").upper() == negative else whole


def _number(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) and number >= 0 else None
