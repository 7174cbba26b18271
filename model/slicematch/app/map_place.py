"""A place on a map, typed in degrees, and the tile that is cut around it."""

from collections.abc import Callable
from typing import Any

import panel as pn

from slicemask.errors import SlicemaskError
from slicematch.data.errors import PlaceError
from slicematch.data.maps import AerialMap, MapTile

# Pixels of a tile that is cut: what the page shows; the run takes them in its own size.
_PIXELS = 640


class MapPlace:
    """A field for a place, which cuts a tile of the map around it.

    Parameters
    ----------
    aerial_map : AerialMap
        What tiles are cut from.
    side_m : float
        Side of the tiles on the ground, metres.
    cut : callable
        Takes the tile.
    refused : callable
        Takes a sentence that says why there is none.
    """

    def __init__(
        self,
        aerial_map: AerialMap,
        side_m: float,
        cut: Callable[[MapTile], None],
        refused: Callable[[str], None],
    ) -> None:
        self._map, self._side_m = aerial_map, side_m
        self._cut, self._refused = cut, refused
        south, west, north, east = aerial_map.bounds()
        self.field = pn.widgets.TextInput(
            name="Place on the map: latitude, longitude",
            placeholder=f"{(south + north) / 2:.5f}, {(west + east) / 2:.5f}",
            sizing_mode="stretch_width",
        )
        self.field.param.watch(self._typed, "value")

    def _typed(self, event: Any) -> None:
        if not event.new.strip():
            return
        try:
            tile = self._map.cut(*_read_place(event.new), self._side_m, _PIXELS)
        except SlicemaskError as error:
            self._refused(str(error))
            return
        self._refused("")
        self._cut(tile)


def _read_place(text: str) -> tuple[float, float]:
    try:
        lat, lon = map(float, text.replace(",", " ").split())
    except ValueError:
        raise PlaceError(
            f"{text.strip()[:60]!r} is no place; expected latitude and longitude in degrees, "
            "such as 52.0005, 4.3712"
        ) from None
    return lat, lon
