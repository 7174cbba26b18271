"""One builder of a bank at a time."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import filelock

from slicemask.shield import Check

# How often a builder that waits looks whether it is to stop.
_POLL_S = 0.1


@contextmanager
def only_builder(target: Path, check: Check) -> Iterator[None]:
    """Wait until no other builder of the target is at work, and keep others waiting.

    The lock is a file ``.<target's name>.lock`` beside the target, gone afterwards. ``check`` is
    called while waiting, and may raise.

    Raises
    ------
    OSError
        If the lock file cannot be made.
    """
    file = target.with_name(f".{target.name}.lock")
    lock = filelock.FileLock(file)
    while not lock.is_locked:
        check()
        try:
            lock.acquire(timeout=_POLL_S)
        except filelock.Timeout:
            continue
    try:
        yield
    finally:
        file.unlink(missing_ok=True)
        lock.release()
