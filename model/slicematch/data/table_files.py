"""Table files: CSV, Parquet and GeoJSON as columns of plain values, and back."""

import csv
import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slicemask.errors import is_out_of_resources
from slicemask.files import atomic_write, check_target
from slicematch.data.errors import DatasetError

SUFFIXES = (".csv", ".parquet", ".geojson")
# Of a folder that holds several tables, the one of this name is meant.
STEM = "photos"
_SEPARATORS = (",", ";", "\t")
# Of GeoParquet's metadata: its default, and what means the same.
_WGS84 = (("OGC", "CRS84"), ("EPSG", "4326"))


@dataclass(frozen=True)
class TableFile:
    """A table as it stands in a file.

    Attributes
    ----------
    path : Path
        The file.
    columns : dict of str to list
        Values of the n rows by column: text as CSV has it, or numbers and text as Parquet and
        GeoJSON have them; None where a cell is empty. Points are columns ``lat`` and ``lon``.
    numbers : sequence of int
        What each row is called: its line in a CSV file, counted from 1, or else its number.
    """

    path: Path
    columns: dict[str, list[Any]]
    numbers: Sequence[int]

    def __len__(self) -> int:
        return len(self.numbers)

    def where(self, row: int) -> str:
        """What to call a row in a message, such as "photos.csv, line 7"."""
        return f"{self.path}, {self.row_word} {self.numbers[row]}"

    @property
    def row_word(self) -> str:
        """What a number of `numbers` counts: lines or rows."""
        return "line" if self.path.suffix.lower() == ".csv" else "row"


def find_table(path: str | Path) -> Path:
    """The table that a file or folder names.

    Parameters
    ----------
    path : path
        A file, or a folder that holds one table, or one called ``photos``.

    Raises
    ------
    DatasetError
        If there is none, or it is not clear which is meant.
    """
    path = Path(path)
    if not path.exists():
        raise DatasetError(
            f"{path}: there is no such file or folder; name a table ({', '.join(SUFFIXES)}) or "
            "the folder of one"
        )
    if not path.is_dir():
        if path.suffix.lower() not in SUFFIXES:
            raise DatasetError(
                f"{path}: its suffix is {path.suffix or 'missing'}; a table of photographs is one "
                f"of {', '.join(SUFFIXES)}"
            )
        return path
    found = sorted(file for file in path.iterdir() if file.suffix.lower() in SUFFIXES)
    named = [file for file in found if file.stem == STEM]
    if len(found) == 1 or len(named) == 1:
        return (named or found)[0]
    if not found:
        raise DatasetError(
            f"{path}: holds no table of photographs; name a file, or put {STEM}.csv there "
            "(slicemask table writes one)"
        )
    names = ", ".join(file.name for file in named or found)
    raise DatasetError(f"{path}: holds several tables ({names}); name the file that is meant")


def read_table(path: str | Path) -> TableFile:
    """Read a table's cells as they are.

    Parameters
    ----------
    path : path
        ``.csv`` in UTF-8, with a header, separated by commas, semicolons or tabs; ``.parquet``
        (GeoParquet's points too; needs pyarrow); or ``.geojson``, a collection of features whose
        properties are columns. Names of columns are taken in lower case.

    Raises
    ------
    DatasetError
        If it is missing, unreadable, or no such table.
    """
    path = find_table(path)
    read = {".csv": _read_csv, ".parquet": _read_parquet, ".geojson": _read_geojson}
    try:
        table = read[path.suffix.lower()](path)
    except UnicodeDecodeError as error:
        raise DatasetError(f"{path}: is not text in UTF-8; save it as UTF-8") from error
    except OSError as error:
        if is_out_of_resources(error):
            raise
        raise DatasetError(f"{path}: is not readable ({error.strerror or error})") from error
    if not len(table):
        raise DatasetError(f"{path}: holds no row; expected one for each photograph")
    return table


def write_table(path: str | Path, columns: Mapping[str, Sequence[Any]]) -> None:
    """Write a table, whole or not at all.

    Parameters
    ----------
    path : path
        ``.csv``, ``.parquet`` (needs pyarrow) or ``.geojson`` (whose points are ``lat`` and
        ``lon``).
    columns : mapping of str to sequence
        Values of the rows by column; None leaves a cell empty.

    Raises
    ------
    DatasetError
        If it cannot be written.
    """
    path = check_target(path, SUFFIXES, DatasetError)
    with atomic_write(path, DatasetError) as partial:
        if path.suffix.lower() == ".parquet":
            pyarrow = _pyarrow(path)
            pyarrow.parquet.write_table(pyarrow.table(dict(columns)), partial)
        elif path.suffix.lower() == ".geojson":
            partial.write_text(_geojson(columns), encoding="utf-8")
        else:
            with partial.open("w", encoding="utf-8", newline="") as file:
                writer = csv.writer(file, lineterminator="\n")
                writer.writerow(columns)
                writer.writerows(zip(*columns.values(), strict=True))


def _read_csv(path: Path) -> TableFile:
    with path.open(newline="", encoding="utf-8-sig") as file:
        numbered = enumerate(file, start=1)
        first, top = next(((number, line) for number, line in numbered if line.strip()), (1, ""))
        reader = csv.reader(
            itertools.chain([top], file), delimiter=max(_SEPARATORS, key=top.count), strict=True
        )
        numbers: list[int] = []
        rows: list[list[str]] = []
        try:
            names = _names(path, next(reader, []))
            for row in reader:
                if not any(field.strip() for field in row):
                    continue
                number = first - 1 + reader.line_num
                if len(row) != len(names):
                    raise DatasetError(
                        f"{path}, line {number}: has {len(row)} fields; expected {len(names)}, as "
                        "in the header (quote those that hold the separator)"
                    )
                numbers.append(number)
                rows.append(row)
        except csv.Error as error:
            raise DatasetError(f"{path}, line {first - 1 + reader.line_num}: {error}") from None
    cells = zip(*rows, strict=True) if rows else ([] for _ in names)
    columns = {
        name: [cell.strip() or None for cell in column]
        for name, column in zip(names, cells, strict=True)
    }
    return TableFile(path, columns, numbers)


def _read_parquet(path: Path) -> TableFile:
    pyarrow = _pyarrow(path)
    try:
        table = pyarrow.parquet.read_table(path)
    except pyarrow.ArrowInvalid as error:
        raise DatasetError(f"{path}: is unreadable as Parquet ({error})") from error
    columns = dict(zip(_names(path, table.column_names), table.to_pydict().values(), strict=True))
    metadata = (table.schema.metadata or {}).get(b"geo")
    if metadata is not None:
        geo = json.loads(metadata)
        points = columns.pop(geo["primary_column"].lower())
        columns = {**_points(path, geo, points), **columns}
    return TableFile(path, columns, range(1, len(table) + 1))


def _points(path: Path, geo: Any, cells: list[bytes | None]) -> dict[str, list[Any]]:
    """The points of a GeoParquet file as columns of lat and lon."""
    import shapely

    crs = geo["columns"][geo["primary_column"]].get("crs", {"id": {"authority": "OGC"}})
    identity = (crs or {}).get("id", {})
    if (identity.get("authority"), str(identity.get("code", "CRS84"))) not in _WGS84:
        raise DatasetError(
            f"{path}: its points are in {(crs or {}).get('name', 'an unknown coordinate system')}; "
            "expected latitude and longitude (EPSG:4326): convert it, or name columns lat and lon"
        )
    points = [None if cell is None else shapely.from_wkb(cell) for cell in cells]
    places = [
        (point.y, point.x) if point is not None and point.geom_type == "Point" else (None, None)
        for point in points
    ]
    return {"lat": [lat for lat, _ in places], "lon": [lon for _, lon in places]}


def _read_geojson(path: Path) -> TableFile:
    try:
        content = json.loads(path.read_text(encoding="utf-8-sig"))
        features = content["features"]
        rows = [dict(feature["properties"] or {}) for feature in features]
        geometries = [feature.get("geometry") or {} for feature in features]
    except UnicodeDecodeError:
        raise
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise DatasetError(
            f"{path}: is no GeoJSON collection of features with properties ({error!r})"
        ) from error
    for row, geometry in zip(rows, geometries, strict=True):
        if geometry.get("type") == "Point":
            lon, lat, *_ = geometry["coordinates"]
            row.setdefault("lat", lat)
            row.setdefault("lon", lon)
    keys = list(dict.fromkeys(key for row in rows for key in row))
    columns = {
        name: [row.get(key) for row in rows]
        for name, key in zip(_names(path, keys), keys, strict=True)
    }
    return TableFile(path, columns, range(1, len(rows) + 1))


def _geojson(columns: Mapping[str, Sequence[Any]]) -> str:
    features = []
    for cells in zip(*columns.values(), strict=True):
        row = dict(zip(columns, cells, strict=True))
        lat, lon = row.pop("lat", None), row.pop("lon", None)
        point = None if lat is None else {"type": "Point", "coordinates": [lon, lat]}
        features.append({"type": "Feature", "geometry": point, "properties": row})
    return json.dumps({"type": "FeatureCollection", "features": features}, indent=1) + "\n"


def _names(path: Path, header: Sequence[str]) -> list[str]:
    """The columns' names in lower case, each of them once."""
    names = [name.strip().lower() for name in header]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise DatasetError(f"{path}: names the column {twice[0]!r} twice; rename one of them")
    return names


def _pyarrow(path: Path) -> Any:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise DatasetError(
            f"{path}: Parquet needs pyarrow, which cannot be imported ({error}); install: "
            "pip install 'slicemask[maps]', or save the table as CSV"
        ) from error
    return pyarrow
