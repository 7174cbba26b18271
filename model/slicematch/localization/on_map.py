"""Answers on a map: the tile around what is known of a place, and the pose found in it."""

import logging
import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from slicemask.images import Picture
from slicematch.data.errors import PlaceError
from slicematch.data.lattice import lattice_point, lattice_step
from slicematch.data.maps import AerialMap, MapTile
from slicematch.errors import ConfigError
from slicematch.localization.estimate import Estimate
from slicematch.localization.geodesy import check_centre, offset_m, offset_position
from slicematch.localization.localizer import HeadingPrior, Localizer, PlacePrior
from slicematch.localization.probabilities import ellipse
from slicematch.localization.tiles import AerialTile
from slicematch.runs.config import TrainConfig

log = logging.getLogger(__name__)

# Encoded tiles that are kept, for photographs that share them.
_TILES_KEPT = 32


@dataclass(frozen=True)
class PlaceOnGlobe:
    """What is known of a photograph's place before it is looked at.

    Attributes
    ----------
    lat, lon : float
        Degrees on WGS 84.
    within_m : float or None
        How far the camera may be from there; None for anywhere in the tile.
    """

    lat: float
    lon: float
    within_m: float | None = None

    def __post_init__(self) -> None:
        check_centre((self.lat, self.lon), "the place")
        if self.within_m is not None and not (math.isfinite(self.within_m) and self.within_m > 0):
            raise ConfigError(
                f"the camera is within {self.within_m:g} m of the place; it must be above 0"
            )


@dataclass(frozen=True)
class MapAnswer:
    """A pose found on a map.

    Attributes
    ----------
    estimate : Estimate
        In the tile's frame.
    tile : MapTile
        Where the camera was sought; without its image.
    crs : str
        The map's coordinate system.
    x, y : float
        The answer in it.
    """

    estimate: Estimate
    tile: MapTile
    crs: str
    x: float
    y: float

    @classmethod
    def of(cls, estimate: Estimate, tile: MapTile, aerial_map: AerialMap) -> "MapAnswer":
        """An estimate in a tile of a map as an answer on the map."""
        lat, lon = _position(estimate, tile)
        (x,), (y,) = aerial_map.to_map([lat], [lon])
        return cls(
            estimate, replace(tile, image=tile.image[:0]), aerial_map.crs, float(x), float(y)
        )

    @cached_property
    def position(self) -> tuple[float, float]:
        """Latitude and longitude of the answer, degrees on WGS 84."""
        return _position(self.estimate, self.tile)

    def as_row(self) -> dict[str, Any]:
        """The answer as one flat row, rounded to what can matter: millimetres, 0.001 degrees."""
        lat, lon = self.position
        covariance = self.estimate.covariance(self.tile.metres_per_pixel)
        east_m, north_m, heading_deg = covariance.diagonal() ** 0.5
        major_m, minor_m, azimuth_deg = ellipse(covariance[:2, :2])
        digits = 8 if abs(self.x) <= 360 and abs(self.y) <= 360 else 3
        return {
            "lat": round(lat, 8),
            "lon": round(lon, 8),
            "x": round(self.x, digits),
            "y": round(self.y, digits),
            "heading_deg": round(float(self.estimate.pose[2]), 3) % 360.0,
            "score": round(self.estimate.score, 5),
            "probability": round(self.estimate.modes[0].probability, 5),
            "std_east_m": round(float(east_m), 3),
            "std_north_m": round(float(north_m), 3),
            "std_heading_deg": round(float(heading_deg), 3),
            "ellipse_major_m": round(major_m, 3),
            "ellipse_minor_m": round(minor_m, 3),
            "ellipse_azimuth_deg": round(azimuth_deg, 3),
            "tile_lat": self.tile.lat,
            "tile_lon": self.tile.lon,
            "tile_padded": round(self.tile.padded, 4),
        }


class MapLocalizer:
    """Finds photographs on a map: cuts tiles, encodes each once, and keeps the last few.

    Parameters
    ----------
    localizer : Localizer
        Of a trained run.
    aerial_map : AerialMap
        That shows the places.
    side_m : float, optional
        Side of the tiles on the ground; that of the run's own by default.
    shared_m : float, optional
        Tiles are centred on a lattice of so many metres, so that photographs near each other share
        them; 0 for a tile of its own around each place. By default a sixteenth of the side.

    Raises
    ------
    ConfigError
        If the run does not say how large its tiles are, or asks for tiles that a map cannot give.
    """

    def __init__(
        self,
        localizer: Localizer,
        aerial_map: AerialMap,
        side_m: float | None = None,
        shared_m: float | None = None,
    ) -> None:
        self.localizer = localizer
        self.map = aerial_map
        self.side_m = tile_side(localizer.config, side_m)
        self.shared_m = lattice_step(self.side_m, shared_m)
        self._tiles: dict[tuple[float, float], tuple[MapTile, AerialTile]] = {}

    def localize(
        self, ground: Picture, place: PlaceOnGlobe, heading_prior: HeadingPrior | None = None
    ) -> MapAnswer:
        """Find the pose of a photograph near a place.

        Parameters
        ----------
        ground : path, PIL image or uint8 [height, width, 3]
            As `Localizer.localize` takes it.
        place : PlaceOnGlobe
            Where to look.
        heading_prior : (centre, half_width), optional
            Degrees clockwise from north; as for `Localizer.localize`.

        Raises
        ------
        PlaceError
            If the map does not show the place.
        ImageError, ConfigError
            As `Localizer.localize` raises them.
        """
        try:
            tile, encoded = self._encoded(lattice_point(place.lat, place.lon, self.shared_m))
        except PlaceError:
            # Of the place that was asked for, and not of the tile's centre; or on the map's edge,
            # where only a tile of its own shows enough.
            tile, encoded = self._encoded((place.lat, place.lon))
        prior = place_prior(place, tile)
        estimate = self.localizer.localize(ground, encoded, heading_prior, prior)
        return MapAnswer.of(estimate, tile, self.map)

    def _encoded(self, centre: tuple[float, float]) -> tuple[MapTile, AerialTile]:
        if centre not in self._tiles:
            pixels = self.localizer.config.aerial_size
            tile = self.map.cut(*centre, self.side_m, pixels)
            encoded = self.localizer.encode_aerial(
                tile.image, metres_per_pixel=tile.metres_per_pixel
            )
            while len(self._tiles) >= _TILES_KEPT:
                del self._tiles[next(iter(self._tiles))]  # the oldest
            self._tiles[centre] = replace(tile, image=tile.image[:0]), encoded
        return self._tiles[centre]


def tile_side(config: TrainConfig, side_m: float | None = None) -> float:
    """Side on the ground of the tiles that a run takes from a map, metres.

    Raises
    ------
    ConfigError
        If neither the run nor the caller says it, or the run's tiles are no cuts of a map.
    """
    if config.data == "kitti":
        raise ConfigError(
            "the run was trained on KITTI, whose tiles are turned with the car; a map gives tiles "
            "with north up: train on VIGOR's or on a table's"
        )
    side = config.tile_side_m if side_m is None else side_m
    if side is None:
        raise ConfigError(
            "the run does not say how large its tiles are on the ground; say it (--tile-side 72m)"
        )
    if not (math.isfinite(side) and side > 0):
        raise ConfigError(f"the tiles' side is {side:g} m; it must be above 0")
    return float(side)


def place_prior(place: PlaceOnGlobe, tile: MapTile) -> PlacePrior | None:
    """What is known of a place as a prior (u, v, radius) on a tile."""
    if place.within_m is None:
        return None
    east_m, north_m = offset_m((tile.lat, tile.lon), (place.lat, place.lon))
    side_m = tile.side_m
    if place.within_m > side_m / 2:
        log.warning(
            "the camera may be up to %g m from its place, and tiles are %.4g m wide: it is sought "
            "in the tile alone",
            place.within_m,
            side_m,
        )
    return 0.5 + east_m / side_m, 0.5 - north_m / side_m, place.within_m / side_m


def _position(estimate: Estimate, tile: MapTile) -> tuple[float, float]:
    return offset_position((tile.lat, tile.lon), *estimate.offset_m(tile.metres_per_pixel))
