"""Cameras of ground images: what each sees, by its intrinsic parameters, and undoing distortion.

A file of cameras is YAML, one camera a name:

    front: {projection: pinhole, width: 1242, height: 375, fx: 721.5, cx: 609.6, cy: 172.9}
    roof: {projection: equirectangular}

Coefficients of distortion go by OpenCV's names, which are COLMAP's too: k1 to k6, p1, p2, and with
``model: OPENCV_FISHEYE`` k1 to k4. COLMAP's ``f`` and ``k`` stand for fx = fy and for k1.
"""

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from slicemask import Frustum
from slicemask.errors import ImageError, SpecError
from slicemask.geometry.frustum import Projection
from slicemask.geometry.numbers import is_real, is_whole
from slicemask.images import ASPECT_TOLERANCE
from slicematch.data.errors import DatasetError

Model = Literal["OPENCV", "OPENCV_FISHEYE"]
# In the order of OpenCV's vectors of coefficients.
_COEFFICIENTS = {
    "OPENCV": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "OPENCV_FISHEYE": ("k1", "k2", "k3", "k4"),
}
_INTRINSICS = ("fx", "fy", "cx", "cy")


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A camera: its projection and intrinsic parameters.

    Parameters
    ----------
    projection : {"equirectangular", "pinhole"}
        Of the images, once distortion is undone.
    hfov_deg : float or None
        Horizontal field of view, degrees. Of an equirectangular camera 360 by default, centred on
        its heading; of a pinhole camera in place of fx, with cx in the centre.
    width, height : int or None
        Size of the images that the intrinsic parameters hold for, in pixels; of images of another
        size and the same proportions they are scaled.
    fx, fy : float or None
        Focal lengths in pixels; fy is fx by default.
    cx, cy : float or None
        Principal point, in pixels from the image's top left corner; the image's centre by default.
    model : {"OPENCV", "OPENCV_FISHEYE"}
        What the coefficients of distortion mean: see OpenCV's documentation of camera calibration.
    k1, k2, k3, k4, k5, k6, p1, p2 : float
        Coefficients of radial (k) and tangential (p) distortion; zero by default.

    Raises
    ------
    DatasetError
        If a value is missing or out of its range; the message names it.

    Examples
    --------
    >>> camera = Camera(projection="pinhole", fx=100.0, cx=60.0, width=100, height=50)
    >>> camera.frustum(slices=4).principal_point
    0.6
    """

    projection: Projection
    hfov_deg: float | None = None
    width: int | None = None
    height: int | None = None
    fx: float | None = None
    fy: float | None = None
    cx: float | None = None
    cy: float | None = None
    model: Model = "OPENCV"
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    def __post_init__(self) -> None:
        for name, allowed in (("projection", get_args(Projection)), ("model", get_args(Model))):
            _expect(self, name, getattr(self, name) in allowed, f"one of {', '.join(allowed)}")
        coefficients = {name for names in _COEFFICIENTS.values() for name in names}
        for name in sorted(coefficients):
            _expect(self, name, is_real(getattr(self, name)), "a number")
        for name in ("width", "height"):
            value = getattr(self, name)
            _expect(self, name, value is None or (is_whole(value) and value > 0), "pixels above 0")
        for name in ("fx", "fy"):
            value = getattr(self, name)
            _expect(self, name, value is None or (is_real(value) and value > 0), "pixels above 0")
        for name in ("cx", "cy"):
            value = getattr(self, name)
            _expect(self, name, value is None or is_real(value), "a number of pixels")
        foreign = coefficients - set(_COEFFICIENTS[self.model])
        if self.projection == "equirectangular":
            foreign = coefficients | set(_INTRINSICS)
        for name in sorted(foreign):
            owner = f"model {self.model}" if self.projection == "pinhole" else self.projection
            _expect(self, name, getattr(self, name) in (None, 0.0), f"left out: {owner} has none")
        if self.projection == "equirectangular":
            if self.hfov_deg is None:
                object.__setattr__(self, "hfov_deg", 360.0)
        else:
            self._complete_pinhole()
        try:
            self.frustum(1)
        except SpecError as error:
            raise DatasetError(str(error)) from error

    def _complete_pinhole(self) -> None:
        """Fill in what follows from the other parameters."""
        for name in ("width", "height"):
            _expect(self, name, getattr(self, name) is not None, "given, in pixels")
        width, height = float(self.width or 0), float(self.height or 0)
        if self.fx is None:
            hfov_deg = self.hfov_deg
            _expect(self, "fx", hfov_deg is not None, "given, in pixels, or hfov_deg in its place")
            holds = is_real(hfov_deg) and 0.0 < float(hfov_deg or 0.0) < 180.0
            _expect(self, "hfov_deg", holds, "above 0 and below 180, of a pinhole camera")
            _expect(
                self, "cx", self.cx in (None, width / 2), "left out where hfov_deg stands for fx"
            )
            half = math.tan(math.radians(float(hfov_deg or 0.0)) / 2)
            object.__setattr__(self, "fx", width / 2 / half)
        else:
            _expect(self, "hfov_deg", self.hfov_deg is None, "left out where fx is given")
        defaults = {"fy": self.fx, "cx": width / 2, "cy": height / 2}
        for name, value in defaults.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, value)

    def frustum(self, slices: int = 16, bands: tuple[float, ...] = ()) -> Frustum:
        """The camera's field of view in slices; bands as `Frustum` takes them."""
        if self.projection == "equirectangular":
            return Frustum(float(self.hfov_deg or 360.0), slices, "equirectangular", bands)
        if self.hfov_deg is not None:
            return Frustum(self.hfov_deg, slices, "pinhole", bands)
        fx, cx, width = float(self.fx or 0), float(self.cx or 0), float(self.width or 0)
        return Frustum.from_intrinsics(fx, cx, width, slices, bands)

    @property
    def distorted(self) -> bool:
        """Whether images have a distortion to undo."""
        fisheye = self.model == "OPENCV_FISHEYE" and self.projection == "pinhole"
        return fisheye or any(self._coefficients())

    def undistort(self, image: Image.Image, name: str = "the image") -> Image.Image:
        """Undo the distortion of an image: straight lines come out straight.

        Parameters
        ----------
        image : PIL.Image.Image
            RGB, of the camera's size or scaled.
        name : str
            What to call it in a message.

        Returns
        -------
        PIL.Image.Image
            Of the same width, with the same fx and principal point in proportion, and square
            pixels; black where the camera saw nothing. The image itself where there is nothing to
            undo.

        Raises
        ------
        ImageError
            If the image has other proportions than the camera's, or OpenCV, which does it, is not
            installed.
        """
        if self.width is not None and self.height is not None:
            wide, high = image.width / self.width, image.height / self.height
            if abs(wide / high - 1) > ASPECT_TOLERANCE:
                raise ImageError(
                    f"{name}: {image.width}x{image.height} pixels; its camera's images are "
                    f"{self.width}x{self.height}, or scaled: name its own camera"
                )
        if self.distorted:
            cv2 = _opencv(name)
            columns, rows = _undistortion(self, *image.size)
            pixels = cv2.remap(np.asarray(image), columns, rows, cv2.INTER_LINEAR)
            image = Image.fromarray(pixels)
        stretch = float(self.fx or 1.0) / float(self.fy or 1.0)
        if stretch == 1.0:
            return image
        height = max(1, round(image.height * stretch))
        return image.resize((image.width, height), Image.Resampling.BILINEAR)

    def _coefficients(self) -> tuple[float, ...]:
        return tuple(getattr(self, name) for name in _COEFFICIENTS[self.model])


def load_cameras(path: str | Path) -> dict[str, Camera]:
    """Read a file of cameras.

    Parameters
    ----------
    path : path
        YAML: for each camera's name its parameters, as `Camera` takes them.

    Returns
    -------
    dict of str to Camera
        In the file's order.

    Raises
    ------
    DatasetError
        If the file is unreadable or a camera invalid; the message names the file, the camera and
        the parameter.
    """
    import yaml

    try:
        content = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise DatasetError(f"{path}: the file of cameras is missing; check the name") from None
    except (OSError, ValueError, yaml.YAMLError, RecursionError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise DatasetError(f"{path}: is unreadable as YAML ({reason})") from error
    if not isinstance(content, dict) or not content:
        raise DatasetError(
            f"{path}: holds no cameras; expected lines such as "
            "'front: {projection: pinhole, width: 1242, height: 375, fx: 721.5}'"
        )
    cameras = {}
    for name, parameters in content.items():
        try:
            cameras[str(name)] = _camera(parameters)
        except DatasetError as error:
            raise DatasetError(f"{path}, camera {name}: {error}") from None
    return cameras


def _camera(parameters: Any) -> Camera:
    """A camera as it stands in a file, COLMAP's short names taken too."""
    if not isinstance(parameters, Mapping):
        raise DatasetError(f"is {parameters!r}; expected parameters such as fx: 721.5")
    given = dict(parameters)
    for short, long in (("f", ("fx", "fy")), ("k", ("k1",))):
        if short in given:
            value = given.pop(short)
            if set(long) & set(given):
                raise DatasetError(f"{short} stands for {' and '.join(long)}; give only one")
            given |= dict.fromkeys(long, value)
    known = [field.name for field in fields(Camera)]
    unknown = sorted(str(name) for name in given if name not in known)
    if unknown:
        raise DatasetError(f"{unknown[0]!r} is unknown; it must be one of {', '.join(known)}")
    if "projection" not in given:
        raise DatasetError(f"projection is missing; it must be {' or '.join(get_args(Projection))}")
    return Camera(**given)


def _expect(camera: Camera, name: str, holds: bool, expected: str) -> None:
    if not holds:
        raise DatasetError(f"{name} is {getattr(camera, name)!r}; it must be {expected}")


def _opencv(name: str) -> Any:
    try:
        import cv2
    except ImportError as error:
        raise ImageError(
            f"{name}: its camera's distortion is undone by OpenCV, which is not installed; "
            "install it: pip install 'slicemask[cameras]'"
        ) from error
    return cv2


@functools.lru_cache(maxsize=16)
def _undistortion(
    camera: Camera, width: int, height: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Where each pixel of the undistorted image is in the distorted one: columns and rows."""
    cv2 = _opencv("the image")
    across, down = width / float(camera.width or width), height / float(camera.height or height)
    # OpenCV counts from the centre of the first pixel, the principal point from its corner.
    matrix = np.array(
        [
            [float(camera.fx or 0) * across, 0.0, float(camera.cx or 0) * across - 0.5],
            [0.0, float(camera.fy or 0) * down, float(camera.cy or 0) * down - 0.5],
            [0.0, 0.0, 1.0],
        ]
    )
    coefficients = np.array(camera._coefficients())
    maps = cv2.fisheye if camera.model == "OPENCV_FISHEYE" else cv2
    columns, rows = maps.initUndistortRectifyMap(
        matrix, coefficients, np.eye(3), matrix, (width, height), cv2.CV_32FC1
    )
    return columns, rows
