"""Views: the part of the world that all ground images of a run show, cut out of each camera's."""

import math
from typing import NamedTuple

from PIL import Image

from slicemask.errors import ImageError
from slicematch.data.cameras import Camera
from slicematch.data.errors import DatasetError

# By which share of its width or height an image may show less than a view, as after rounding.
_TOLERANCE = 0.01


class View(NamedTuple):
    """What ground images show: the horizon is at half their height.

    Attributes
    ----------
    left_deg, right_deg : float
        Azimuths of the left and the right edge from the heading, clockwise; of a pinhole camera
        from the optical axis.
    highest_deg : float
        Elevation of the upper edge, and below the horizon of the lower one.
    """

    left_deg: float
    right_deg: float
    highest_deg: float

    @property
    def hfov_deg(self) -> float:
        """Horizontal field of view."""
        return self.right_deg - self.left_deg

    def aspect(self, camera: Camera) -> float:
        """Width over height of its images, as `slicematch.data.elevations` reckons them."""
        if camera.projection == "equirectangular":
            return self.hfov_deg / (2.0 * self.highest_deg)
        return _tan(self.hfov_deg / 2.0) / _tan(self.highest_deg)


def camera_view(camera: Camera, name: str) -> View:
    """All that a camera shows at equal heights above and below the horizon.

    Parameters
    ----------
    camera : Camera
        Its images, undistorted.
    name : str
        What to call it in a message.

    Raises
    ------
    DatasetError
        If the size of a part of a panorama is not known, or the horizon is not in the image.

    Examples
    --------
    >>> front = Camera(projection="pinhole", fx=100.0, cx=100.0, cy=80.0, width=200, height=180)
    >>> View(-45.0, 45.0, math.degrees(math.atan(0.8))) == camera_view(front, "front")
    True
    """
    if camera.projection == "equirectangular":
        half = float(camera.hfov_deg or 360.0) / 2.0
        if half == 180.0:
            return View(-180.0, 180.0, 90.0)
        if camera.width is None or camera.height is None:
            raise DatasetError(
                f"camera {name}: is a part of a panorama; its width and height in pixels are "
                "needed, which tell the elevations that it shows"
            )
        return View(-half, half, half * camera.height / camera.width)
    frustum = camera.frustum(1)
    left_deg, right_deg = frustum.edge_offsets_deg().tolist()
    height, fy, cy = (float(value or 0.0) for value in (camera.height, camera.fy, camera.cy))
    reach = min(cy, height - cy)
    if reach <= 0.0:
        raise DatasetError(
            f"camera {name}: cy is {cy:g} of {height:g} pixels; the horizon must be in the image"
        )
    return View(left_deg, right_deg, math.degrees(math.atan(reach / fy)))


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
    low, high = elevations or (-view.highest_deg, view.highest_deg)
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


def _tan(degrees: float) -> float:
    return math.tan(math.radians(degrees))
