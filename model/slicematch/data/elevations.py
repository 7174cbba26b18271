"""Which elevations a ground image shows, and cutting it to a part of them."""

import math

from PIL import Image

from slicemask.geometry.frustum import Projection
from slicemask.images import ASPECT_TOLERANCE
from slicematch.data.errors import DatasetError

Elevations = tuple[float, float]


def image_elevations(projection: Projection, hfov_deg: float, aspect: float) -> Elevations:
    """The lowest and the highest elevation of a ground image, degrees above the horizon.

    The horizon is at half its height; of a pinhole image they are those of its central column.

    Parameters
    ----------
    projection : {"equirectangular", "pinhole"}
        Of the image; an equirectangular one shows the whole sphere.
    hfov_deg : float
        Horizontal field of view.
    aspect : float
        Width over height.

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
    highest = math.degrees(math.atan(math.tan(math.radians(hfov_deg / 2)) / aspect))
    return -highest, highest


def check_elevations(
    elevations: Elevations | None,
    projection: Projection,
    hfov_deg: float,
    aspect: float,
    tolerance: float = 0.0,
) -> None:
    """Refuse elevations that ground images do not show.

    Parameters
    ----------
    elevations : (lowest, highest) or None
        Degrees above the horizon; None for all.
    projection, hfov_deg, aspect
        Of the images: see `image_elevations`.
    tolerance : float
        By which share of their height the images may show less.

    Raises
    ------
    DatasetError
        If they do not show them.
    """
    if elevations is None:
        return
    shown = image_elevations(projection, hfov_deg, aspect)
    reach = max(_height_of(abs(angle), projection) for angle in elevations)
    if reach > _height_of(shown[1], projection) * (1.0 + tolerance) + 1e-9:
        low, high = elevations
        raise DatasetError(
            f"elevations are {low:g},{high:g}; a {projection} image of {hfov_deg:.4g} degrees of "
            f"HFoV, {aspect:.4g} times as wide as high, shows {shown[0]:.4g} to {shown[1]:.4g}: "
            "choose a part of them"
        )


def crop_elevations(
    image: Image.Image, elevations: Elevations | None, projection: Projection, hfov_deg: float
) -> Image.Image:
    """Cut a ground image to a part of its elevations; the horizon is at half its height.

    Parameters
    ----------
    image : PIL.Image.Image
        The whole ground image: of an equirectangular one the whole sphere.
    elevations : (lowest, highest) or None
        Degrees above the horizon; None for all.
    projection, hfov_deg
        Of the image.

    Returns
    -------
    PIL.Image.Image
        As wide as it was. Edges between two rows are resampled.

    Raises
    ------
    DatasetError
        If the image does not show those elevations.
    """
    if elevations is None:
        return image
    width, height = image.size
    # Proportions may differ a little from those that the settings were checked with.
    check_elevations(elevations, projection, hfov_deg, width / height, tolerance=ASPECT_TOLERANCE)
    shown = image_elevations(projection, hfov_deg, width / height)
    scale = [
        _height_of(angle, projection) / _height_of(shown[1], projection) for angle in elevations
    ]
    bottom, top = (max(0.0, min(1.0, 0.5 - 0.5 * part)) * height for part in scale)
    size = width, max(1, round(bottom - top))
    return image.resize(size, Image.Resampling.BILINEAR, box=(0, top, width, bottom))


def _height_of(elevation_deg: float, projection: Projection) -> float:
    """Height above the horizon in the image, in units of its own."""
    if projection == "equirectangular":
        return elevation_deg
    return math.tan(math.radians(elevation_deg))
