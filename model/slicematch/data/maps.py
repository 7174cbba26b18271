"""Aerial maps: square tiles of a georeferenced raster, cut where cameras are sought."""

import logging
import math
import os
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from slicemask.image_depth import Stretch, stretch_for
from slicematch.data.errors import MapError, PlaceError
from slicematch.errors import ConfigError

if TYPE_CHECKING:
    from rasterio.io import DatasetReader

log = logging.getLogger(__name__)

# Tiles that lack more than this share are no map of a place.
MAX_PADDED = 0.5
# Values of 16 bits are sampled in this many windows along each side, of so many pixels.
_SAMPLED_WINDOWS, _SAMPLED_PIXELS = 16, 64
_MAX_TILE_PIXELS = 8192


@dataclass(frozen=True, eq=False)
class MapTile:
    """A square tile of a map, north up at its centre.

    Attributes
    ----------
    image : uint8 [S, S, 3]
        Red, green, blue. Where the map has no data, it is the mean colour of the rest.
    lat, lon : float
        Of its centre, degrees on WGS 84.
    metres_per_pixel : float
        On the ground.
    padded : float
        Share of its pixels where the map has no data, in [0, 1].
    side_m : float
        Its side on the ground.
    """

    image: NDArray[np.uint8]
    lat: float
    lon: float
    metres_per_pixel: float
    padded: float
    side_m: float


class AerialMap:
    """A georeferenced raster of aerial images; made by `AerialMap.open`.

    Any number of tiles is cut from it, each by reading what it needs. It can be pickled and used in
    worker processes: each opens the file for itself.

    Attributes
    ----------
    path : str
        Of its file.
    crs : str
        Its coordinate system: "EPSG:25832", or WKT where it has no such code.
    """

    def __init__(self, path: str, crs: str | None = None) -> None:
        self.path = path
        self._given_crs = crs
        self._opened: tuple[int, DatasetReader] | None = None
        with _said(path):
            dataset = self._dataset
            self._check(dataset)
            self._crs = _usable_crs(path, dataset.crs if crs is None else crs)
        self.crs: str = self._crs.to_string()
        self._bands, self._alpha = _bands(path, dataset)
        self._palette = _palette(dataset, self._bands)
        self._stretch = self._find_stretch()

    @classmethod
    def open(cls, path: str | Path, crs: str | None = None) -> "AerialMap":
        """Open a map.

        Parameters
        ----------
        path : path
            A raster that GDAL reads: GeoTIFF, Cloud Optimized GeoTIFF, JPEG 2000, a VRT of many
            files, or a service described in a file. 8 or 16 bits a channel: three or more bands, of
            which red, green and blue are found by their colour interpretation, grey or a palette.
        crs : str, optional
            Its coordinate system, such as "EPSG:25832", where the file does not say.

        Returns
        -------
        AerialMap

        Raises
        ------
        MapError
            If rasterio is not installed, or the map cannot be opened, has no place on the globe,
            or has other pixels.
        """
        return cls(os.fspath(path), crs)

    def cut(
        self, lat: float, lon: float, side_m: float, pixels: int, max_padded: float = MAX_PADDED
    ) -> MapTile:
        """Cut a square tile around a place.

        The tile lies in the azimuthal equidistant projection that is centred on the place: east
        and north are straight, and metres are metres.

        Parameters
        ----------
        lat, lon : float
            Of its centre, degrees on WGS 84.
        side_m : float
            Its side on the ground, metres.
        pixels : int
            Its side S in pixels.
        max_padded : float
            Share of the tile that may lack data, in [0, 1).

        Returns
        -------
        MapTile

        Raises
        ------
        PlaceError
            If this is no place, or the map lacks more of its surroundings than is allowed.
        ConfigError
            If the side or the pixels are invalid.
        MapError
            If the map cannot be read.
        """
        lat, lon = _check_place(lat, lon)
        if not (math.isfinite(side_m) and side_m > 0):
            raise ConfigError(f"the tile's side is {side_m:g} m; it must be above 0")
        if not 1 <= pixels <= _MAX_TILE_PIXELS:
            raise ConfigError(f"the tile has {pixels} pixels; it must be 1 to {_MAX_TILE_PIXELS}")
        with _said(self.path):
            values, present = self._read(lat, lon, side_m, pixels)
        padded = 1.0 - float(present.mean())
        if padded > max_padded:
            raise PlaceError(self._missing(lat, lon, side_m, padded, max_padded))
        if self._palette is not None:
            image = self._palette[values[0]]
        else:
            image = self._to_8_bits(np.moveaxis(values, 0, -1))
            if image.shape[2] == 1:
                image = np.repeat(image, 3, axis=2)
        if padded:
            image[~present] = image[present].mean(axis=0).round()
        return MapTile(
            np.ascontiguousarray(image), lat, lon, side_m / pixels, padded, float(side_m)
        )

    def to_map(
        self, lat: Sequence[float], lon: Sequence[float]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Places as x, y in the map's coordinate system, float64 [n] each.

        Parameters
        ----------
        lat, lon : float [n]
            Degrees on WGS 84.
        """
        from rasterio.warp import transform

        with _said(self.path):
            x, y = transform("EPSG:4326", self._crs, list(lon), list(lat))[:2]
        return np.asarray(x, np.float64), np.asarray(y, np.float64)

    def to_globe(
        self, x: Sequence[float], y: Sequence[float]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Places in the map's coordinate system as lat, lon in degrees, float64 [n] each.

        Parameters
        ----------
        x, y : float [n]
            In the units of the map's coordinate system, x to the east.
        """
        from rasterio.warp import transform

        with _said(self.path):
            lon, lat = transform(self._crs, "EPSG:4326", list(x), list(y))[:2]
        return np.asarray(lat, np.float64), np.asarray(lon, np.float64)

    def bounds(self) -> tuple[float, float, float, float]:
        """South, west, north and east of the map's edges, degrees on WGS 84."""
        box = self._dataset.bounds
        steps = np.linspace(0.0, 1.0, 21)
        x, y = (low + (high - low) * steps for low, high in ((box[0], box[2]), (box[1], box[3])))
        edges = [(x, y * 0 + end) for end in (box[1], box[3])]
        edges += [(x * 0 + end, y) for end in (box[0], box[2])]
        around_x, around_y = (np.concatenate(axis) for axis in zip(*edges, strict=True))
        lat, lon = self.to_globe(around_x.tolist(), around_y.tolist())
        return float(lat.min()), float(lon.min()), float(lat.max()), float(lon.max())

    @property
    def has_overviews(self) -> bool:
        """Whether the file holds smaller copies of itself, so that large cuts are quick."""
        return bool(self._dataset.overviews(self._bands[0]))

    def metres_per_pixel(self, lat: float, lon: float) -> float:
        """Side of the map's own pixels on the ground at a place, metres."""
        (x,), (y,) = self.to_map([lat], [lon])
        step = self._dataset.transform  # a, d: from a pixel to the next one in its row
        at_lat, at_lon = self.to_globe([x, x + step.a], [y, y + step.d])
        from slicematch.localization.geodesy import offset_m

        return math.hypot(*offset_m((at_lat[0], at_lon[0]), (at_lat[1], at_lon[1])))

    def __repr__(self) -> str:
        dataset = self._dataset
        return f"<AerialMap {self.path}: {dataset.width}x{dataset.height} pixels, {self.crs}>"

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_opened": None}

    @property
    def _dataset(self) -> "DatasetReader":
        """The file, opened in this process: GDAL's handles do not live on in a forked one."""
        if self._opened is None or self._opened[0] != os.getpid():
            rasterio = _rasterio()
            with warnings.catch_warnings():  # `_check` says it as an error
                warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
                self._opened = os.getpid(), rasterio.open(self.path)
        return self._opened[1]

    def _check(self, dataset: "DatasetReader") -> None:
        if dataset.count == 0:
            raise MapError(
                f"{self.path}: holds {len(dataset.subdatasets)} rasters and none by itself; name "
                "one of those that gdalinfo lists"
            )
        if dataset.crs is None and self._given_crs is None:
            raise MapError(
                f"{self.path}: says no coordinate system, so that nobody knows where it lies; name "
                "it (--map-crs EPSG:...), or write it into the file: gdal_edit.py -a_srs EPSG:..."
            )
        if dataset.transform.is_identity:
            raise MapError(
                f"{self.path}: does not say where its pixels lie; georeference it, with gdalwarp "
                "or a world file beside it"
            )

    def _read(
        self, lat: float, lon: float, side_m: float, pixels: int
    ) -> tuple[NDArray[Any], NDArray[np.bool]]:
        """Values [bands, S, S] of a tile, and where there are any, bool [S, S]."""
        from rasterio.enums import Resampling
        from rasterio.transform import from_origin
        from rasterio.vrt import WarpedVRT

        size_m = side_m / pixels
        with WarpedVRT(
            self._dataset,
            src_crs=self._crs,
            crs=f"+proj=aeqd +lat_0={lat!r} +lon_0={lon!r} +datum=WGS84 +units=m +no_defs",
            transform=from_origin(-side_m / 2, side_m / 2, size_m, size_m),
            width=pixels,
            height=pixels,
            # Colours between two of a palette are none of it.
            resampling=Resampling.nearest if self._palette is not None else Resampling.bilinear,
            add_alpha=self._alpha is None,
        ) as tile:
            read = tile.read([*self._bands, self._alpha or tile.count])
        return read[:-1], read[-1] > 0

    def _to_8_bits(self, values: NDArray[Any]) -> NDArray[np.uint8]:
        return values if self._stretch is None else self._stretch.apply(values)

    def _find_stretch(self) -> Stretch | None:
        """One scale for the whole map, so that tiles of a place look alike; None for 8 bits."""
        from rasterio.windows import Window

        dataset = self._dataset
        if dataset.dtypes[self._bands[0] - 1] != "uint16":
            return None
        sampled = []
        with _said(self.path):
            for row in _starts(dataset.height):
                for column in _starts(dataset.width):
                    window = Window(column, row, _SAMPLED_PIXELS, _SAMPLED_PIXELS)
                    values = dataset.read(self._bands, window=window)
                    sampled.append(values[:, dataset.dataset_mask(window=window) > 0].ravel())
        values = np.concatenate(sampled)
        if not values.size:
            raise MapError(f"{self.path}: holds no data wherever it was looked at; name another")
        stretch = stretch_for(values)
        log.warning("%s: has 16 bits a channel; scaled to 8 bits %s", self.path, stretch)
        return stretch

    def _missing(
        self, lat: float, lon: float, side_m: float, padded: float, max_padded: float
    ) -> str:
        """What to say of a tile that the map does not show."""
        place = f"{lat:.6f},{lon:.6f}"
        if padded < 1.0:
            return (
                f"{self.path}: has no data in {padded:.0%} of the {side_m:.4g} m around {place}; "
                f"at most {max_padded:.0%} may be missing: name a map that shows the place"
            )
        south, west, north, east = self.bounds()
        if south <= lat <= north and west <= lon <= east:
            return (
                f"{self.path}: has no data around {place}, though its edges enclose that place; "
                "name a map without the hole"
            )
        hint = "name a map that shows the place"
        if south <= lon <= north and west <= lat <= east:
            hint = f"latitude comes first: if the two are swapped, give {lon:.6f},{lat:.6f}"
        return (
            f"{self.path}: does not show {place}; it reaches from {south:.6f},{west:.6f} to "
            f"{north:.6f},{east:.6f}: {hint}"
        )


def _rasterio() -> Any:
    try:
        import rasterio
        import rasterio.errors
    except ImportError as error:
        raise MapError(
            f"maps need rasterio, which cannot be imported ({error}); install: "
            "pip install 'slicemask[maps]'"
        ) from error
    return rasterio


@contextmanager
def _said(path: str) -> Iterator[None]:
    """Raise what GDAL raises as a `MapError`."""
    errors = _rasterio().errors
    try:
        yield
    except errors.CRSError as error:
        raise MapError(f"{path}: its coordinate system is unusable: {_first(error)}") from error
    except errors.RasterioError as error:
        if "://" not in path and not path.startswith("/vsi") and not Path(path).exists():
            raise MapError(f"{path}: there is no such file; name a map") from error
        raise MapError(
            f"{path}: cannot be read as a map ({_first(error)}); name a raster that gdalinfo reads"
        ) from error


def _first(error: Exception) -> str:
    """The first line of what GDAL says, or of what made it say so."""
    text = str(error.__cause__ or error).strip() or type(error).__name__
    return text.splitlines()[0].rstrip(".")


def _usable_crs(path: str, crs: Any) -> Any:
    """A coordinate system that leads to places on the globe."""
    from rasterio.crs import CRS
    from rasterio.errors import CRSError

    try:
        found = CRS.from_user_input(crs)
    except (CRSError, ValueError) as error:
        raise MapError(
            f"the map's coordinate system is {crs!r}, which is unknown; give one such as EPSG:25832"
        ) from error
    if not (found.is_geographic or found.is_projected):
        raise MapError(
            f"{path}: has a coordinate system of its own ({found.to_wkt()[:60]}...), without units "
            "on the globe; name the true one (--map-crs EPSG:...)"
        )
    return found


def _bands(path: str, dataset: "DatasetReader") -> tuple[list[int], int | None]:
    """Which bands are red, green and blue, or the one that is grey; and which is alpha, if any."""
    from rasterio.enums import ColorInterp

    kinds = list(dataset.colorinterp)
    alpha = kinds.index(ColorInterp.alpha) + 1 if ColorInterp.alpha in kinds else None
    colours = [ColorInterp.red, ColorInterp.green, ColorInterp.blue]
    if all(colour in kinds for colour in colours):
        bands = [kinds.index(colour) + 1 for colour in colours]
    else:
        others = [band for band in range(1, dataset.count + 1) if band != alpha]
        bands = others[: 3 if len(others) >= 3 else 1]
    if not bands:
        raise MapError(f"{path}: holds alpha alone; name a map with colours")
    depths = {dataset.dtypes[band - 1] for band in bands}
    if not depths <= {"uint8", "uint16"} or len(depths) > 1:
        raise MapError(
            f"{path}: has pixels of {' and '.join(sorted(depths))}; expected 8 or 16 bits without "
            "a sign in each band: convert it with gdal_translate -ot Byte -scale"
        )
    return bands, alpha


def _palette(dataset: "DatasetReader", bands: list[int]) -> NDArray[np.uint8] | None:
    """Colours uint8 [values, 3] of a map with a palette."""
    from rasterio.enums import ColorInterp

    if dataset.colorinterp[bands[0] - 1] != ColorInterp.palette:
        return None
    colours = np.zeros((2**16, 3), np.uint8)
    for value, colour in dataset.colormap(bands[0]).items():
        colours[value] = colour[:3]
    return colours


def _starts(size: int) -> list[int]:
    """Where windows begin that sample a side of so many pixels."""
    last = max(size - _SAMPLED_PIXELS, 0)
    return sorted(set(np.linspace(0, last, _SAMPLED_WINDOWS).round().astype(int).tolist()))


def _check_place(lat: float, lon: float) -> tuple[float, float]:
    from slicematch.localization.geodesy import check_centre  # here, for pyproj's sake

    try:
        return check_centre((lat, lon), "the place")
    except ConfigError as error:
        raise PlaceError(str(error)) from error
