"""Which elevations a ground image shows, and cutting it to a part of them about the horizon."""

import logging
import math
from typing import Literal

from PIL import Image

from slicemask import Frustum
from slicemask.geometry.frustum import Projection
from slicemask.images import ASPECT_TOLERANCE, has_aspect
from slicematch.data.errors import DatasetError

Elevations = tuple[float, float]
# What becomes of ground images of other proportions than expected.
GroundFit = Literal["crop", "resize"]
log = logging.getLogger(__name__)
# Whether it has been said in this process that images show too little.
_said: set[str] = set()


def image_elevations(
    projection: Projection,
    hfov_deg: float,
    aspect: float,
    left_deg: float | None = None,
    horizon: float = 0.5,
) -> Elevations:
    """The lowest and the highest elevation of a ground image, degrees above the horizon.

    Of a pinhole image they are those of the column of its optical axis; its pixels are square.

    Parameters
    ----------
    projection : {"equirectangular", "pinhole"}
        Of the image; an equirectangular one shows the whole sphere.
    hfov_deg : float
        Horizontal field of view.
    aspect : float
        Width over height.
    left_deg : float or None
        Azimuth of the left edge of a pinhole image from the heading; None for a centred axis.
    horizon : float
        Where the horizon of a pinhole image is, from its top, as a fraction of its height.

    Returns
    -------
    (lowest, highest)
        Degrees.

    Examples
    --------
    >>> image_elevations("equirectangular", 360.0, 2.0)
    (-90.0, 90.0)
    >>> image_elevations("pinhole", 90.0, 1.0)
    (-45.0, 45.0)
    """
    if projection == "equirectangular":
        return -90.0, 90.0
    frustum = Frustum(hfov_deg, 1, projection, left_deg=left_deg)
    left, right = (
        math.tan(math.radians(angle))
        for angle in (frustum.right_deg - frustum.hfov_deg, frustum.right_deg)
    )
    height = (right - left) / aspect  # in focal lengths
    lowest, highest = ((horizon - 1.0) * height, horizon * height)
    return math.degrees(math.atan(lowest)), math.degrees(math.atan(highest))


def check_elevations(
    elevations: Elevations | None,
    projection: Projection,
    hfov_deg: float,
    aspect: float,
    left_deg: float | None = None,
    horizon: float = 0.5,
) -> None:
    """Refuse elevations that ground images do not show.

    Parameters
    ----------
    elevations : (lowest, highest) or None
        Degrees above the horizon; None for all.
    projection, hfov_deg, aspect, left_deg, horizon
        Of the images: see `image_elevations`.

    Raises
    ------
    DatasetError
        If they do not show them.
    """
    if elevations is None:
        return
    shown = image_elevations(projection, hfov_deg, aspect, left_deg, horizon)
    if elevations[0] < shown[0] - 1e-9 or elevations[1] > shown[1] + 1e-9:
        low, high = elevations
        raise DatasetError(
            f"elevations are {low:g},{high:g}; a {projection} image of {hfov_deg:.4g} degrees of "
            f"HFoV, {aspect:.4g} times as wide as high, shows {shown[0]:.4g} to {shown[1]:.4g}: "
            "choose a part of them"
        )


def crop_elevations(
    image: Image.Image,
    elevations: Elevations | None,
    projection: Projection,
    hfov_deg: float,
    left_deg: float | None = None,
    horizon: float = 0.5,
) -> Image.Image:
    """Cut a ground image to a part of its elevations.

    Parameters
    ----------
    image : PIL.Image.Image
        The whole ground image: of an equirectangular one the whole sphere.
    elevations : (lowest, highest) or None
        Degrees above the horizon; None for all.
    projection, hfov_deg, left_deg, horizon
        Of the image: see `image_elevations`.

    Returns
    -------
    PIL.Image.Image
        As wide as it was. Edges between two rows are resampled; rows that the image does not show
        are black, which is logged once.
    """
    if elevations is None:
        return image
    width, height = image.size
    shown = image_elevations(projection, hfov_deg, width / height, left_deg, horizon)
    lowest, highest = (_height_of(angle, projection) for angle in shown)
    bottom, top = (
        (highest - _height_of(angle, projection)) / (highest - lowest) * height
        for angle in elevations
    )
    # Proportions may differ a little from those that the settings were checked with.
    spare = 0.5 * ASPECT_TOLERANCE * height
    if -spare <= top and bottom <= height + spare:
        top, bottom = max(0.0, top), min(float(height), bottom)
    above, below = max(0, math.ceil(-top)), max(0, math.ceil(bottom - height))
    if above or below:
        _say_once(elevations, shown)
        padded = Image.new(image.mode, (width, height + above + below))
        padded.paste(image, (0, above))
        image, top, bottom = padded, top + above, bottom + above
    size = width, max(1, round(bottom - top))
    return image.resize(size, Image.Resampling.BILINEAR, box=(0, top, width, bottom))


def frame_ground(
    image: Image.Image,
    aspect: float,
    fit: GroundFit,
    elevations: Elevations | None,
    hfov_deg: float,
    left_deg: float | None = None,
    horizon: float = 0.5,
) -> Image.Image:
    """Bring a pinhole image of any proportions to those that a model takes.

    Parameters
    ----------
    image : PIL.Image.Image
        The whole image.
    aspect : float
        Width over height of images as the model takes them whole.
    fit : {"crop", "resize"}
        What to do with an image of other proportions: cut or add rows about the horizon until it
        shows the elevations of one of those, or resize it to their proportions.
    elevations : (lowest, highest) or None
        The part that the model takes, degrees above the horizon; None for all.
    hfov_deg, left_deg, horizon
        Of the image: see `image_elevations`.

    Returns
    -------
    PIL.Image.Image
        Of the elevations, or of those of an image of that aspect.
    """
    if not has_aspect(image, aspect):
        if fit == "resize":
            image = image.resize((image.width, max(1, round(image.width / aspect))))
        elif elevations is None:
            elevations = image_elevations("pinhole", hfov_deg, aspect, left_deg, horizon)
    return crop_elevations(image, elevations, "pinhole", hfov_deg, left_deg, horizon)


def _say_once(elevations: Elevations, shown: Elevations) -> None:
    if "shown" not in _said:
        _said.add("shown")
        log.warning(
            "a ground image shows elevations from %.4g to %.4g degrees, and %.4g to %.4g are "
            "taken; what is missing is black, here and in others like it",
            *shown,
            *elevations,
        )


def _height_of(elevation_deg: float, projection: Projection) -> float:
    """Height above the horizon in the image, in units of its own."""
    if projection == "equirectangular":
        return elevation_deg
    return math.tan(math.radians(elevation_deg))
