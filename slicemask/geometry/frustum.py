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
    """

    hfov_deg: float = 360.0
    slices: int = 16
    projection: Projection = "equirectangular"
    bands: tuple[float, ...] = ()

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

        Slice n lies between offsets n and n + 1. The offsets mirror each other exactly.
        """
        steps = 2.0 * np.arange(self.slices + 1) - self.slices  # -N, -N + 2, ..., N
        if self.projection == "pinhole":
            half_width = math.tan(math.radians(self.hfov_deg / 2.0))
            return np.asarray(np.degrees(np.arctan(steps / self.slices * half_width)))
        return np.asarray(steps * self.hfov_deg / (2.0 * self.slices))

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
