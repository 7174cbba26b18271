"""Where banks go by default."""

import os
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

    The default cache folder is made if it is missing; a folder that was named is not, since a
    misspelt name should not become a folder.

    Raises
    ------
    BankError
        If ``out`` is a folder, or the folder is missing or cannot be written to.
    """
    path = Path(out) if out is not None else cache_folder(cache) / spec.name()
    if path.is_dir():
        raise BankError(f"{path}: is a folder; name a file in it")
    folder = path.parent
    if out is None and cache is None and not folder.exists():
        try:
            folder.mkdir(parents=True)
        except OSError as error:
            raise BankError(f"{folder}: cannot be made: {error.strerror}") from error
    if not folder.is_dir():
        raise BankError(f"{folder}: there is no such folder; make it, or name another")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise BankError(f"{folder}: may not be written to; name another folder")
    return path


def newest_bank(cache: str | Path | None = None) -> Path:
    """The bank written last in the cache folder.

    Raises
    ------
    BankError
        If there is none.
    """
    folder = cache_folder(cache)
    found = [path for path in folder.glob("*.h5") if path.is_file() and has_seal(path)]
    if not found:
        raise BankError(f"{folder}: holds no bank yet; build one with: slicemask build")
    return max(found, key=lambda path: (path.stat().st_mtime_ns, path.name))
