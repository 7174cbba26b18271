"""Output files: checked before the work, and written completely or not at all."""

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from slicemask.errors import SlicemaskError

_REMEDY = "choose another place, or free some space"
# What file systems that have no fsync answer; anything else means that data may be lost.
_NO_FSYNC = {errno.EINVAL, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP}


def check_target(path: str | Path, suffixes: tuple[str, ...], error: type[SlicemaskError]) -> Path:
    """Check that a file can be written, before the work that it is for.

    Parameters
    ----------
    path : path
        Where the file is to go.
    suffixes : tuple of str
        What its name may end in, such as (".png", ".svg").
    error : type
        The class of error to raise.

    Returns
    -------
    path : Path
        The same path.

    Raises
    ------
    SlicemaskError
        An ``error``, if the path is invalid, a folder, has another suffix, or lies in a folder
        that is missing or may not be written to.
    """
    path = Path(path)
    if path.suffix.lower() not in suffixes:
        raise error(
            f"{path}: its suffix is {path.suffix or 'missing'}; name a file that ends in "
            f"{' or '.join(suffixes)}"
        )
    if fault := _fault(_partial(path)):  # whose name is longer
        raise error(f"{path}: is invalid: {fault}; name another file")
    if path.is_dir():
        raise error(f"{path}: is a folder; name a file")
    if not path.parent.is_dir():
        raise error(f"{path.parent}: there is no such folder; make it, or name another")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise error(f"{path.parent}: may not be written to; name another folder")
    return path


def check_folder(path: str | Path, error: type[SlicemaskError]) -> Path:
    """Check that a folder for results can be made or written to, before the work.

    Neither the folder nor those above it need to exist.

    Parameters
    ----------
    path : path
        The folder.
    error : type
        The class of error to raise.

    Returns
    -------
    path : Path
        The same path.

    Raises
    ------
    SlicemaskError
        An ``error``, if the path is invalid, or it or what it lies in is a file or may not be
        written to.
    """
    path = Path(path)
    if fault := _fault(path):
        raise error(f"{path}: is invalid: {fault}; name another folder")
    existing = existing_parent(path)
    if not existing.is_dir():
        raise error(f"{existing}: is not a folder; name another one")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise error(f"{existing}: may not be written to; name another folder")
    return path


def existing_parent(path: Path) -> Path:
    """Return the path itself if it exists, else the closest of its parents that does."""
    return next(folder for folder in (path, *path.absolute().parents) if folder.exists())


@contextmanager
def atomic_write(
    path: Path,
    error: type[SlicemaskError],
    remedy: str = _REMEDY,
) -> Iterator[Path]:
    """Give a temporary name beside ``path``, and rename what was written there to ``path``.

    If the block raises, the temporary file is removed and ``path`` is as it was. A symbolic link
    at ``path`` is replaced, not followed.

    Parameters
    ----------
    path : Path
        Where the file goes.
    error : type
        The class of error to raise.
    remedy : str
        The end of its message: what the user can do.

    Yields
    ------
    partial : Path
        The name to write to.

    Raises
    ------
    SlicemaskError
        An ``error``, if the file cannot be written.
    """
    partial = _partial(path)
    try:
        try:
            yield partial
            sync_to_disk(partial)
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)
    except OSError as reason:
        raise error(f"{path}: cannot be written: {reason.strerror or reason}; {remedy}") from reason


def check_new_folder(path: str | Path, error: type[SlicemaskError]) -> Path:
    """Return a folder that is to be written, or raise ``error`` unless it is new or empty.

    Raises
    ------
    SlicemaskError
        An ``error``; also as `check_folder`.
    """
    folder = check_folder(path, error)
    if folder.exists() and any(folder.iterdir()):
        raise error(f"{folder}: is not empty; name another folder")
    return folder


@contextmanager
def atomic_folder(path: Path, error: type[SlicemaskError]) -> Iterator[Path]:
    """Make a temporary folder beside ``path``, and rename it to ``path`` once it is filled.

    If the block raises, the temporary folder is removed and ``path`` is as it was.

    Parameters
    ----------
    path : Path
        The folder, new or empty.
    error : type
        The class of error to raise.

    Yields
    ------
    partial : Path
        The folder to write to.

    Raises
    ------
    SlicemaskError
        An ``error``, if the folder cannot be written.
    """
    partial = _partial(path)
    try:
        partial.mkdir(parents=True)
        yield partial
        os.replace(partial, path)
    except OSError as reason:
        if isinstance(reason, error):
            raise
        raise error(
            f"{path}: cannot be written ({reason.strerror or reason}); name another folder"
        ) from reason
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def write_text(path: Path, text: str, error: type[SlicemaskError], remedy: str = _REMEDY) -> None:
    """Write text as UTF-8, its line ends unchanged, completely or not at all.

    Parameters
    ----------
    path : Path
        Where the file goes.
    text : str
        What it holds.
    error : type
        The class of error to raise.
    remedy : str
        The end of its message: what the user can do.

    Raises
    ------
    SlicemaskError
        An ``error``, if the file cannot be written.
    """
    with atomic_write(path, error, remedy) as partial:
        partial.write_text(text, encoding="utf-8", newline="")


def sync_to_disk(path: Path) -> None:
    """Wait until a file, or a folder's entries, are on the disk, where the file system can tell.

    Raises
    ------
    OSError
        If they could not be written.
    """
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as reason:
        if reason.errno not in _NO_FSYNC:
            raise
    finally:
        os.close(descriptor)


def _partial(path: Path) -> Path:
    return path.with_name(f".{path.name}.{os.getpid()}.partial")


def _fault(path: Path) -> str | None:
    """Why a path is invalid, as when its name is too long; None if it is valid."""
    try:
        os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as reason:
        return reason.strerror
    return None
