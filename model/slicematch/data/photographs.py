"""A table of photographs: what its columns mean, checked cell by cell."""

import difflib
import logging
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slicemask.geometry.poses import look_like_radians
from slicematch.data.errors import DatasetError
from slicematch.data.table_files import TableFile, read_table
from slicematch.data.text import parse_number

log = logging.getLogger(__name__)

Floats = NDArray[np.float64]
# Columns of numbers: the least and greatest value, and what is expected.
_NUMBERS: dict[str, tuple[float, float, str]] = {
    "u": (0.0, 1.0, "a number from 0 (the tile's west edge) to 1"),
    "v": (0.0, 1.0, "a number from 0 (the tile's north edge) to 1"),
    "heading_deg": (-math.inf, math.inf, "degrees clockwise from north"),
    "pitch_deg": (-90.0, 90.0, "degrees from -90 to 90, positive where the camera looks up"),
    "roll_deg": (-180.0, 180.0, "degrees from -180 to 180"),
    "accuracy_m": (0.0, math.inf, "metres of at least 0"),
    "lat": (-90.0, 90.0, "a latitude from -90 to 90 degrees"),
    "lon": (-180.0, 180.0, "a longitude from -180 to 180 degrees"),
    "tile_lat": (-90.0, 90.0, "a latitude from -90 to 90 degrees"),
    "tile_lon": (-180.0, 180.0, "a longitude from -180 to 180 degrees"),
    "metres_per_pixel": (1e-4, 1e3, "metres from 0.0001 to 1000"),
}
_TEXTS = ("id", "ground", "tile", "camera", "split")
COLUMNS = (*_TEXTS, *_NUMBERS)
# What a table of frames has besides, for `slicematch.tracking`.
DRIVE_COLUMNS = (
    "time_s", "speed_mps", "yaw_rate_dps", "gnss_lat", "gnss_lon", "gnss_accuracy_m",
)  # fmt: skip
PARTS = ("train", "validation", "test")
# What other tables call these columns.
_MEANT = {
    **{"image": "ground", "photo": "ground", "file": "ground", "filename": "ground"},
    **{"aerial": "tile", "satellite": "tile", "latitude": "lat", "longitude": "lon", "lng": "lon"},
    **{"heading": "heading_deg", "yaw": "heading_deg", "azimuth": "heading_deg"},
    **{"pitch": "pitch_deg", "roll": "roll_deg", "accuracy": "accuracy_m"},
}


@dataclass(frozen=True)
class Photographs:
    """Photographs with what a table says of them, n rows.

    Attributes
    ----------
    file : TableFile
        Where they come from.
    ids : list of str
        Their own column, or else the name of the file; only the former differ from each other.
    ground : list of str
        Paths of the images: as in the table if absolute, or else within its folder.
    tile : list of str or None
        Paths of aerial tiles, likewise; None where there is none.
    camera : list of str or None
        Names of cameras; None where there is none.
    split : list of str or None
        "train", "validation" or "test", for each row; None without such a column.
    numbers : dict of str to float64 [n]
        ``u, v``, ``heading_deg``, ``pitch_deg``, ``roll_deg``, ``accuracy_m``, ``lat, lon``,
        ``tile_lat, tile_lon`` and ``metres_per_pixel``; NaN where a cell is empty. Headings are in
        [0, 360), clockwise from north.
    """

    file: TableFile
    ids: list[str]
    ground: list[str]
    tile: list[str | None]
    camera: list[str | None]
    split: list[str] | None
    numbers: dict[str, Floats]

    def __len__(self) -> int:
        return len(self.ground)

    def number(self, column: str, row: int) -> float | None:
        """The number in a cell; None if it is empty."""
        value = float(self.numbers[column][row])
        return None if math.isnan(value) else value

    def part(self, name: str) -> NDArray[np.intp]:
        """The rows of a part, int [m]; all of them without a column ``split``."""
        if self.split is None:
            return np.arange(len(self))
        return np.flatnonzero(np.array(self.split) == name)

    def has(self, *columns: str) -> NDArray[np.bool]:
        """Which rows fill all of these columns of numbers, bool [n]."""
        filled = [~np.isnan(self.numbers[column]) for column in columns]
        return np.logical_and.reduce(filled)

    def wrong(self, row: int, column: str, expected: str) -> DatasetError:
        """The error of a cell: its row, its column, what it holds and what was expected."""
        return wrong_cell(self.file, row, column, expected)


def wrong_cell(file: TableFile, row: int, column: str, expected: str) -> DatasetError:
    """The error of a cell: its row, its column, what it holds and what was expected."""
    cell = file.columns[column][row] if column in file.columns else None
    found = "empty" if _is_empty(cell) else repr(cell)
    return DatasetError(f"{file.where(row)}: {column} is {found}; expected {expected}")


def read_photographs(path: str | Path) -> Photographs:
    """Read a table of photographs.

    Parameters
    ----------
    path : path
        A CSV, Parquet or GeoJSON file (`slicematch.data.table_files.read_table`), or the folder of
        one. It has a row for each photograph and a column ``ground``; the others, as in
        `Photographs`, are optional here. Columns of other names are not read.

    Returns
    -------
    Photographs

    Raises
    ------
    DatasetError
        If it is no such table, or a cell is invalid: the text names its row and column.
    """
    file = read_table(path)
    if "ground" not in file.columns:
        raise DatasetError(
            f"{file.path}: has no column ground, the photographs' files; its columns are "
            f"{', '.join(file.columns) or 'none'}"
        )
    _warn_of_names(file)
    ground = _texts(file, "ground")
    for row, name in enumerate(ground):
        if name is None:
            raise wrong_cell(file, row, "ground", "the photograph's file")
    numbers = {column: _numbers(file, column) for column in _NUMBERS}
    headings = numbers["heading_deg"]
    known = headings[~np.isnan(headings)]
    if len(known) and look_like_radians(known):
        log.warning(
            "%s: all heading_deg lie within 0 and 2 pi, as if they were in radians; they are read "
            "as degrees",
            file.path,
        )
    numbers["heading_deg"] = headings % 360.0 % 360.0  # a tiny negative one wraps to 360 itself
    named = [str(name) for name in ground]
    return Photographs(
        file,
        _ids(file, named),
        [_beside(file, name) for name in named],
        [None if name is None else _beside(file, name) for name in _texts(file, "tile")],
        _texts(file, "camera"),
        _split(file),
        numbers,
    )


def _beside(file: TableFile, name: str) -> str:
    return str(file.path.parent / name)


def _is_empty(cell: Any) -> bool:
    return cell is None or cell == "" or (isinstance(cell, float) and math.isnan(cell))


def _texts(file: TableFile, column: str) -> list[str | None]:
    cells = file.columns.get(column)
    if cells is None:
        return [None] * len(file)
    return [None if _is_empty(cell) else str(cell) for cell in cells]


def _numbers(file: TableFile, column: str) -> Floats:
    """A column of numbers, float64 [n]; NaN where a cell is empty."""
    cells = file.columns.get(column)
    if cells is None:
        return np.full(len(file), math.nan)
    least, greatest, expected = _NUMBERS[column]
    values = np.empty(len(file))
    for row, cell in enumerate(cells):
        if _is_empty(cell):
            values[row] = math.nan
            continue
        number = parse_number(str(cell)) if not isinstance(cell, bool) else None
        if number is None or not least <= number <= greatest:
            raise wrong_cell(file, row, column, expected + _hint_of_swap(file, row, column))
        values[row] = number
    return values


def _hint_of_swap(file: TableFile, row: int, column: str) -> str:
    """What to add where a latitude is none and its longitude could be one."""
    if not column.endswith("lat"):
        return ""
    other = file.columns.get(column.removesuffix("lat") + "lon", [None] * len(file))[row]
    lat, lon = parse_number(str(file.columns[column][row])), parse_number(str(other))
    if lat is None or lon is None or abs(lat) > 180 or abs(lon) > 90:
        return ""
    return f"; its longitude is {lon:g}, so the two are swapped: exchange the columns"


def _ids(file: TableFile, ground: list[str]) -> list[str]:
    if "id" not in file.columns:
        return ground
    first: dict[str, int] = {}
    for row, name in enumerate(_texts(file, "id")):
        if name is None:
            raise wrong_cell(file, row, "id", "a name, as the table has such a column")
        if name in first:
            other = f"{file.row_word} {file.numbers[first[name]]}"
            raise wrong_cell(file, row, "id", f"a name of its own, and {other} has the same")
        first[name] = row
    return list(first)


def _split(file: TableFile) -> list[str] | None:
    if "split" not in file.columns:
        return None
    parts = _texts(file, "split")
    for row, part in enumerate(parts):
        if part not in PARTS:
            raise wrong_cell(file, row, "split", f"one of {', '.join(PARTS)}")
    return [str(part) for part in parts]


def _warn_of_names(file: TableFile) -> None:
    """Warn of columns that are not read and almost surely meant to be."""
    for name in file.columns:
        if name in COLUMNS or name in DRIVE_COLUMNS:
            continue
        meant = [_MEANT[name]] if name in _MEANT else difflib.get_close_matches(name, COLUMNS, 1)
        if meant and meant[0] not in file.columns:
            log.warning(
                "%s: has a column %r, which is not read; if it holds %s, call it so",
                file.path,
                name,
                meant[0],
            )
