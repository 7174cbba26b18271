"""Work in parts, each kept as it is done: what is stopped goes on, and may be done by many.

A part is a Parquet file in a folder, written whole or not at all. Beside the parts lies what was
asked for, so that no other request is mixed with them.
"""

import hashlib
import json
import logging
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from slicemask.errors import OutputError
from slicemask.files import atomic_write, check_folder, write_text
from slicematch.errors import RunError

log = logging.getLogger(__name__)

Progress = Callable[[int, int], None]
Row = dict[str, Any]

_REQUEST = "request.json"
# Parts are no larger, so that a process that ends costs little, nor are they fewer, so that many
# processes have something to do.
_MOST_ROWS, _FEWEST_PARTS = 64, 64


class Work(Protocol):
    """What is done to the items of a part, with equal results wherever that is; can be pickled."""

    @property
    def columns(self) -> Mapping[str, str]:
        """Column to type of its rows, by pyarrow's names, such as "int64" or "string"."""
        ...

    def __call__(self, items: Sequence[Any]) -> list[Row]:
        """Rows of a part, from its items."""
        ...


class Parts:
    """The parts of one request, in a folder of their own.

    Parameters
    ----------
    folder : path
        New, or that of the same request, which was stopped.
    request : mapping
        What was asked for, of plain values.
    afresh : bool
        Remove the parts of another request, in place of refusing them.

    Raises
    ------
    RunError
        If the folder holds parts of another request.
    OutputError
        If it cannot be made.
    """

    def __init__(
        self, folder: str | Path, request: Mapping[str, Any], afresh: bool = False
    ) -> None:
        self.folder = check_folder(folder, OutputError)
        text = json.dumps(request, indent=1, sort_keys=True, default=str) + "\n"
        file = self.folder / _REQUEST
        if file.is_file() and afresh and file.read_text() != text:
            self.remove()
        if file.is_file():
            _check_same(self.folder, json.loads(file.read_text()), json.loads(text))
        elif self.folder.is_dir() and any(self.folder.iterdir()):
            raise RunError(
                f"{self.folder}: is where parts of the work would be kept, and holds something "
                "else; move it away, or name another file for the results"
            )
        else:
            self.folder.mkdir(parents=True, exist_ok=True)
            write_text(file, text, OutputError)

    def path(self, number: int) -> Path:
        """The file of a part."""
        return self.folder / f"part-{number:06d}.parquet"

    def has(self, number: int) -> bool:
        """Whether a part is done."""
        return self.path(number).is_file()

    def write(self, number: int, rows: Sequence[Row], columns: Mapping[str, str]) -> None:
        """Keep the rows of a part, whole or not at all."""
        pyarrow = import_pyarrow()
        schema = pyarrow.schema(
            [(name, pyarrow.type_for_alias(kind)) for name, kind in columns.items()]
        )
        table = pyarrow.Table.from_pylist(list(rows), schema)
        with atomic_write(self.path(number), OutputError) as partial:
            pyarrow.parquet.write_table(table, partial)

    def read(self, count: int) -> Any:
        """The rows of all parts as a pyarrow Table, in the order of the parts."""
        pyarrow = import_pyarrow()
        return pyarrow.concat_tables(
            pyarrow.parquet.read_table(self.path(number)) for number in range(count)
        )

    def remove(self) -> None:
        """Remove the folder with all its parts."""
        shutil.rmtree(self.folder, ignore_errors=True)


def run_parts(
    work: Work,
    parts: Parts,
    groups: Sequence[Sequence[Any]],
    dask: str | None = None,
    progress: Progress | None = None,
) -> Any:
    """Do work on groups of items, as parts that are kept, and give all rows.

    Parameters
    ----------
    work : Work
        What is done.
    parts : Parts
        Where they are kept; those that are there are not done again.
    groups : sequence of sequence
        The items of each part.
    dask : str, optional
        Where: a Dask scheduler's address such as "tcp://host:8786", or "local" or a number for
        that many processes on this machine. In this process by default.
    progress : callable, optional
        Called with (items done, items in all).

    Returns
    -------
    pyarrow.Table
        The rows of all parts, in their order.
    """
    total = sum(map(len, groups))
    left = [number for number in range(len(groups)) if not parts.has(number)]
    done = total - sum(len(groups[number]) for number in left)
    if progress is not None:
        progress(done, total)
    try:
        for number in _finished(work, parts, groups, left, dask):
            done += len(groups[number])
            if progress is not None:
                progress(done, total)
    except (KeyboardInterrupt, SystemExit):
        log.warning(
            "stopped: %d of %d are done and kept in %s; repeat the command to go on",
            done,
            total,
            parts.folder,
        )
        raise
    return parts.read(len(groups))


def _finished(
    work: Work, parts: Parts, groups: Sequence[Sequence[Any]], left: list[int], dask: str | None
) -> Iterator[int]:
    """The numbers of parts as they are done."""
    if dask is None or not left:
        for number in left:
            do_part(work, parts, number, groups[number])
            yield number
        return
    from slicematch.cluster import do_on_dask

    yield from do_on_dask(work, parts, {number: groups[number] for number in left}, dask)


def do_part(work: Work, parts: Parts, number: int, items: Sequence[Any]) -> int:
    """Do one part and keep it; its number."""
    parts.write(number, work(items), work.columns)
    return number


def split_groups(groups: Sequence[Sequence[Any]]) -> list[list[Any]]:
    """Items in parts of a good size: groups are kept together, unless one alone is too large.

    Parameters
    ----------
    groups : sequence of sequence
        What shares something that is costly to make, in order.

    Returns
    -------
    list of list
        The same parts for the same groups, in order.

    Examples
    --------
    >>> parts = split_groups([[1, 2], [3]] + [[0] * 8] * 1000)
    >>> parts[0][:4], max(map(len, parts)), sum(map(len, parts))
    ([1, 2, 3, 0], 64, 8003)
    """
    total = sum(map(len, groups))
    most = min(_MOST_ROWS, max(1, -(-total // _FEWEST_PARTS)))
    parts: list[list[Any]] = []
    for group in groups:
        for start in range(0, len(group), most):
            some = list(group[start : start + most])
            if parts and len(parts[-1]) + len(some) <= most:
                parts[-1] += some
            else:
                parts.append(some)
    return parts


def digest(value: Any) -> str:
    """A short name for a value of plain ones, or for the content of a file (a Path)."""
    if isinstance(value, Path):
        with value.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()[:16]
    text = json.dumps(value, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def import_pyarrow() -> Any:
    """Pyarrow with its Parquet, or RunError with what to install."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise RunError(
            f"this needs pyarrow, which cannot be imported ({error}); install: "
            "pip install 'slicemask[maps]'"
        ) from error
    return pyarrow


def _check_same(folder: Path, before: Any, now: Any) -> None:
    for name in sorted({*before, *now}):
        if before.get(name) != now.get(name):
            raise RunError(
                f"{folder}: holds parts of another request, with {name} {before.get(name)!r} in "
                f"place of {now.get(name)!r}; finish that, start afresh (--overwrite), or name "
                "another file"
            )
