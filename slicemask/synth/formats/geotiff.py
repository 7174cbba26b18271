"""A generated city on the globe, and its map as a GeoTIFF in UTM. Needs rasterio."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
import rasterio.warp
from numpy.typing import NDArray
from PIL import Image
from rasterio.errors import RasterioError
from rasterio.transform import from_origin
from rasterio.windows import Window

from slicemask.errors import SynthError
from slicemask.files import atomic_write

_ECCENTRICITY_2 = 0.00669437999014  # of WGS 84, squared


@dataclass(frozen=True)
class Ground:
    """A square of the plane that a city is generated on, laid on the globe.

    Parameters
    ----------
    crs : str
        The UTM zone, such as "EPSG:32618".
    east, north : float
        Of the city's centre in it, metres.
    half_side_m : float
        Of the square.
    metres_per_pixel : float
        Of its map.
    """

    crs: str
    east: float
    north: float
    half_side_m: float
    metres_per_pixel: float

    @classmethod
    def around(
        cls, lat: float, lon: float, half_side_m: float, metres_per_pixel: float
    ) -> "Ground":
        """The square around a place, degrees; its centre is on a whole metre."""
        zone = int((lon + 180.0) // 6.0) + 1
        crs = f"EPSG:{(32600 if lat >= 0 else 32700) + zone}"
        (east,), (north,) = rasterio.warp.transform("EPSG:4326", crs, [lon], [lat])
        return cls(crs, round(east), round(north), half_side_m, metres_per_pixel)

    def on_globe(
        self, places: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Latitudes and longitudes [n] of places [n, 2], metres east and north of the centre."""
        east, north = (places + np.array([self.east, self.north])).T
        lon, lat = rasterio.warp.transform(self.crs, "EPSG:4326", east.tolist(), north.tolist())
        return np.array(lat), np.array(lon)

    def convergence_deg(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """How far the map's north is off true north at places [n, 2], degrees clockwise [n]."""
        step = np.array([0.0, 1.0])
        lat, lon = self.on_globe(places - step)
        further_lat, further_lon = self.on_globe(places + step)
        sine_2 = np.sin(np.radians(lat)) ** 2
        # Radii of curvature to the east and to the north, as a ratio.
        ratio = (1.0 - _ECCENTRICITY_2 * sine_2) / (1.0 - _ECCENTRICITY_2)
        east = (further_lon - lon) * np.cos(np.radians(lat)) * ratio
        return np.asarray(np.degrees(np.arctan2(east, further_lat - lat)))

    def write_map(
        self,
        path: Path,
        pixels: int,
        blocks: Sequence[Path],
        corners: Sequence[tuple[int, int]],
    ) -> None:
        """Put a map together from blocks, whose (row, column) corners are given."""
        west, north = self.east - self.half_side_m, self.north + self.half_side_m
        profile = {
            "driver": "GTiff",
            "width": pixels,
            "height": pixels,
            "count": 3,
            "dtype": "uint8",
            "crs": self.crs,
            "transform": from_origin(west, north, self.metres_per_pixel, self.metres_per_pixel),
            "tiled": True,
            "compress": "deflate",
            "predictor": 2,
            "photometric": "rgb",
        }
        with atomic_write(path, SynthError) as partial:
            try:
                with rasterio.open(partial, "w", **profile) as target:
                    for block, (row, column) in zip(blocks, corners, strict=True):
                        with Image.open(block) as image:
                            values = np.moveaxis(np.asarray(image), -1, 0)
                        window = Window(column, row, values.shape[2], values.shape[1])
                        target.write(values, window=window)
            except RasterioError as error:
                raise SynthError(f"{path}: could not be written: {error}") from error


def is_map(path: Path, pixels: int) -> bool:
    """Whether a map exists and has this side."""
    if not path.exists():
        return False
    try:
        with rasterio.open(path) as found:
            return bool(found.width == found.height == pixels)
    except RasterioError:
        return False
