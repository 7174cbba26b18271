"""Tiles cut from a map for a table of photographs, to train on without the map."""

import json
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from PIL import Image

from slicemask.errors import OutputError
from slicemask.files import atomic_write, check_folder, write_text
from slicematch.data.errors import DatasetError, PlaceError, SampleError
from slicematch.data.lattice import lattice_point, lattice_step
from slicematch.data.maps import AerialMap
from slicematch.data.photographs import Photographs, read_photographs
from slicematch.data.positions import read_fix
from slicematch.data.table_files import write_table
from slicematch.errors import ConfigError

# Half as wide again as the tiles that are trained on: these are cut out of them at random.
DEFAULT_SIDE_M, DEFAULT_PIXELS = 105.0, 768
_REQUEST = "tiles.json"
# A row's place in a tile of before.
_REPLACED = ("tile", "tile_lat", "tile_lon", "metres_per_pixel", "u", "v")


@dataclass(frozen=True)
class CutTiles:
    """Tiles that were cut.

    Attributes
    ----------
    table : Path
        The new table: the rows of the old one, each with its tile.
    rows, tiles, padded : int
        How many rows it has, how many tiles there are, and how many of them reach over the map's
        edge.
    left_out : list of dict
        ``row`` and ``error`` of each row that has no tile.
    """

    table: Path
    rows: int
    tiles: int
    padded: int
    left_out: list[dict[str, str]] = field(default_factory=list)

    def summary(self) -> dict[str, Any]:
        """The same as plain values, for JSON."""
        return {**self.__dict__, "table": str(self.table)}

    def __str__(self) -> str:
        return self.report()

    def report(self, most: int = 10) -> str:
        """The same as a few lines of text."""
        lines = [f"{self.rows:,} photographs in {self.tiles:,} tiles: {self.table}"]
        if self.padded:
            lines.append(f"{self.padded:,} tiles reach over the map's edge, and were padded")
        lines += [f"left out: {one['row']}: {one['error']}" for one in self.left_out[:most]]
        if len(self.left_out) > most:
            lines.append(f"and {len(self.left_out) - most:,} more")
        return "\n".join(lines)


def cut_tiles(
    table: str | Path,
    aerial_map: str | Path,
    out: str | Path,
    *,
    map_crs: str | None = None,
    side_m: float = DEFAULT_SIDE_M,
    pixels: int = DEFAULT_PIXELS,
    shared_m: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> CutTiles:
    """Cut the tile of each row of a table from a map, and write a table that names them.

    Stopped and repeated, it keeps the tiles that are there.

    Parameters
    ----------
    table : path
        Of photographs (`slicematch.data.photographs.read_photographs`), with their places or EXIF
        data that hold them.
    aerial_map : path
        A georeferenced raster (`slicematch.data.maps.AerialMap.open`).
    out : path
        A folder, for ``photos.csv`` and ``tiles/``.
    map_crs : str, optional
        The map's coordinate system, where its file does not say.
    side_m : float
        Side of the tiles on the ground. Training cuts its own, smaller ones out of them, so that
        cameras stand anywhere in these.
    pixels : int
        Their side in pixels.
    shared_m : float, optional
        Photographs share tiles on a lattice of so many metres; a sixteenth of the side by default.
    progress : callable, optional
        Called with (rows done, rows in all).

    Returns
    -------
    CutTiles

    Raises
    ------
    DatasetError
        If the table is invalid, or no row has a tile.
    MapError, ConfigError
        If the map is unusable, or a number out of its range.
    OutputError
        If a file cannot be written, or the folder holds other tiles.
    """
    photographs = read_photographs(table)
    opened = AerialMap.open(aerial_map, map_crs)
    step_m = lattice_step(side_m, shared_m)
    folder = check_folder(out, OutputError)
    _begin(
        folder,
        {"map": opened.path, "crs": opened.crs, "side_m": side_m, "pixels": pixels, "step": step_m},
    )
    rows: dict[int, dict[str, Any]] = {}
    padded: dict[str, bool] = {}
    left_out = []
    for row in range(len(photographs)):
        try:
            lat, lon = _place(photographs, row)
            centre = lattice_point(lat, lon, step_m)
            try:
                name = _cut(opened, centre, side_m, pixels, folder, padded)
            except PlaceError:  # on the map's edge a tile of its own may show more
                centre = lat, lon
                name = _cut(opened, centre, side_m, pixels, folder, padded)
        except (SampleError, ConfigError) as error:
            left_out.append({"row": photographs.file.where(row), "error": str(error)})
        else:
            rows[row] = {
                "lat": lat,
                "lon": lon,
                "tile": name,
                "tile_lat": centre[0],
                "tile_lon": centre[1],
                "metres_per_pixel": side_m / pixels,
            }
        if progress is not None:
            progress(row + 1, len(photographs))
    if not rows:
        raise DatasetError(
            f"{table}: none of its rows has a tile in the map; first: {left_out[0]['error']}"
        )
    path = folder / "photos.csv"
    write_table(path, _columns(photographs, rows, folder))
    return CutTiles(path, len(rows), len(padded), sum(padded.values()), left_out)


def _begin(folder: Path, request: dict[str, Any]) -> None:
    """Make the folder, or see that the tiles in it are of the same kind."""
    text = json.dumps(request, indent=1) + "\n"
    file = folder / _REQUEST
    if file.is_file() and file.read_text() != text:
        raise OutputError(
            f"{folder}: holds tiles that were cut otherwise ({_REQUEST}); name another folder"
        )
    if not file.is_file() and folder.is_dir() and any(folder.iterdir()):
        raise OutputError(f"{folder}: is not empty and holds no tiles; name another folder")
    (folder / "tiles").mkdir(parents=True, exist_ok=True)
    write_text(file, text, OutputError)


def _place(photographs: Photographs, row: int) -> tuple[float, float]:
    lat, lon = photographs.number("lat", row), photographs.number("lon", row)
    if lat is not None and lon is not None:
        return lat, lon
    fix = read_fix(photographs.ground[row])
    return fix.lat, fix.lon


def _cut(
    aerial_map: AerialMap,
    centre: tuple[float, float],
    side_m: float,
    pixels: int,
    folder: Path,
    padded: dict[str, bool],
) -> str:
    """Cut a tile, unless it is there; its name, noted with whether it was padded."""
    name = f"tiles/{centre[0]:.7f}_{centre[1]:.7f}.png"
    if name in padded:
        return name
    if (folder / name).is_file():  # from before; its edge is not looked at again
        padded[name] = False
        return name
    tile = aerial_map.cut(*centre, side_m, pixels)
    with atomic_write(folder / name, OutputError) as partial:
        Image.fromarray(tile.image).save(partial, format="PNG")
    padded[name] = tile.padded > 0
    return name


def _columns(
    photographs: Photographs, rows: dict[int, dict[str, Any]], folder: Path
) -> dict[str, list[Any]]:
    """The old table's columns for the rows that have a tile, and those of their tiles."""
    kept = photographs.file.columns
    columns = {name: [kept[name][row] for row in rows] for name in kept if name not in _REPLACED}
    columns["ground"] = [os.path.relpath(photographs.ground[row], folder) for row in rows]
    for name in ("lat", "lon", *_REPLACED[:4]):
        columns[name] = [content[name] for content in rows.values()]
    return columns
