"""The camera's horizontal field of view and how it is cut into slices."""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slicemask.errors import SpecError
from slicemask.geometry.numbers import is_real, is_whole

Projection = Literal["equirectangular", "pinhole"]
MOST_SLICES = 4096
MOST_BANDS = 64


@dataclass(frozen=True)
class Frustum:
    """A horizontal field of view, cut into slices from left to right in the ground image.

    Parameters
    ----------
    hfov_deg : float
        Horizontal field of view (HFoV) in degrees: in (0, 360], and below 180 for a pinhole.
    slices : int
        Number of slices N, 1 to 4096.
    projection : {"equirectangular", "pinhole"}
        Equal azimuth ranges (SliceMatch, CVPR 2023, section 3), or equal widths in the image of
        a pinhole camera.
    left_deg : float or None
        Azimuth of the image's left edge from the heading, degrees clockwise, of a pinhole camera
        whose principal point is off the centre: the heading is then the optical axis's, and not
        that of the image's centre column. None for -hfov_deg / 2. See `from_intrinsics`.
    bands : tuple of float
        Ranges r_1 < ... < r_{B-1}, in shares of the tile's side, that cut each slice into B bands
        (ours, not the paper's), the nearest first and the last one without end. Of an
        equirectangular image the range is the distance from the camera, so that bands are
        separated by circles; of a pinhole image it is the depth along the heading, so that they
        are separated by straight lines. Empty by default: one band, the whole slice.

    Raises
    ------
    SpecError
        If a value is out of its range.

    Examples
    --------
    >>> Frustum(hfov_deg=90, slices=2).edge_offsets_deg().tolist()
    [-45.0, 0.0, 45.0]
    >>> Frustum(bands=(0.1, 0.25)).band_count
    3
    >>> Frustum.from_intrinsics(fx=100, cx=0, width=100, slices=1).edge_offsets_deg().tolist()
    [0.0, 45.0]
    """

    hfov_deg: float = 360.0
    slices: int = 16
    projection: Projection = "equirectangular"
    bands: tuple[float, ...] = ()
    left_deg: float | None = None

    def __post_init__(self) -> None:
        if self.projection not in get_args(Projection):
            raise SpecError(
                f"projection is {self.projection!r}; it must be one of "
                f"{', '.join(get_args(Projection))}"
            )
        if not is_whole(self.slices) or not 1 <= self.slices <= MOST_SLICES:
            raise SpecError(
                f"slices is {self.slices!r}; it must be a whole number from 1 to {MOST_SLICES}"
            )
        if not is_real(self.hfov_deg) or not 0.0 < self.hfov_deg <= 360.0:
            raise SpecError(f"hfov is {self.hfov_deg!r} degrees; it must lie in (0, 360]")
        if self.projection == "pinhole" and self.hfov_deg >= 180.0:
            raise SpecError(
                f"hfov is {self.hfov_deg!r} degrees; a pinhole camera sees less than 180: "
                "choose a smaller hfov, or the equirectangular projection"
            )
        object.__setattr__(self, "hfov_deg", float(self.hfov_deg))
        object.__setattr__(self, "slices", int(self.slices))
        object.__setattr__(self, "bands", _checked_bands(self.bands))
        if self.left_deg is not None:
            self._check_left(self.left_deg)

    def _check_left(self, left_deg: float) -> None:
        if not is_real(left_deg):
            raise SpecError(f"left_deg is {left_deg!r}; it must be an azimuth in degrees, or None")
        if left_deg == -self.hfov_deg / 2.0:
            object.__setattr__(self, "left_deg", None)
            return
        if self.projection != "pinhole":
            raise SpecError(
                f"left_deg is {left_deg:g}; only a pinhole camera has a principal point: leave it "
                "out, since other images are centred on their headings"
            )
        right_deg = left_deg + self.hfov_deg
        if not (left_deg > -90.0 and right_deg < 90.0):
            raise SpecError(
                f"the image reaches from {left_deg:g} to {right_deg:g} degrees of the optical "
                "axis; a pinhole camera sees less than 90 to either side"
            )
        object.__setattr__(self, "left_deg", float(left_deg))

    @classmethod
    def from_intrinsics(
        cls, fx: float, cx: float, width: float, slices: int = 16, bands: tuple[float, ...] = ()
    ) -> "Frustum":
        """Return the frustum of a pinhole camera, given its intrinsic parameters.

        The slices are equal parts of the image's width, from its left edge, atan(-cx / fx) off the
        optical axis, to its right edge, atan((width - cx) / fx).

        Parameters
        ----------
        fx : float
            Focal length, in pixels.
        cx : float
            Column of the principal point, in pixels from the image's left edge. It may lie outside
            the image, as after a crop.
        width : float
            Of the image, in pixels.
        slices, bands
            As for `Frustum`.

        Raises
        ------
        SpecError
            If a value is out of its range.
        """
        for name, value, least in (("fx", fx, 0.0), ("cx", cx, -math.inf), ("width", width, 0.0)):
            if not is_real(value) or value <= least:
                above = "" if least else " above 0"
                raise SpecError(f"{name} is {value!r}; it must be a number of pixels{above}")
        if cx == width / 2.0:
            return cls(math.degrees(2.0 * math.atan(cx / fx)), slices, "pinhole", bands)
        left_deg = math.degrees(math.atan(-cx / fx))
        right_deg = math.degrees(math.atan((width - cx) / fx))
        return cls(right_deg - left_deg, slices, "pinhole", bands, left_deg)

    @property
    def right_deg(self) -> float:
        """Azimuth of the image's right edge from the heading, degrees clockwise."""
        half = self.hfov_deg / 2.0
        return half if self.left_deg is None else self.left_deg + self.hfov_deg

    @property
    def principal_point(self) -> float:
        """Column of the optical axis, in shares of the image's width: 0.5 where it is centred."""
        if self.left_deg is None:
            return 0.5
        left, right = (math.tan(math.radians(a)) for a in (self.left_deg, self.right_deg))
        return -left / (right - left)

    @property
    def band_count(self) -> int:
        """B, the bands of a slice: 1 where there are no ranges."""
        return len(self.bands) + 1

    @property
    def mask_axes(self) -> tuple[int, ...]:
        """The axes of a pose's masks before those of the cells: (N,), or (N, B) with bands."""
        return (self.slices, self.band_count) if self.bands else (self.slices,)

    def edge_offsets_deg(self) -> NDArray[np.float64]:
        """Azimuths of the slice edges from the heading, degrees clockwise, float64 [N + 1].

        Slice n lies between offsets n and n + 1. Around a principal point in the centre the
        offsets mirror each other exactly.
        """
        if self.left_deg is not None:
            return self._uncentred_offsets_deg(self.left_deg)
        steps = 2.0 * np.arange(self.slices + 1) - self.slices  # -N, -N + 2, ..., N
        if self.projection == "pinhole":
            half_width = math.tan(math.radians(self.hfov_deg / 2.0))
            return np.asarray(np.degrees(np.arctan(steps / self.slices * half_width)))
        return np.asarray(steps * self.hfov_deg / (2.0 * self.slices))

    def _uncentred_offsets_deg(self, left_deg: float) -> NDArray[np.float64]:
        left, right = (math.tan(math.radians(angle)) for angle in (left_deg, self.right_deg))
        part = np.arange(self.slices + 1) / self.slices
        columns = (1.0 - part) * left + part * right  # from the optical axis, focal length 1
        # An edge on the optical axis is on it exactly: a lattice line may run along it.
        columns[np.abs(columns) < 1e-14 * (right - left)] = 0.0
        offsets = np.degrees(np.arctan(columns))
        offsets[0], offsets[-1] = left_deg, self.right_deg
        return np.asarray(offsets)

    def edges_deg(self, heading_deg: ArrayLike) -> NDArray[np.float64]:
        """Azimuths of the slice edges of cameras, float64 [K, N + 1], ascending in a row.

        Parameters
        ----------
        heading_deg : array [K]
            Headings, degrees clockwise from north. The result is not wrapped to [0, 360).
        """
        heading = np.asarray(heading_deg, dtype=np.float64)
        return np.asarray(heading[..., None] + self.edge_offsets_deg())


def _checked_bands(bands: Any) -> tuple[float, ...]:
    """The ranges as a tuple, or SpecError if they are no increasing ranges."""
    try:
        ranges = tuple(bands)
    except TypeError:
        ranges = (None,)
    if not all(is_real(r) and r > 0.0 for r in ranges) or any(
        far <= near for near, far in pairwise(ranges)
    ):
        raise SpecError(
            f"bands are {bands!r}; they must be increasing ranges above 0, in shares of the tile's "
            "side, such as 0.08,0.17,0.33"
        )
    if len(ranges) >= MOST_BANDS:
        raise SpecError(f"there are {len(ranges) + 1} bands; there may be at most {MOST_BANDS}")
    return tuple(map(float, ranges))
