"""The cameras that look at a scene: panorama, pinhole and aerial.

Pixels are addressed by (row, column) with pixel centres at halves: row 0.5, column 0.5 is the
centre of the first pixel. A camera turns them into rays, and points of the scene back into them.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
# Aerial rays start above all that is built.
SKY_M = 400.0


class Camera(Protocol):
    """What `render` needs of a camera."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the image."""

    def rays(self, row: Floats, column: Floats) -> tuple[Floats, Floats]:
        """Origins and unit directions, float64 [n, 3] each, of pixels' rays."""

    def footprint_m(self, distance_m: NDArray[np.float32]) -> NDArray[np.float32]:
        """Width of a pixel across the ray at a distance, metres."""


@dataclass(frozen=True)
class Panorama:
    """An equirectangular camera, as in VIGOR.

    Parameters
    ----------
    position : (x, y, z)
        Metres.
    shape : (rows, columns)
        Rows go from the zenith to the nadir.
    pitch_deg, roll_deg
        By which the camera is not level: up to the north, and down to the east.
    heading_deg
        Of the centre column, clockwise from north, of a level camera; VIGOR's face north.
    """

    position: tuple[float, float, float]
    shape: tuple[int, int]
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    heading_deg: float = 0.0

    @property
    def _tilt(self) -> Floats | None:
        """The matrix from the camera's frame to the world's, float64 [3, 3]; None if level."""
        if not (self.pitch_deg or self.roll_deg):
            return None
        pitch, roll = np.radians([self.pitch_deg, self.roll_deg])
        c, s = np.cos(pitch), np.sin(pitch)
        about_east = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
        c, s = np.cos(roll), np.sin(roll)
        about_north = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        return np.asarray(about_east @ about_north)

    def rays(self, row: Floats, column: Floats) -> tuple[Floats, Floats]:
        """Origins and unit directions, float64 [n, 3] each, of pixels' rays."""
        azimuth = 2 * np.pi * (np.asarray(column) / self.shape[1] - 0.5)
        azimuth = azimuth + np.radians(self.heading_deg)
        elevation = np.pi * (0.5 - np.asarray(row) / self.shape[0])
        level = np.cos(elevation)
        directions = [level * np.sin(azimuth), level * np.cos(azimuth), np.sin(elevation)]
        rays = np.stack(directions, axis=-1)
        if self._tilt is not None:
            rays = rays @ self._tilt.T
        return np.broadcast_to(np.array(self.position), rays.shape), rays

    def footprint_m(self, distance_m: NDArray[np.float32]) -> NDArray[np.float32]:
        """Width of a pixel across the ray at a distance, metres."""
        return distance_m * np.float32(np.pi / self.shape[0])

    def project(self, points: Floats) -> tuple[Floats, Floats]:
        """Rows and columns [n] where points [n, 3] show."""
        offset = np.asarray(points) - self.position
        if self._tilt is not None:
            offset = offset @ self._tilt
        x, y, z = offset.T
        azimuth = np.arctan2(x, y) - np.radians(self.heading_deg)
        column = (azimuth / (2 * np.pi) + 0.5) % 1.0 * self.shape[1]
        row = (0.5 - np.arctan2(z, np.hypot(x, y)) / np.pi) * self.shape[0]
        return row, column


@dataclass(frozen=True)
class Pinhole:
    """A level pinhole camera, as in KITTI.

    Parameters
    ----------
    position : (x, y, z)
        Metres.
    heading_deg
        Where the optical axis looks, clockwise from north.
    shape : (rows, columns)
    focal_pixels
        Focal length.
    horizon_row
        The row at the height of the camera.
    principal_column
        The column that looks along the heading; the centre by default.
    """

    position: tuple[float, float, float]
    heading_deg: float
    shape: tuple[int, int]
    focal_pixels: float
    horizon_row: float
    principal_column: float | None = None

    @property
    def _column(self) -> float:
        return self.shape[1] / 2 if self.principal_column is None else self.principal_column

    def _ahead_and_right(self) -> tuple[Floats, Floats]:
        sin, cos = np.sin(np.radians(self.heading_deg)), np.cos(np.radians(self.heading_deg))
        return np.array([sin, cos, 0.0]), np.array([cos, -sin, 0.0])

    def rays(self, row: Floats, column: Floats) -> tuple[Floats, Floats]:
        """Origins and unit directions, float64 [n, 3] each, of pixels' rays."""
        ahead, right = self._ahead_and_right()
        across = (np.asarray(column) - self._column)[..., None] / self.focal_pixels
        up = (self.horizon_row - np.asarray(row))[..., None] / self.focal_pixels
        rays = ahead + across * right + up * np.array([0.0, 0.0, 1.0])
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        return np.broadcast_to(np.array(self.position), rays.shape), rays

    def footprint_m(self, distance_m: NDArray[np.float32]) -> NDArray[np.float32]:
        """Width of a pixel across the ray at a distance, metres."""
        return distance_m / np.float32(self.focal_pixels)

    def project(self, points: Floats) -> tuple[Floats, Floats]:
        """Rows and columns [n] where points [n, 3] in front of the camera show."""
        ahead, right = self._ahead_and_right()
        offset = np.asarray(points) - self.position
        depth = offset @ ahead
        column = self._column + self.focal_pixels * (offset @ right) / depth
        return self.horizon_row - self.focal_pixels * offset[..., 2] / depth, column


@dataclass(frozen=True)
class Aerial:
    """An orthographic camera that looks down, north up.

    Parameters
    ----------
    north_west : (x, y)
        The outer corner of the first pixel, metres.
    metres_per_pixel
        Size of a pixel on the ground.
    shape : (rows, columns)
    lean : (east, north)
        Metres by which a point shows away from its place for each metre of its height; (0, 0) for
        a camera that looks straight down. The ground at height 0 shows where it is.
    """

    north_west: tuple[float, float]
    metres_per_pixel: float
    shape: tuple[int, int]
    lean: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def centred(cls, x: float, y: float, metres_per_pixel: float, pixels: int) -> "Aerial":
        """A square image around a point."""
        half = metres_per_pixel * pixels / 2
        return cls((x - half, y + half), metres_per_pixel, (pixels, pixels))

    def rays(self, row: Floats, column: Floats) -> tuple[Floats, Floats]:
        """Origins and unit directions, float64 [n, 3] each, of pixels' rays."""
        x = self.north_west[0] + np.asarray(column) * self.metres_per_pixel
        y = self.north_west[1] - np.asarray(row) * self.metres_per_pixel
        east, north = self.lean
        origins = np.stack([x - east * SKY_M, y - north * SKY_M, np.full_like(x, SKY_M)], axis=-1)
        down = np.array([east, north, -1.0]) / np.sqrt(1.0 + east**2 + north**2)
        return origins, np.broadcast_to(down, origins.shape)

    def footprint_m(self, distance_m: NDArray[np.float32]) -> NDArray[np.float32]:
        """Width of a pixel across the ray at a distance, metres."""
        return np.full_like(distance_m, self.metres_per_pixel)

    def project(self, points: Floats) -> tuple[Floats, Floats]:
        """Rows and columns [n] where points [n, 3] (or [n, 2]) show."""
        points = np.asarray(points)
        x, y = points[..., 0], points[..., 1]
        if points.shape[-1] == 3:
            x, y = x + self.lean[0] * points[..., 2], y + self.lean[1] * points[..., 2]
        column = (x - self.north_west[0]) / self.metres_per_pixel
        return (self.north_west[1] - y) / self.metres_per_pixel, column
