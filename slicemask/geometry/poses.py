"""Candidate poses: regular grids, and lists read from files."""

import csv
import itertools
import logging
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slicemask.errors import PoseError, SpecError
from slicemask.geometry.numbers import is_real, is_whole

Places = Literal["centres", "endpoints"]
COLUMNS = ("u", "v", "heading_deg")

log = logging.getLogger(__name__)

_SEPARATORS = ",;\t"
_NOT_NUMBERS = "poses must be real numbers in an array [K, 3] of u, v, heading_deg"
# Of headings that were rounded to a few digits, too.
_LARGEST_RADIANS = 2 * np.pi + 1e-3


@dataclass(frozen=True)
class PoseGrid:
    """A regular grid of poses: rows of v, columns of u, and headings.

    Pose k = (row * columns + column) * headings + heading.

    Parameters
    ----------
    rows, columns, headings : int
        At least 1 each. Heading h is h * 360 / headings degrees.
    extent : (u0, v0, u1, v1)
        The part of the aerial frame that the places fill; the whole tile by default.
    places : {"centres", "endpoints"}
        Where places lie in the extent: at the centres of rows x columns equal parts, or spread
        from end to end (a single row or column then lies in the middle).

    Raises
    ------
    SpecError
        If a value is out of its range.

    Examples
    --------
    >>> grid = PoseGrid.parse("2x2x4")
    >>> len(grid)
    16
    >>> grid.poses()[5].tolist()
    [0.75, 0.25, 90.0]
    """

    rows: int
    columns: int
    headings: int
    extent: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)
    places: Places = "centres"

    def __post_init__(self) -> None:
        for name in ("rows", "columns", "headings"):
            value = getattr(self, name)
            if not is_whole(value) or value < 1:
                raise SpecError(
                    f"the grid's {name} is {value!r}; it must be a whole number of at least 1"
                )
            object.__setattr__(self, name, int(value))
        edges = tuple(self.extent) if isinstance(self.extent, list | tuple) else ()
        if len(edges) != 4 or not all(is_real(edge) for edge in edges):
            raise SpecError(f"extent is {self.extent!r}; it must be four numbers u0, v0, u1, v1")
        object.__setattr__(self, "extent", tuple(map(float, edges)))
        u0, v0, u1, v1 = self.extent
        if not (0.0 <= u0 < u1 <= 1.0 and 0.0 <= v0 < v1 <= 1.0):
            raise SpecError(
                f"extent is {u0:g},{v0:g},{u1:g},{v1:g}; it must be u0,v0,u1,v1 with "
                "0 <= u0 < u1 <= 1 and 0 <= v0 < v1 <= 1"
            )
        if self.places not in get_args(Places):
            raise SpecError(
                f"places is {self.places!r}; it must be one of {', '.join(get_args(Places))}"
            )

    @classmethod
    def parse(
        cls,
        text: str,
        extent: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0),
        places: Places = "centres",
    ) -> "PoseGrid":
        """Read a grid from text such as ``21x21x64``: rows x columns x headings.

        Raises
        ------
        SpecError
            If the text is anything else.
        """
        match = re.fullmatch(r"([0-9]{1,9})x([0-9]{1,9})x([0-9]{1,9})", text.strip().lower())
        if match is None:
            raise SpecError(
                f"grid is {text!r}; it must be ROWSxCOLUMNSxHEADINGS, three whole numbers of at "
                "least 1, such as 21x21x64"
            )
        rows, columns, headings = (int(part) for part in match.groups())
        return cls(rows, columns, headings, extent=extent, places=places)

    def __str__(self) -> str:
        return f"{self.rows}x{self.columns}x{self.headings}"

    def __len__(self) -> int:
        return self.rows * self.columns * self.headings

    @property
    def shape(self) -> tuple[int, int, int]:
        """(rows, columns, headings): how scores of the K poses reshape."""
        return self.rows, self.columns, self.headings

    @property
    def u(self) -> NDArray[np.float64]:
        """Places' u of the columns, float64 [columns]."""
        return self._along(self.extent[0], self.extent[2], self.columns)

    @property
    def v(self) -> NDArray[np.float64]:
        """Places' v of the rows, float64 [rows]."""
        return self._along(self.extent[1], self.extent[3], self.rows)

    @property
    def headings_deg(self) -> NDArray[np.float64]:
        """Headings in degrees, float64 [headings]."""
        return np.arange(self.headings) * 360.0 / self.headings

    def _along(self, start: float, stop: float, count: int) -> NDArray[np.float64]:
        if self.places == "endpoints" and count > 1:
            return np.linspace(start, stop, count)
        return start + (np.arange(count) + 0.5) / count * (stop - start)

    def poses(self, start: int = 0, stop: int | None = None) -> NDArray[np.float64]:
        """Poses start..stop of the grid (all by default): float64 [K, 3] of u, v, heading_deg."""
        k = np.arange(max(start, 0), len(self) if stop is None else min(stop, len(self)))
        place, heading = np.divmod(k, self.headings)
        row, column = np.divmod(place, self.columns)
        return np.stack([self.u[column], self.v[row], self.headings_deg[heading]], axis=1)

    def index(self, row: int, column: int, heading: int) -> int:
        """Pose index k of a row, column and heading.

        Raises
        ------
        PoseError
            If one of them is not in the grid.
        """
        asked = (row, column, heading)
        within = (is_whole(at) and at < size for at, size in zip(asked, self.shape, strict=True))
        if not all(within) or min(asked) < 0:
            raise PoseError(
                f"pose {row},{column},{heading} is not in the grid {self}; row, column and "
                f"heading count from 0 to {self.rows - 1}, {self.columns - 1} and "
                f"{self.headings - 1}"
            )
        return (row * self.columns + column) * self.headings + heading


def check_poses(poses: ArrayLike, names: Iterator[str] | None = None) -> NDArray[np.float64]:
    """Return poses as float64 [K, 3], headings wrapped to [0, 360).

    Parameters
    ----------
    poses : array [K, 3]
        u, v in [0, 1] of the aerial frame and heading_deg, any finite angle.
    names : iterator of str, optional
        What to call each pose in an error ("line 7"); "pose k" by default.

    Raises
    ------
    PoseError
        If the shape is another, a value is not finite, or a place lies outside the tile; the
        message names the first such pose.
    """
    try:
        array = np.array(poses)
    except (TypeError, ValueError) as error:  # rows of unequal length
        raise PoseError(_NOT_NUMBERS) from error
    if array.dtype.kind not in "iuf":  # dates, text and booleans would convert
        raise PoseError(f"{_NOT_NUMBERS}; they are of type {array.dtype}")
    array = array.astype(np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise PoseError(
            f"poses have shape {list(array.shape)}; they must be [K, 3]: u, v, heading_deg"
        )
    if len(array) == 0:
        raise PoseError("there are no poses; at least one is needed")
    finite = np.asarray(np.isfinite(array).all(axis=1))
    inside = finite & ((array[:, :2] >= 0.0) & (array[:, :2] <= 1.0)).all(axis=1)
    if not inside.all():
        k = int(np.argmin(inside))
        name = f"pose {k}" if names is None else next(itertools.islice(names, k, None))
        u, v, heading = array[k]
        fault = "lies outside the tile" if finite[k] else "is not finite"
        raise PoseError(
            f"{name} {fault}: u={u:g}, v={v:g}, heading_deg={heading:g}; u and v must lie in "
            "[0, 1] and the heading must be a finite angle in degrees"
        )
    array[:, 2] %= 360.0
    array[array[:, 2] == 360.0, 2] = 0.0  # a tiny negative heading wraps to 360 itself
    return array


def read_poses(path: str | Path) -> NDArray[np.float64]:
    """Read candidate poses from a file.

    Where all headings lie within 0 and 2 pi, as radians do, a warning is logged.

    Parameters
    ----------
    path : path
        ``.npy``: an array of numbers [K, 3] of u, v, heading_deg. Anything else: text, UTF-8, with
        a header that names the columns u, v and heading_deg in any order and case, separated by
        commas, semicolons or tabs. Further columns and blank lines are skipped.

    Returns
    -------
    poses : float64 [K, 3]
        u, v in [0, 1] of the aerial frame and heading_deg in [0, 360).

    Raises
    ------
    PoseError
        If the file cannot be read as poses; the message names the file and the line.
    """
    path = Path(path)
    try:
        poses, names = _read_npy(path) if path.suffix.lower() == ".npy" else _read_text(path)
    except FileNotFoundError:
        raise PoseError(f"{path}: there is no such file; name a .csv or .npy file") from None
    except OSError as error:
        raise PoseError(f"{path}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError:
        raise PoseError(f"{path}: is neither CSV text in UTF-8 nor a .npy file") from None
    try:
        checked = check_poses(poses, names)
    except PoseError as error:
        raise PoseError(f"{path}: {error}") from None
    if look_like_radians(poses[:, 2]):
        log.warning(
            "%s: all headings lie within 0 and 2 pi, as if they were in radians; they are read as "
            "degrees",
            path,
        )
    return checked


def look_like_radians(headings: NDArray[Any]) -> bool:
    """Whether several headings all lie within 0 and 2 pi, and are not whole degrees."""
    return bool(
        ((headings >= 0) & (headings <= _LARGEST_RADIANS)).all()
        and (headings != headings[0]).any()
        and (headings % 1 != 0).any()
    )


def _read_npy(path: Path) -> tuple[NDArray[Any], Iterator[str]]:
    """An array of any kind, and its rows' names."""
    try:
        with path.open("rb") as file:
            array = np.lib.format.read_array(file, allow_pickle=False)
    except OSError:
        raise
    except Exception as error:  # a damaged header makes NumPy's parsers raise all sorts
        raise PoseError(f"{path}: is not a plain .npy array of numbers, or is truncated") from error
    return array, map("row {}".format, itertools.count())


def _read_text(path: Path) -> tuple[NDArray[np.float64], Iterator[str]]:
    """The poses of a table, and their lines' names."""
    rows: list[list[float]] = []
    lines: list[int] = []
    with path.open(newline="", encoding="utf-8-sig") as file:
        numbered = enumerate(file, start=1)
        first, top = next(((number, line) for number, line in numbered if line.strip()), (1, ""))
        separator = max(_SEPARATORS, key=lambda sign: (_columns_named(top, sign), top.count(sign)))
        reader = csv.reader(itertools.chain([top], file), delimiter=separator)
        try:
            header = [name.strip().lower() for name in next(reader, [])]
            missing = [name for name in COLUMNS if name not in header]
            if missing or len(set(filter(None, header))) < len(list(filter(None, header))):
                fault = f"{', '.join(missing)} missing" if missing else "a column named twice"
                raise PoseError(
                    f"{path}: line {first}: {fault}; the header must name the columns "
                    f"{', '.join(COLUMNS)}, separated by commas, semicolons or tabs, and it reads "
                    f"{top.strip()!r}"
                )
            columns = [header.index(name) for name in COLUMNS]
            for row in reader:
                if not any(field.strip() for field in row):
                    continue
                line = first - 1 + reader.line_num
                try:
                    rows.append([_number(row[column]) for column in columns])
                except (ValueError, IndexError):
                    raise PoseError(
                        f"{path}: line {line}: {separator.join(row)!r} does not give three "
                        "numbers u, v, heading_deg, such as 0.5"
                    ) from None
                lines.append(line)
        except csv.Error as error:
            raise PoseError(f"{path}: line {first - 1 + reader.line_num}: {error}") from None
    return np.array(rows).reshape(-1, 3), (f"line {line}" for line in lines)


def _columns_named(header: str, separator: str) -> int:
    """How many of the columns a header names if its fields are separated by a sign."""
    names = {name.strip(' "\r\n').lower() for name in header.split(separator)}
    return len(names.intersection(COLUMNS))


def _number(text: str) -> float:
    """A number as files write it: `float` also takes 1_0 and digits of other scripts."""
    if "_" in text or not text.isascii():
        raise ValueError(text)
    return float(text)
