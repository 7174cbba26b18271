"""Where banks go by default."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from slicemask.bank.seal import has_seal
from slicemask.bank.spec import BankSpec
from slicemask.errors import BankError

ENVIRONMENT = "SLICEMASK_CACHE"
DEFAULT = "masks_cache"


def cache_folder(cache: str | Path | None = None) -> Path:
    """The folder of banks: the one given, else SLICEMASK_CACHE, else ``masks_cache`` here."""
    return Path(cache or os.environ.get(ENVIRONMENT) or DEFAULT)


def bank_path(
    spec: BankSpec, out: str | Path | None = None, cache: str | Path | None = None
) -> Path:
    """Where a bank goes: ``out``, or a name that says what it holds, in the cache folder.

    Only ``./masks_cache`` may be missing (see `ensure_cache_dir`): a misspelt name must not become
    a folder.

    Raises
    ------
    BankError
        If ``out`` is a folder, or its folder is missing.
    """
    path = Path(out) if out is not None else cache_folder(cache) / spec.name()
    try:
        # Links are followed here, so that the bank replaces the file and not a link to it.
        if path.is_symlink():
            path = path.resolve()
        folder = path.parent
        if path.is_dir():
            raise BankError(f"{path}: is a folder; name a file in it")
        if folder.exists() and not folder.is_dir():
            raise BankError(f"{folder}: is no folder; name another")
        if not folder.exists() and folder != Path(DEFAULT):
            raise BankError(f"{folder}: there is no such folder; make it, or name another")
    except OSError as error:
        if isinstance(error, BankError):
            raise
        raise BankError(f"{path}: cannot be: {error.strerror}") from error
    return path


@contextmanager
def ensure_cache_dir(folder: Path) -> Iterator[None]:
    """Make the default cache folder if it is missing, and take it away again on failure."""
    missing = folder == Path(DEFAULT) and not folder.exists()
    if missing:
        folder.mkdir(exist_ok=True)
    try:
        yield
    except BaseException:
        if missing and not any(folder.iterdir()):
            folder.rmdir()
        raise


def newest_bank(cache: str | Path | None = None) -> Path:
    """The bank written last in the cache folder, of those that may be read.

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
