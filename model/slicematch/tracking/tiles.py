"""Tiles of a map along a drive: on a lattice, encoded once each, the next ones ahead of time."""

import logging
import math
from collections import OrderedDict
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slicematch.data.errors import PlaceError
from slicematch.data.maps import AerialMap
from slicematch.localization.geodesy import offset_m, offset_position
from slicematch.tracking.local_scores import LocalScorer, ScoredTile

log = logging.getLogger(__name__)

Floats = NDArray[np.float64]
Key = tuple[int, int]
# The lattice's step, in shares of a tile's side: a camera is at most an eighth of the side from the
# middle of its tile, to the east and to the north, far from all edges.
STEP_SHARE = 1 / 4
TILES_KEPT = 24


@dataclass(frozen=True)
class TrackTile:
    """An encoded tile at its place in the frame of a drive.

    Attributes
    ----------
    scored : ScoredTile
    east_m, north_m : float
        Its centre.
    turn_deg : float
        By how much its north is turned from the frame's, clockwise.
    side_m : float
        Of its window.
    """

    scored: ScoredTile
    east_m: float
    north_m: float
    turn_deg: float
    side_m: float

    def poses(self, states: Floats) -> Floats:
        """Poses (east_m, north_m, heading_deg) [P, 3] of the drive's frame as u, v, heading."""
        angle = math.radians(self.turn_deg)
        east, north = states[:, 0] - self.east_m, states[:, 1] - self.north_m
        right = east * math.cos(angle) - north * math.sin(angle)
        up = east * math.sin(angle) + north * math.cos(angle)
        return np.column_stack(
            [0.5 + right / self.side_m, 0.5 - up / self.side_m, states[:, 2] - self.turn_deg]
        )

    def states(self, poses: Floats) -> Floats:
        """The inverse of `poses`."""
        angle = math.radians(self.turn_deg)
        right, up = (poses[:, 0] - 0.5) * self.side_m, (0.5 - poses[:, 1]) * self.side_m
        return np.column_stack(
            [
                self.east_m + right * math.cos(angle) + up * math.sin(angle),
                self.north_m - right * math.sin(angle) + up * math.cos(angle),
                (poses[:, 2] + self.turn_deg) % 360.0,
            ]
        )


class TrackTiles:
    """The tiles of a drive.

    Metres east and north are those of the azimuthal equidistant projection around the drive's
    origin; tiles are north up each by itself, which far from the origin is another direction.

    Parameters
    ----------
    scorer : LocalScorer
    aerial_map : AerialMap
    origin : (latitude, longitude)
    side_m : float
        Of the tiles on the ground.
    """

    def __init__(
        self,
        scorer: LocalScorer,
        aerial_map: AerialMap,
        origin: tuple[float, float],
        side_m: float,
    ) -> None:
        self.scorer, self.map = scorer, aerial_map
        self.origin, self.side_m = origin, side_m
        self.step_m = STEP_SHARE * side_m
        self._tiles: OrderedDict[Key, Future[TrackTile | None]] = OrderedDict()
        # One thread: what reads the map is for one thread at a time.
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="tiles")
        self._at_the_edge: set[Key] = set()

    def at(self, east_m: float, north_m: float) -> TrackTile | None:
        """The tile whose middle is nearest to a place; None where the map shows too little."""
        return self._future(self._key(east_m, north_m)).result()

    def ahead(self, east_m: float, north_m: float) -> None:
        """Have the tile of a place encoded, without waiting for it."""
        if np.isfinite([east_m, north_m]).all():
            self._future(self._key(east_m, north_m))

    def close(self) -> None:
        """Wait for what is being encoded, and end the thread."""
        self._worker.shutdown(cancel_futures=True)

    def globe(self, east_m: float, north_m: float) -> tuple[float, float]:
        """Latitude and longitude of a place of the frame."""
        return offset_position(self.origin, east_m, north_m)

    def metres(self, lat: float, lon: float) -> tuple[float, float]:
        """A place on the globe in the frame, metres east and north."""
        return offset_m(self.origin, (lat, lon))

    def turn_deg(self, lat: float, lon: float) -> float:
        """By how much north at a place is turned from the frame's, clockwise: the convergence."""
        return convergence_deg(self.origin, (lat, lon))

    def _key(self, east_m: float, north_m: float) -> Key:
        return round(east_m / self.step_m), round(north_m / self.step_m)

    def _future(self, key: Key) -> "Future[TrackTile | None]":
        if key not in self._tiles:
            self._tiles[key] = self._worker.submit(self._encode, key)
            while len(self._tiles) > TILES_KEPT:
                self._tiles.popitem(last=False)  # the one that was not used for longest
        self._tiles.move_to_end(key)
        return self._tiles[key]

    def _encode(self, key: Key) -> TrackTile | None:
        east_m, north_m = (self.step_m * number for number in key)
        lat, lon = self.globe(east_m, north_m)
        localizer = self.scorer.localizer
        try:
            tile = self.map.cut(lat, lon, self.side_m, localizer.config.aerial_size)
        except PlaceError as error:
            log.debug("%s", error)
            return None
        encoded = localizer.encode_aerial(tile.image, metres_per_pixel=tile.metres_per_pixel)
        scored = self.scorer.describe(encoded)
        side_m = encoded.side_m or self.side_m
        return TrackTile(scored, east_m, north_m, self.turn_deg(lat, lon), side_m)


def convergence_deg(origin: tuple[float, float], place: tuple[float, float]) -> float:
    """North at a place against north at the origin, in the projection around it: clockwise.

    Parameters
    ----------
    origin, place : (latitude, longitude)
        Degrees, less than some hundred kilometres apart.
    """
    east_deg = (place[1] - origin[1] + 180.0) % 360.0 - 180.0
    return -east_deg * math.sin(math.radians((origin[0] + place[0]) / 2.0))
