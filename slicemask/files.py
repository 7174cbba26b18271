"""Files that are written whole or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from slicemask.errors import SlicemaskError

_REMEDY = "choose another place, or free some space"


def check_target(path: str | Path, suffixes: tuple[str, ...], error: type[SlicemaskError]) -> Path:
    """Return the path of a file to be written, or raise ``error`` if it cannot be one.

    Parameters
    ----------
    path : path
        Where the file is to go.
    suffixes : tuple of str
        What its name may end in, such as (".png", ".svg").
    error : type
        What to raise.
    """
    path = Path(path)
    if path.suffix.lower() not in suffixes:
        raise error(
            f"{path}: its suffix is {path.suffix or 'missing'}; name a file that ends in "
            f"{' or '.join(suffixes)}"
        )
    if fault := _fault(_partial(path)):  # whose name is longer
        raise error(f"{path}: cannot be: {fault}; name another file")
    if path.is_dir():
        raise error(f"{path}: is a folder; name a file")
    if not path.parent.is_dir():
        raise error(f"{path.parent}: there is no such folder; make it, or name another")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise error(f"{path.parent}: may not be written to; name another folder")
    return path


def check_folder(path: str | Path, error: type[SlicemaskError]) -> Path:
    """Return the path of a folder for results, or raise ``error`` if it cannot be one.

    It need not be there, nor the folders above it.

    Parameters
    ----------
    path : path
        The folder.
    error : type
        What to raise.
    """
    path = Path(path)
    if fault := _fault(path):
        raise error(f"{path}: cannot be: {fault}; name another folder")
    existing = next(folder for folder in (path, *path.absolute().parents) if folder.exists())
    if not existing.is_dir():
        raise error(f"{existing}: is no folder; name another one")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise error(f"{existing}: may not be written to; name another folder")
    return path


@contextmanager
def atomic_write(
    path: Path,
    error: type[SlicemaskError],
    remedy: str = _REMEDY,
) -> Iterator[Path]:
    """A name beside ``path`` to write to, which becomes it at the end, or is removed on an error.

    A link at ``path`` is replaced by the file. Raises ``error``, with the remedy, if the file
    cannot be written.
    """
    partial = _partial(path)
    try:
        try:
            yield partial
            with partial.open("rb") as file:
                os.fsync(file.fileno())
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)
    except OSError as reason:
        raise error(f"{path}: cannot be written: {reason.strerror or reason}; {remedy}") from reason


def write_text(path: Path, text: str, error: type[SlicemaskError], remedy: str = _REMEDY) -> None:
    """Write a text, UTF-8 and its line ends as they are, as `atomic_write` does."""
    with atomic_write(path, error, remedy) as partial:
        partial.write_text(text, encoding="utf-8", newline="")


def _partial(path: Path) -> Path:
    return path.with_name(f".{path.name}.{os.getpid()}.partial")


def _fault(path: Path) -> str | None:
    """Why there cannot be such a path, as when its name is too long; None if there can."""
    try:
        os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as reason:
        return reason.strerror
    return None
