"""One builder of a bank at a time."""

import errno
import logging
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import filelock

from slicemask.interrupts import CancelCheck

log = logging.getLogger(__name__)

# How often a builder that waits checks whether it is to stop.
_POLL_S = 0.1
# What file systems that have no locks answer: Lustre without `-o flock`, NFS without lockd, FUSE.
_NO_LOCKS = {errno.ENOSYS, errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP}


@contextmanager
def build_lock(target: Path, check: CancelCheck) -> Iterator[bool]:
    """Wait until no other builder of the target is at work, and keep others waiting.

    The lock is a file ``.<target's name>.lock`` beside the target, removed afterwards.

    Parameters
    ----------
    target : Path
        The bank to be built.
    check : callable
        Called while waiting; it may raise.

    Yields
    ------
    locked : bool
        False where the file system has no locks. Then other builders may be at work.

    Raises
    ------
    OSError
        If no file can be made beside the target.
    """
    file = target.with_name(f".{target.name}.lock")
    lock = filelock.FileLock(file)
    locked = _has_locks(target.parent)
    waited = False
    try:
        while locked and not lock.is_locked:
            try:
                lock.acquire(timeout=_POLL_S)
            except filelock.Timeout:
                if not waited:
                    log.warning("%s: waiting until another builder of it ends", target)
                waited = True
                check()
            except OSError as error:
                if error.errno not in _NO_LOCKS:
                    raise
                locked = False
                file.unlink(missing_ok=True)
        if not locked:
            log.warning(
                "%s: its file system has no file locks, so another build of the same bank would "
                "not wait for this one, but do the work again",
                target,
            )
        yield locked
    finally:
        if lock.is_locked:
            file.unlink(missing_ok=True)
            lock.release()


def _has_locks(folder: Path) -> bool:
    """Whether files in a folder can be locked: tried with one that nobody else locks.

    Where they cannot, filelock falls back to a file whose mere existence is the lock. It would
    outlive a killed builder, and keep others waiting for ever. Where no file can be made at all,
    filelock may take that for a passing fault and try for ever; here it is an error.
    """
    with tempfile.TemporaryFile(dir=folder) as probe:
        try:
            import fcntl

            fcntl.flock(probe, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except ImportError:  # Windows, which locks in another way
            return True
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise
            return False
    return True
