"""One builder of a bank at a time."""

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import filelock

# How often a builder that waits looks whether it has been interrupted.
_POLL_S = 0.1


@contextmanager
def only_builder(target: Path) -> Iterator[None]:
    """Wait until no other builder of the target is at work, and keep others waiting.

    The lock is a file ``.<target's name>.lock`` beside the target, gone afterwards.

    Raises
    ------
    OSError
        If the lock file cannot be made.
    """
    file = target.with_name(f".{target.name}.lock")
    lock = filelock.FileLock(file, thread_local=False)
    given_up = threading.Event()

    def take() -> None:
        while not given_up.is_set():
            try:
                lock.acquire(timeout=_POLL_S)
            except filelock.Timeout:
                continue
            return

    # The lock is taken on a thread of its own, since Ctrl-C in the midst of it would leave the
    # file behind. The thread is there before: Ctrl-C while it starts leaves one that nobody knows.
    thread = ThreadPoolExecutor(1)
    thread.submit(int).result()
    try:
        thread.submit(take).result()
        yield
    finally:
        given_up.set()
        thread.shutdown()
        if lock.is_locked:
            file.unlink(missing_ok=True)
            lock.release()
