"""Aerial tiles as a run takes them: encoded, and of the ground size that it was trained with."""

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from slicemask import PoseGrid
from slicematch.errors import ConfigError
from slicematch.localization.members import Encoded

log = logging.getLogger(__name__)

# Metres per pixel: beyond these no picture is one of a camera's surroundings.
_FINEST_RESOLUTION, _COARSEST_RESOLUTION = 1e-4, 1e3
# By how much a tile's side on the ground may differ from that in training without a word: the
# tiles of VIGOR's cities differ by as much among themselves.
SIDE_TOLERANCE = 0.1
# How many times larger or smaller it may be at most.
MOST_TIMES = 2.0


@dataclass(frozen=True)
class Window:
    """The square part of a tile that is searched, in the tile's frame; the whole by default.

    Parameters
    ----------
    u0, v0 : float
        Its corner in the north-west.
    side : float
        In shares of the tile's side.
    """

    u0: float = 0.0
    v0: float = 0.0
    side: float = 1.0

    def crop(self, image: Image.Image) -> Image.Image:
        """The part of a tile's image that lies in the window."""
        if self == Window():
            return image
        u1, v1 = self.u0 + self.side, self.v0 + self.side
        (left, right), (top, bottom) = (
            (round(low * size), round(high * size))
            for low, high, size in ((self.u0, u1, image.width), (self.v0, v1, image.height))
        )
        return image.crop((left, top, right, bottom))

    def place_prior(
        self, prior: tuple[float, float, float] | None
    ) -> tuple[float, float, float] | None:
        """A prior (u, v, radius) on the tile as one on the window."""
        if prior is None:
            return None
        u, v, radius = prior
        return (u - self.u0) / self.side, (v - self.v0) / self.side, radius / self.side

    def pose_in_tile(self, pose: NDArray[np.float64]) -> NDArray[np.float64]:
        """A pose [3] in the window as one on the tile."""
        u, v, heading_deg = pose
        return np.array([self.u0 + self.side * u, self.v0 + self.side * v, heading_deg])

    def grid_in_tile(self, grid: PoseGrid) -> PoseGrid:
        """A grid in the window as one on the tile."""
        u0, v0, u1, v1 = (self.side * edge for edge in grid.extent)
        extent = (self.u0 + u0, self.v0 + v0, min(self.u0 + u1, 1.0), min(self.v0 + v1, 1.0))
        return PoseGrid(*grid.shape, extent=extent, places=grid.places)


@dataclass(frozen=True)
class AerialTile:
    """An aerial tile, encoded once for many ground images; made by `Localizer.encode_aerial`.

    Attributes
    ----------
    features : float [1, C, L, L]
        z_a of the window; of an ensemble a tuple with one of each network.
    pixels : int
        Side of the tile as it was handed in.
    metres_per_pixel : float or None
        Of the tile as it was handed in, if known.
    window : Window
        The part of it that is encoded.
    """

    features: Encoded
    pixels: int
    metres_per_pixel: float | None = None
    window: Window = Window()

    @property
    def side_m(self) -> float | None:
        """Side of the window on the ground, metres; None if the resolution is unknown."""
        if self.metres_per_pixel is None:
            return None
        return self.pixels * self.metres_per_pixel * self.window.side


def check_resolution(metres_per_pixel: float) -> float:
    """Return the metres per pixel, or raise ConfigError if they are invalid."""
    if not _FINEST_RESOLUTION <= metres_per_pixel <= _COARSEST_RESOLUTION:
        raise ConfigError(
            f"metres per pixel is {metres_per_pixel!r}; it must be from {_FINEST_RESOLUTION:g} to "
            f"{_COARSEST_RESOLUTION:g}"
        )
    return float(metres_per_pixel)


def trained_window(
    pixels: int, metres_per_pixel: float | None, trained_side_m: float | None, crop: bool = True
) -> Window:
    """The part of a tile that is as large on the ground as the tiles that a run was trained with.

    A larger tile gives its middle, which is logged. A smaller one gives all it has, with a warning:
    what lies around it is not in the image.

    Parameters
    ----------
    pixels : int
        Side of the tile as it was handed in.
    metres_per_pixel : float or None
        Of that tile; None if unknown, and then the whole tile is searched.
    trained_side_m : float or None
        Side of the run's tiles on the ground; None if the run does not say.
    crop : bool
        Whether the tile is still to be encoded; one that is encoded stays whole, with a warning.

    Raises
    ------
    ConfigError
        If the tile is more than `MOST_TIMES` larger or smaller than the run's.
    """
    if metres_per_pixel is None:
        return Window()
    side_m = pixels * check_resolution(metres_per_pixel)
    if trained_side_m is None:
        return Window()
    times = side_m / trained_side_m
    sizes = f"the tile is {side_m:.4g} m wide ({pixels} pixels of {metres_per_pixel:g} m)"
    if not 1 / MOST_TIMES <= times <= MOST_TIMES:
        raise ConfigError(
            f"{sizes} and the run was trained with tiles of {trained_side_m:.4g} m; they may "
            f"differ {MOST_TIMES:g} times at most: check the metres per pixel, or crop a tile of "
            f"about {trained_side_m:.0f} m"
        )
    if abs(times - 1.0) <= SIDE_TOLERANCE:
        return Window()
    if times < 1.0 or not crop:
        log.warning(
            "%s and the run was trained with tiles of %.4g m; answers are less reliable: hand in "
            "a tile of that size",
            sizes,
            trained_side_m,
        )
        return Window()
    # Whole pixels, so that the window is exactly what is cropped.
    kept = round(pixels / times)
    start = (pixels - kept) // 2
    log.warning(
        "%s and the run was trained with tiles of %.4g m; only its middle of that size is searched",
        sizes,
        trained_side_m,
    )
    return Window(start / pixels, start / pixels, kept / pixels)
