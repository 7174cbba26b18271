"""Panoramas: read as whole spheres, and turned to a heading."""

import logging
import math
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from slicemask.errors import ImageError
from slicemask.images import (
    ASPECT_TOLERANCE,
    MAX_PIXELS,
    Picture,
    has_aspect,
    name_of,
    read_image,
    xmp_of,
)
from slicematch.data.elevations import GroundFit

# Headings are drawn on whole columns of a panorama of this width, VIGOR's.
HEADING_COLUMNS = 2048
# Above it, the rows of a panorama are no longer rows of equal elevation, and it is levelled.
LEVEL_WITHIN_DEG = 2.0
_NAMESPACE = "http://ns.google.com/photos/1.0/panorama/"
# Pixels that are levelled at once, which bounds the memory of a call.
_LEVELLED_AT_ONCE = 1 << 18
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


def read_panorama(source: Picture, fit: GroundFit = "crop", hfov_deg: float = 360.0) -> Panorama:
    """Read a panorama as a whole, level sphere.

    If its GPano data (XMP, namespace http://ns.google.com/photos/1.0/panorama/) say that it is a
    part of a sphere, it is pasted where it belongs and the rest is black; if they say that it is
    tilted by more than `LEVEL_WITHIN_DEG`, it is levelled; their heading is passed on. Each is
    logged once.

    Parameters
    ----------
    source : path, PIL image or array [height, width, 3]
        As `slicemask.images.read_image` takes it. Of PIL images, ``info["xmp"]`` counts.
    fit : {"crop", "resize"}
        What to do with an image that is wider than twice its height and has no such data: take it
        for a strip around the horizon, which is in its middle, and add black rows, or resize it.
    hfov_deg : float
        Horizontal field of view that will be used: an image that shows it and no more, from the
        zenith to the nadir, is taken, too.

    Raises
    ------
    ImageError
        If it is unreadable, of another projection, shows more than a sphere, or its GPano data are
        inconsistent.
    """
    image, name = read_image(source), name_of(source)
    data = gpano_properties(image.info.get("xmp"))
    projection = data.get("ProjectionType", "equirectangular")
    if projection != "equirectangular":
        raise ImageError(
            f"{name}: its GPano data say that its projection is {projection!r}; a panorama must be "
            "equirectangular: convert it"
        )
    # A turn of nearly 360 degrees is a small one, too.
    pitch_deg, roll_deg = (
        ((_number(data, f"Pose{axis}Degrees", name) or 0.0) + 180.0) % 360.0 - 180.0
        for axis in ("Pitch", "Roll")
    )
    image = _fit_sphere(_whole_sphere(image, data, name), name, fit, hfov_deg)
    if max(abs(pitch_deg), abs(roll_deg)) > LEVEL_WITHIN_DEG:
        image = level(image, pitch_deg, roll_deg)
        _say_once("tilt", f"{name}: is levelled, since its GPano data say that it is tilted")
    heading_deg = _number(data, "PoseHeadingDegrees", name)
    image.info = {}
    if heading_deg is not None:
        heading_deg %= 360.0
        # What has been done is no longer to be done when the image is read again.
        data_left = f'xmlns:GPano="{_NAMESPACE}" GPano:PoseHeadingDegrees="{heading_deg}"'
        image.info["xmp"] = data_left.encode()
        _say_once("heading", f"{name}: its GPano data say that it faces {heading_deg:g} degrees")
    return Panorama(image, heading_deg)


def level(panorama: Image.Image, pitch_deg: float, roll_deg: float) -> Image.Image:
    """Level a panorama of a camera that was tilted: its horizon becomes the middle row.

    The camera was turned to its heading, then pitched, then rolled; the heading of the centre
    column stays what it was.

    Parameters
    ----------
    panorama : PIL.Image.Image
        Equirectangular, a whole sphere, twice as wide as high.
    pitch_deg : float
        How far above the horizon the centre of the image looked, in degrees; below it if negative.
        GPano's PosePitchDegrees.
    roll_deg : float
        How far the camera was turned clockwise about the axis through the centre of the image, as
        seen from behind it: its right side was down, and the horizon in the image is turned
        counter-clockwise. GPano's PoseRollDegrees.

    Returns
    -------
    PIL.Image.Image
        Of the same size, resampled linearly.
    """
    from scipy.ndimage import map_coordinates  # here, since few panoramas need it

    width, height = panorama.size
    to_camera = to_tilted(pitch_deg, roll_deg).astype(np.float32)
    azimuth = (2 * np.pi * ((np.arange(width) + 0.5) / width - 0.5)).astype(np.float32)
    # The poles' rows are continued beyond them, half a turn away.
    pixels = np.asarray(panorama)
    beyond = np.roll(pixels[[0, -1]], width // 2, axis=1)
    pixels = np.concatenate([beyond[:1], pixels, beyond[1:]])
    levelled = np.empty((height, width, 3), np.uint8)
    step = max(1, _LEVELLED_AT_ONCE // width)
    for top in range(0, height, step):
        rows = np.arange(top, min(top + step, height))
        elevation = (np.pi * (0.5 - (rows + 0.5) / height)).astype(np.float32)[:, None]
        flat = np.cos(elevation)
        directions = np.stack(
            np.broadcast_arrays(flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation))
        )
        right, ahead, up = np.tensordot(to_camera, directions, axes=1)
        column = (np.arctan2(right, ahead) / (2 * np.pi) + 0.5) * width - 0.5
        row = (0.5 - np.arctan2(up, np.hypot(right, ahead)) / np.pi) * height - 0.5
        places = np.stack([row + 1.0, column])
        for colour in range(3):
            levelled[rows, :, colour] = np.rint(
                map_coordinates(pixels[..., colour], places, np.float32, order=1, mode="grid-wrap")
            )
    return Image.fromarray(levelled)


def to_tilted(pitch_deg: float, roll_deg: float) -> NDArray[np.float64]:
    """The matrix that takes directions from the frame of the level camera to the tilted one's.

    Parameters
    ----------
    pitch_deg, roll_deg : float
        Of the tilted camera: see `level`.

    Returns
    -------
    float64 [3, 3]
        Of right, ahead and up.
    """
    pitch, roll = math.radians(pitch_deg), math.radians(roll_deg)
    pitched = np.array(
        [[1, 0, 0], [0, math.cos(pitch), -math.sin(pitch)], [0, math.sin(pitch), math.cos(pitch)]]
    )
    rolled = np.array(
        [[math.cos(roll), 0, math.sin(roll)], [0, 1, 0], [-math.sin(roll), 0, math.cos(roll)]]
    )
    return np.asarray((pitched @ rolled).T)


def says_its_tilt(path: str | Path) -> bool:
    """Whether an image's GPano data say how it is tilted, so that `read_panorama` levels it."""
    with Image.open(path) as image:
        properties = gpano_properties(xmp_of(image))
    return not {"PosePitchDegrees", "PoseRollDegrees"}.isdisjoint(properties)


def turn_panorama(
    image: Image.Image, heading_deg: float, size: tuple[int, int], hfov_deg: float = 360.0
) -> Image.Image:
    """Turn a panorama with north at its centre so that it faces a heading, cut and resize it.

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
    hfov_deg : float
        What is left of it, around the heading.

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
    cut = width * (360.0 - hfov_deg) / 720.0  # at either side
    box = (margin + rest + cut, 0, margin + rest + width - cut, height)
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


def cut_hfov(image: Image.Image, hfov_deg: float) -> Image.Image:
    """The middle columns of a panorama, to the nearest column, as wide as a field of view."""
    cut = round(image.width * (360.0 - hfov_deg) / 720.0)
    return image.crop((cut, 0, max(cut + 1, image.width - cut), image.height))


def _fit_sphere(image: Image.Image, name: str, fit: GroundFit, hfov_deg: float) -> Image.Image:
    """An image without data on which part of a sphere it shows, as a whole sphere."""
    if has_aspect(image, 2.0):
        return image
    width, height = image.size
    if has_aspect(image, hfov_deg / 180.0):
        return _paste(image, 2 * height, height)
    if fit == "resize":
        return image.resize((width, max(1, round(width / 2))))
    if height > width / 2:
        raise ImageError(
            f"{name}: {width}x{height} pixels; a panorama must be at least 2 times as wide as "
            "high, since it shows 360 degrees across and no more than 180 from top to bottom: name "
            "a whole one, or have it resized (ground_fit: resize)"
        )
    _say_once(
        "strip",
        f"{name}: is taken for a strip of a panorama around the horizon; the rest is black",
    )
    return _paste(image, width, round(width / 2))


def _paste(image: Image.Image, width: int, height: int) -> Image.Image:
    """An image in the middle of a black sphere."""
    sphere = Image.new("RGB", (width, height))
    sphere.paste(image, ((width - image.width) // 2, (height - image.height) // 2))
    return sphere


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
