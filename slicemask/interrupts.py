"""Ctrl-C and SIGTERM that end work between two steps, never within one.

Python raises KeyboardInterrupt in the main thread wherever that happens to be: after a lock was
acquired and before the block that releases it, inside a call that HDF5 makes, while a thread is
starting. Work that must not end there runs on a thread of its own, which is asked to stop.

Imports cannot be asked: many a library takes any exception for an optional dependency that is
missing. Signals wait until the import is done.
"""

import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TypeVar

# A signal that arrives between Python's last check for signals and the wait for the work is not
# seen before that wait times out, so each wait is this short.
_POLL_S = 0.1
# How long a signal waits before it checks again whether an import has finished.
_IMPORT_RETRY_S = 0.05
# `timeout` sends SIGTERM twice within microseconds, and the second one must not end the wait for
# work that the first one is stopping. Later ones count, since a library may swallow the first.
_IGNORE_REPEATS_S = 1.0

# Called wherever work may stop; raises `Cancelled` there once it should.
CancelCheck = Callable[[], None]

_Result = TypeVar("_Result")
_Handler = Callable[[int, FrameType | None], None]


class Cancelled(Exception):  # noqa: N818 - no error
    """Raised by a `CancelCheck` in work that was asked to stop."""


def run_cancellable(work: Callable[[CancelCheck], _Result]) -> _Result:
    """Run work on a thread of its own, so that an interrupt stops it only where it allows.

    Parameters
    ----------
    work : callable
        Called with a `CancelCheck`, which it calls wherever it may stop.

    Returns
    -------
    result
        What the work returned.

    Raises
    ------
    BaseException
        What the work raised; or what struck this thread meanwhile, such as KeyboardInterrupt. The
        latter is raised once the work has ended, and signals are ignored until then.
    """
    results: list[_Result] = []
    errors: list[BaseException] = []
    begin, ended = threading.Lock(), threading.Lock()
    begin.acquire()
    ended.acquire()
    cancelled = False

    def check() -> None:
        if cancelled:
            raise Cancelled

    def run() -> None:
        begin.acquire()
        try:
            results.append(work(check))
        except BaseException as error:
            errors.append(error)
        finally:
            ended.release()

    # A daemon: if Ctrl-C strikes here, nothing has begun, and nobody waits for it.
    threading.Thread(target=run, daemon=True).start()
    try:
        begin.release()
        while not ended.acquire(timeout=_POLL_S):
            pass
    except BaseException:
        cancelled = True
        with _signals_muted():
            if begin.locked():
                begin.release()
            if not results and not errors:
                ended.acquire()
        raise
    for error in errors:
        raise error
    return results[0]


@contextmanager
def exit_on_signals() -> Iterator[None]:
    """Within the block, let SIGTERM exit as Ctrl-C does: by an exception that cleans up.

    Neither strikes during an import, and of signals that follow each other closely only the first
    one counts. Ctrl-C stays ignored where it was, as in jobs that a shell runs in the background.
    The previous handlers are restored at the end. Other threads than the main one, which receives
    all signals, change nothing.

    Raises
    ------
    KeyboardInterrupt
        On SIGINT.
    SystemExit
        On SIGTERM, with status 143, as shells report it.
    """
    numbers = [signal.SIGTERM]
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        numbers.append(signal.SIGINT)
    last_s = -math.inf

    def handle(number: int, frame: FrameType | None) -> None:
        nonlocal last_s
        if _is_importing(frame):
            # To this thread, the main one: a signal to another would not wake it from a wait.
            retry = threading.Timer(
                _IMPORT_RETRY_S, signal.pthread_kill, (threading.get_ident(), number)
            )
            retry.daemon = True
            retry.start()
            return
        if time.monotonic() < last_s + _IGNORE_REPEATS_S:
            return
        last_s = time.monotonic()
        if number == signal.SIGINT:
            raise KeyboardInterrupt
        sys.exit(128 + number)

    with _handled_by(handle, numbers):
        yield


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


@contextmanager
def _signals_muted() -> Iterator[None]:
    """Ignore signals: another Ctrl-C would abandon the work while it stops.

    They get a handler, since processes started here would inherit that a signal is ignored.
    """
    with _handled_by(lambda number, frame: None, [signal.SIGINT, signal.SIGTERM]):
        yield


@contextmanager
def _handled_by(handler: _Handler, numbers: list[signal.Signals]) -> Iterator[None]:
    """Handle signals by a function within the block, and as before after it."""
    if threading.current_thread() is not threading.main_thread():  # which alone may set handlers
        yield
        return
    previous = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, old in previous.items():
            # None: set by something other than Python, which cannot set it again.
            signal.signal(number, signal.SIG_DFL if old is None else old)
