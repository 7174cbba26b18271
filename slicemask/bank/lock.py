"""One builder of a bank at a time."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import filelock

from slicemask.interrupts import CancelCheck

log = logging.getLogger(__name__)

# How often a builder that waits looks whether it is to stop.
_POLL_S = 0.1


@contextmanager
def build_lock(target: Path, check: CancelCheck) -> Iterator[None]:
    """Wait until no other builder of the target is at work, and keep others waiting.

    The lock is a file ``.<target's name>.lock`` beside the target, gone afterwards. ``check`` is
    called while waiting, and may raise.

    Raises
    ------
    OSError
        If the lock file cannot be made.
    """
    file = target.with_name(f".{target.name}.lock")
    # Where it cannot be made, filelock may take that for a passing fault, and try for ever.
    file.touch()
    lock = filelock.FileLock(file)
    waited = False
    while not lock.is_locked:
        try:
            lock.acquire(timeout=_POLL_S)
        except filelock.Timeout:
            if not waited:
                log.warning("%s: waiting until another builder of it ends", target)
            waited = True
            check()
    try:
        yield
    finally:
        file.unlink(missing_ok=True)
        lock.release()
