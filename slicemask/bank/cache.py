"""Where banks go by default."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from slicemask.bank.seal import has_seal
from slicemask.bank.spec import BankSpec
from slicemask.errors import BankError
from slicemask.files import existing_parent

ENVIRONMENT = "SLICEMASK_CACHE"
DEFAULT = "masks_cache"


def cache_folder(cache: str | Path | None = None) -> Path:
    """Return the folder of banks: the one given, else SLICEMASK_CACHE, else ``./masks_cache``."""
    return Path(cache or os.environ.get(ENVIRONMENT) or DEFAULT)


def bank_path(
    spec: BankSpec, out: str | Path | None = None, cache: str | Path | None = None
) -> Path:
    """Return where a bank goes: ``out``, or a name that says what it holds, in the cache folder.

    The cache folder may be missing (see `ensure_cache_dir`); the folder of ``out`` may not.

    Raises
    ------
    BankError
        If the path is a folder, or invalid, or the folder of ``out`` is missing.
    """
    path = Path(out) if out is not None else cache_folder(cache) / spec.name()
    option = "--cache" if out is None else "--out"
    try:
        # Links are followed here, so that the bank replaces the file and not a link to it.
        linked = path.is_symlink()
        if linked:
            path = path.resolve()
        folder = path.parent
        if path.is_dir():
            raise BankError(f"{path}: is a folder; name a file in it with --out")
        existing = existing_parent(folder)
        if not existing.is_dir():
            raise BankError(f"{existing}: is not a folder; name another one with {option}")
        if not folder.exists() and (out is not None or linked):
            raise BankError(f"{folder}: there is no such folder; make it, or name another")
    except OSError as error:
        if isinstance(error, BankError):
            raise
        raise BankError(
            f"{path}: is invalid: {error.strerror}; name another with {option}"
        ) from error
    return path


@contextmanager
def ensure_cache_dir(folder: Path) -> Iterator[None]:
    """Make a cache folder, and those above it, if missing; remove them again if the block raises.

    Raises
    ------
    BankError
        If it cannot be made.
    """
    missing = [part for part in (folder, *folder.parents) if not part.exists()]
    try:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BankError(
                f"{folder}: cannot be made: {error.strerror}; name another folder with --cache"
            ) from error
        yield
    except BaseException:
        for made in missing:
            with suppress(OSError):  # it is not empty, or was never made
                made.rmdir()
        raise


def newest_bank(cache: str | Path | None = None) -> Path:
    """Return the bank written last in the cache folder, of those that may be read.

    Raises
    ------
    BankError
        If there is none.
    """
    folder = cache_folder(cache)
    found = [
        path
        for path in folder.glob("*.h5")
        if path.is_file() and os.access(path, os.R_OK) and has_seal(path)
    ]
    if not found:
        raise BankError(f"{folder}: holds no bank yet; build one with: slicemask build")
    return max(found, key=lambda path: (path.stat().st_mtime_ns, path.name))
