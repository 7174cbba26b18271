"""Whether the rows of a table hold what training and evaluation need: a heading and a place."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slicematch.data.photographs import Photographs

if TYPE_CHECKING:
    from slicematch.data.maps import AerialMap


def check_rows(
    photographs: Photographs, rows: NDArray[np.intp], aerial_map: "AerialMap | None"
) -> None:
    """Refuse rows that lack what a sample needs.

    Parameters
    ----------
    photographs : Photographs
        The table.
    rows : int [m]
        Those to check.
    aerial_map : AerialMap or None
        The map of rows without a tile.

    Raises
    ------
    DatasetError
        If a row lacks its heading or its place; the text names its row and column. If the map
        shows the place of none.
    """
    has = photographs.has
    in_tile = has("u", "v")
    on_globe = has("lat", "lon")
    tiled = np.array([tile is not None for tile in photographs.tile])
    needs = (
        ("heading_deg", has("heading_deg"), "degrees clockwise from north, of the image's centre"),
        ("metres_per_pixel", has("metres_per_pixel") | ~tiled, "that of the row's tile"),
        ("v", has("v") | ~has("u") | ~tiled, "a number from 0 to 1, beside u"),
        ("u", in_tile | on_globe | ~tiled, "the camera's place in its tile, or lat, lon instead"),
        (
            "tile_lat",
            in_tile | has("tile_lat", "tile_lon") | ~tiled,
            "with tile_lon the centre of the tile, which lat and lon are held against",
        ),
        ("lat", on_globe | tiled, "with lon the camera's place, as the row has no tile"),
        (
            "tile",
            tiled | (aerial_map is not None),
            "an aerial tile, or a map for all such rows (--map, or map.tif beside the table)",
        ),
    )
    for column, holds, expected in needs:
        lacking = rows[~holds[rows]]
        if len(lacking):
            raise photographs.wrong(int(lacking[0]), column, expected)
    if aerial_map is not None:
        _check_places(photographs, rows[~tiled[rows]], aerial_map)


def _check_places(
    photographs: Photographs, rows: NDArray[np.intp], aerial_map: "AerialMap"
) -> None:
    """Refuse a map that shows none of the rows' places; single ones fail as they are cut."""
    south, west, north, east = aerial_map.bounds()
    lat, lon = (photographs.numbers[column][rows] for column in ("lat", "lon"))

    def shown(lat: NDArray[np.float64], lon: NDArray[np.float64]) -> NDArray[np.bool]:
        return (south <= lat) & (lat <= north) & (west <= lon) & (lon <= east)

    if len(rows) and not shown(lat, lon).any():
        swapped = "; lat and lon are swapped: exchange them" if shown(lon, lat).any() else ""
        expected = (
            f"a place on the map {aerial_map.path}, which reaches from {south:.6f},{west:.6f} to "
            f"{north:.6f},{east:.6f} (lat,lon) and shows none of the rows{swapped}"
        )
        raise photographs.wrong(int(rows[0]), "lat", expected)
