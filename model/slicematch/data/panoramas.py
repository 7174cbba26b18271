"""Panoramas: read as whole spheres, and turned to a heading."""

import logging
import math
import re
from typing import NamedTuple

import numpy as np
from PIL import Image

from slicemask.errors import ImageError
from slicemask.images import (
    ASPECT_TOLERANCE,
    MAX_PIXELS,
    Picture,
    check_aspect,
    name_of,
    read_image,
)

# Headings are drawn on whole columns of a panorama of this width, VIGOR's.
HEADING_COLUMNS = 2048
# Above it, the rows of a panorama are no longer rows of equal elevation.
MAX_TILT_DEG = 2.0
_NAMESPACE = "http://ns.google.com/photos/1.0/panorama/"
log = logging.getLogger(__name__)
# What has been said of panoramas in this process: once of each kind.
_said: set[str] = set()


class Panorama(NamedTuple):
    """A whole sphere.

    Attributes
    ----------
    image : PIL.Image.Image
        Equirectangular, twice as wide as high.
    heading_deg : float or None
        Of its centre column, degrees clockwise from north, if the file says so.
    """

    image: Image.Image
    heading_deg: float | None


def read_panorama(source: Picture) -> Panorama:
    """Read a panorama as a whole sphere.

    If its GPano data (XMP, namespace http://ns.google.com/photos/1.0/panorama/) say that it is a
    part of a sphere, it is pasted where it belongs and the rest is black; their heading is passed
    on. Either is logged once.

    Parameters
    ----------
    source : path, PIL image or array [height, width, 3]
        As `slicemask.images.read_image` takes it. Of PIL images, ``info["xmp"]`` counts.

    Raises
    ------
    ImageError
        If it is unreadable, not twice as wide as high, of another projection, tilted by more than
        `MAX_TILT_DEG`, or its GPano data are inconsistent.
    """
    image, name = read_image(source), name_of(source)
    data = gpano_properties(image.info.get("xmp"))
    projection = data.get("ProjectionType", "equirectangular")
    if projection != "equirectangular":
        raise ImageError(
            f"{name}: its GPano data say that its projection is {projection!r}; a panorama must be "
            "equirectangular: convert it"
        )
    for key in ("PosePitchDegrees", "PoseRollDegrees"):
        tilt = _number(data, key, name)
        # A turn of nearly 360 degrees is a small one, too.
        if tilt is not None and abs((tilt + 180) % 360 - 180) > MAX_TILT_DEG:
            raise ImageError(
                f"{name}: its GPano data say {key} {tilt:g}; a panorama must be level within "
                f"{MAX_TILT_DEG:g} degrees: level it"
            )
    image = _whole_sphere(image, data, name)
    check_aspect(image, name, 2.0, "a panorama")
    heading_deg = _number(data, "PoseHeadingDegrees", name)
    if heading_deg is not None:
        heading_deg %= 360.0
        _say_once("heading", f"{name}: its GPano data say that it faces {heading_deg:g} degrees")
    return Panorama(image, heading_deg)


def turn_panorama(image: Image.Image, heading_deg: float, size: tuple[int, int]) -> Image.Image:
    """Turn a panorama with north at its centre so that it faces a heading, and resize it.

    The image rolls **left** by W * heading_deg / 360 columns of its own width W. Whole columns are
    rolled and the rest goes into the resampling, so that the centre of the result faces the very
    heading asked for, whatever W is. Columns wrap round at both edges.

    Parameters
    ----------
    image : PIL.Image.Image
        Equirectangular, 360 degrees wide, north at the centre column, east at 3/4 of the width.
    heading_deg : float
        Degrees clockwise from north.
    size : (height, width)
        Of the result, in pixels.

    Returns
    -------
    PIL.Image.Image
        Of that size.
    """
    width, height = image.size
    whole, rest = divmod(width * heading_deg / 360.0, 1.0)
    # What the resampling filter may reach beyond either edge.
    margin = math.ceil(width / size[1]) + 2
    pixels = np.roll(np.asarray(image), -int(whole), axis=1)
    wrapped = np.pad(pixels, ((0, 0), (margin, margin), (0, 0)), mode="wrap")
    box = (margin + rest, 0, margin + rest + width, height)
    return Image.fromarray(wrapped).resize(size[::-1], Image.Resampling.BILINEAR, box=box)


def draw_heading_deg(random: np.random.Generator, prior: tuple[float, float] | None) -> float:
    """A heading for a panorama to be turned to, on whole columns of 2048.

    Parameters
    ----------
    random : numpy.random.Generator
        What it is drawn from.
    prior : (centre, half width) or None
        Within the half width of the centre, degrees; None for any heading.

    Returns
    -------
    float
        Degrees clockwise from north.
    """
    if prior is None:
        column = random.integers(HEADING_COLUMNS)
    else:
        reach = int(prior[1] * HEADING_COLUMNS / 360)
        centre = round(prior[0] * HEADING_COLUMNS / 360)
        column = (centre + random.integers(-reach, reach + 1)) % HEADING_COLUMNS
    return float(column * 360.0 / HEADING_COLUMNS)


def gpano_properties(xmp: object) -> dict[str, str]:
    """The GPano properties in an XMP packet, as attributes or as elements."""
    text = xmp.decode("utf-8", "replace") if isinstance(xmp, bytes) else str(xmp or "")
    bound = re.search(rf"""xmlns:([\w.-]+)\s*=\s*["']{re.escape(_NAMESPACE)}["']""", text)
    prefix = re.escape(bound[1]) if bound else "GPano"
    attributes = re.findall(rf"""\b{prefix}:(\w+)\s*=\s*["']([^"']*)["']""", text)
    elements = re.findall(rf"<{prefix}:(\w+)>([^<]*)</{prefix}:", text)
    return {key: value.strip() for key, value in attributes + elements}


def _number(data: dict[str, str], key: str, name: str) -> float | None:
    if key not in data:
        return None
    try:
        value = float(data[key])
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ImageError(f"{name}: its GPano data say {key} {data[key]!r}; expected a number")
    return value


_AREA = (
    "FullPanoWidthPixels",
    "FullPanoHeightPixels",
    "CroppedAreaImageWidthPixels",
    "CroppedAreaImageHeightPixels",
    "CroppedAreaLeftPixels",
    "CroppedAreaTopPixels",
)


def _whole_sphere(image: Image.Image, data: dict[str, str], name: str) -> Image.Image:
    """The image pasted into the sphere that its GPano data describe, if they do."""
    values = [_number(data, key, name) for key in _AREA]
    if values[0] is None or values[1] is None:
        return image
    full_width, full_height = values[0], values[1]
    width = values[2] or image.width
    height = values[3] or image.height
    left, top = values[4] or 0.0, values[5] or 0.0
    if (width, height, left, top) == (full_width, full_height, 0.0, 0.0):
        return image
    # The file may have been resized since its data were written.
    scale = image.width / width
    inside = 0 <= left < full_width and top >= 0 and top + height <= full_height
    fits = abs(image.height / height / scale - 1) <= ASPECT_TOLERANCE and width <= full_width
    if not (inside and fits and min(width, height) > 0):
        numbers = ", ".join(f"{key} {data[key]}" for key in _AREA if key in data)
        raise ImageError(
            f"{name}: {image.width}x{image.height} pixels do not fit its GPano data ({numbers}); "
            "mend or remove the data"
        )
    if full_height * scale * full_width * scale > MAX_PIXELS:
        raise ImageError(
            f"{name}: its GPano data say that it is a part of a sphere of {full_width * scale:.0f}x"
            f"{full_height * scale:.0f} pixels, more than the {MAX_PIXELS:,} allowed; make the "
            "image smaller, or mend the data"
        )
    sphere = np.zeros((round(full_height * scale), round(full_width * scale), 3), np.uint8)
    pixels = np.asarray(image)
    row = min(round(top * scale), len(sphere) - 1)
    pixels = pixels[: len(sphere) - row, : sphere.shape[1]]
    # A part may reach across the seam.
    columns = (round(left * scale) + np.arange(pixels.shape[1])) % sphere.shape[1]
    sphere[row : row + len(pixels), columns] = pixels
    _say_once("part", f"{name}: is a part of a sphere, as its GPano data say; the rest is black")
    return Image.fromarray(sphere)


def _say_once(kind: str, text: str) -> None:
    if kind not in _said:
        _said.add(kind)
        log.warning(text)
