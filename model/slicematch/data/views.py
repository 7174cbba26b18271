"""Views: the part of the world that all ground images of a run show, cut out of each camera's."""

import math
from typing import NamedTuple

import numpy as np
from PIL import Image

from slicemask.errors import ImageError
from slicemask.geometry.frustum import Projection
from slicematch.data.cameras import Camera
from slicematch.data.errors import DatasetError
from slicematch.data.panoramas import to_tilted

# By which share of its width or height an image may show less than a view, as after rounding.
_TOLERANCE = 0.01


class View(NamedTuple):
    """What ground images show.

    Attributes
    ----------
    left_deg, right_deg : float
        Azimuths of the left and the right edge from the heading, clockwise; of a pinhole camera
        from the optical axis.
    lowest_deg, highest_deg : float
        Elevations of the lower and the upper edge, of a pinhole image where its optical axis is.
    """

    left_deg: float
    right_deg: float
    lowest_deg: float
    highest_deg: float

    @property
    def hfov_deg(self) -> float:
        """Horizontal field of view."""
        return self.right_deg - self.left_deg

    @property
    def off_centre_left_deg(self) -> float | None:
        """The left edge, or None if it is half the field of view off the heading."""
        return None if self.left_deg == -self.right_deg else self.left_deg

    def aspect(self, projection: Projection) -> float:
        """Width over height of its images, whose pixels are square."""
        if projection == "equirectangular":
            return self.hfov_deg / (self.highest_deg - self.lowest_deg)
        left, right, lowest, highest = map(_tan, self)
        return (right - left) / (highest - lowest)

    def horizon(self, projection: Projection) -> float:
        """Where the horizon is, from the top, as a fraction of the height."""
        if projection == "equirectangular":
            return self.highest_deg / (self.highest_deg - self.lowest_deg)
        lowest, highest = _tan(self.lowest_deg), _tan(self.highest_deg)
        return highest / (highest - lowest)


def is_whole(camera: Camera) -> bool:
    """Whether a camera takes whole panoramas, which can be turned to any heading."""
    return camera.projection == "equirectangular" and camera.hfov_deg in (None, 360.0)


def camera_view(camera: Camera, name: str) -> View:
    """All that a camera shows.

    Parameters
    ----------
    camera : Camera
        Its images, undistorted.
    name : str
        What to call it in a message.

    Raises
    ------
    DatasetError
        If the size of a part of a panorama is not known.

    Examples
    --------
    >>> front = Camera(projection="pinhole", fx=50.0, cx=50.0, cy=50.0, width=100, height=100)
    >>> camera_view(front, "front")
    View(left_deg=-45.0, right_deg=45.0, lowest_deg=-45.0, highest_deg=45.0)
    """
    if camera.projection == "equirectangular":
        half = float(camera.hfov_deg or 360.0) / 2.0
        if half == 180.0:
            return View(-180.0, 180.0, -90.0, 90.0)
        if camera.width is None or camera.height is None:
            raise DatasetError(
                f"camera {name}: is a part of a panorama; its width and height in pixels are "
                "needed, which tell the elevations that it shows"
            )
        highest = half * camera.height / camera.width
        return View(-half, half, -highest, highest)
    frustum = camera.frustum(1)
    left_deg, right_deg = frustum.edge_offsets_deg().tolist()
    height, fy, cy = (float(value or 0.0) for value in (camera.height, camera.fy, camera.cy))
    lowest_deg, highest_deg = (math.degrees(math.atan(up / fy)) for up in (cy - height, cy))
    return View(left_deg, right_deg, lowest_deg, highest_deg)


def cut_view(
    image: Image.Image,
    camera: Camera,
    view: View,
    elevations: tuple[float, float] | None,
    size: tuple[int, int],
    name: str,
) -> Image.Image:
    """Cut a view out of a camera's image and resize it.

    Parameters
    ----------
    image : PIL.Image.Image
        RGB, undistorted, of the camera's size or scaled.
    camera : Camera
        The image's.
    view : View
        What to show.
    elevations : (lowest, highest) or None
        Only this part of the view, degrees above the horizon.
    size : (height, width)
        Of the result, in pixels.
    name : str
        Which image, for the message.

    Returns
    -------
    PIL.Image.Image
        Of that size.

    Raises
    ------
    ImageError
        If the image does not show all of the view.
    """
    low, high = elevations or view[2:]
    across = image.width / float(camera.width or image.width)
    down = image.height / float(camera.height or image.height)
    if camera.projection == "equirectangular":
        pixels_per_degree = image.width / float(camera.hfov_deg or 360.0)
        columns = [image.width / 2 + pixels_per_degree * a for a in view[:2]]
        rows = [image.height / 2 - pixels_per_degree * e for e in (high, low)]
    else:
        fx, fy, cx, cy = (
            float(value or 0.0) for value in (camera.fx, camera.fy, camera.cx, camera.cy)
        )
        columns = [across * (cx + fx * _tan(a)) for a in view[:2]]
        rows = [down * (cy - fy * _tan(e)) for e in (high, low)]
    for found, length, what in ((columns, image.width, "wide"), (rows, image.height, "high")):
        if found[0] < -_TOLERANCE * length or found[1] > (1.0 + _TOLERANCE) * length:
            raise ImageError(
                f"{name}: its camera does not show the run's view, {view.left_deg:.4g} to "
                f"{view.right_deg:.4g} degrees across and {low:.4g} to {high:.4g} up: it is not "
                f"{what} enough; name a smaller --view"
            )
    left, right = (min(max(column, 0.0), image.width) for column in columns)
    top, bottom = (min(max(row, 0.0), image.height) for row in rows)
    return image.resize(size[::-1], Image.Resampling.BILINEAR, box=(left, top, right, bottom))


def level_pinhole(
    image: Image.Image, camera: Camera, pitch_deg: float, roll_deg: float
) -> Image.Image:
    """Level an image of a tilted pinhole camera, as if it had looked along its heading.

    Parameters
    ----------
    image : PIL.Image.Image
        RGB, undistorted, of the camera's size or scaled.
    camera : Camera
        The image's, a pinhole camera.
    pitch_deg, roll_deg : float
        As `slicematch.data.panoramas.level` takes them.

    Returns
    -------
    PIL.Image.Image
        Of the same size and intrinsic parameters; black where the camera saw nothing.
    """
    if not (pitch_deg or roll_deg):
        return image
    across = image.width / float(camera.width or image.width)
    down = image.height / float(camera.height or image.height)
    fx, cx = (across * float(value or 0.0) for value in (camera.fx, camera.cx))
    fy, cy = (down * float(value or 0.0) for value in (camera.fy, camera.cy))
    # From pixels to rays that are right, ahead and up, and back.
    to_ray = np.array([[1 / fx, 0, -cx / fx], [0, 0, 1], [0, -1 / fy, cy / fy]])
    to_pixel = np.array([[fx, cx, 0], [0, cy, -fy], [0, 1, 0]])
    matrix = to_pixel @ to_tilted(pitch_deg, roll_deg) @ to_ray
    coefficients = (matrix / matrix[2, 2]).ravel()[:8]
    return image.transform(
        image.size, Image.Transform.PERSPECTIVE, coefficients.tolist(), Image.Resampling.BILINEAR
    )


def _tan(degrees: float) -> float:
    return math.tan(math.radians(degrees))
