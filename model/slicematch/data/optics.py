"""What a photograph says of its camera: a panorama, or a pinhole camera of some field of view."""

import math
import re
from pathlib import Path
from typing import NamedTuple

from PIL import ExifTags, Image

from slicemask.images import ASPECT_TOLERANCE, xmp_of
from slicematch.data.errors import SampleError
from slicematch.data.panoramas import gpano_properties
from slicematch.data.text import parse_number

# Diagonal of the film that 35-mm-equivalent focal lengths belong to, millimetres.
_FILM_DIAGONAL_MM = math.hypot(36.0, 24.0)
# EXIF's orientations that turn an image on its side.
_ON_ITS_SIDE = (5, 6, 7, 8)


class Optics(NamedTuple):
    """A photograph's camera.

    Attributes
    ----------
    name : str
        Of the camera: the same for photographs of the same kind.
    parameters : dict
        Its parameters in a file of cameras; empty of a whole panorama.
    heading_deg : float or None
        Of a panorama's centre column, as its GPano data give it, clockwise from north.
    """

    name: str
    parameters: dict[str, float | int | str]
    heading_deg: float | None = None


def read_optics(path: str | Path, hfov_deg: float | None = None) -> Optics:
    """Read what a photograph says of its camera.

    A photograph is a panorama if its GPano data say so, or if it is twice as wide as high and has
    no focal length. The field of view of others follows from EXIF's focal length for 35-mm film,
    whose diagonal the image's stands for, with the principal point in the centre.

    Parameters
    ----------
    path : path
        Of the image; only its head is read.
    hfov_deg : float, optional
        Horizontal field of view of photographs that say none.

    Raises
    ------
    SampleError
        If the file is unreadable, or says nothing of its field of view and none is given.
    """
    try:
        with Image.open(path) as image:
            exif = image.getexif()
            tags = dict(exif) | exif.get_ifd(ExifTags.IFD.Exif)
            width, height = image.size
            gpano = gpano_properties(xmp_of(image))
    except (OSError, SyntaxError, ValueError) as error:  # broken EXIF raises any of these
        raise SampleError(f"{path}: cannot be read as an image ({error})") from error
    if tags.get(ExifTags.Base.Orientation) in _ON_ITS_SIDE:
        width, height = height, width
    try:
        focal_mm = float(tags.get(ExifTags.Base.FocalLengthIn35mmFilm) or 0)
    except (TypeError, ValueError):
        focal_mm = 0.0
    whole = abs(width / height / 2.0 - 1.0) <= ASPECT_TOLERANCE and not focal_mm
    if "ProjectionType" in gpano or "PoseHeadingDegrees" in gpano or whole:
        heading_deg = parse_number(gpano.get("PoseHeadingDegrees", ""))
        return Optics("panorama", {}, None if heading_deg is None else heading_deg % 360.0)
    size: dict[str, float | int | str] = {
        "projection": "pinhole",
        "width": width,
        "height": height,
    }
    model = re.sub(r"[^a-z0-9]+", "-", str(tags.get(ExifTags.Base.Model, "camera")).lower())
    name = f"{model.strip('-') or 'camera'}_{width}x{height}"
    if focal_mm > 0:
        fx = focal_mm / _FILM_DIAGONAL_MM * math.hypot(width, height)
        return Optics(f"{name}_{focal_mm:g}mm", size | {"fx": round(fx, 3)})
    if hfov_deg is not None:
        return Optics(name, size | {"hfov_deg": hfov_deg})
    raise SampleError(
        f"{path}: says nothing of its field of view: there is no focal length in its EXIF data, "
        "and it is no panorama; give it in degrees (--hfov)"
    )
