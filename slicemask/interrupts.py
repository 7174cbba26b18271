"""Ctrl-C that tears no step apart.

Python raises KeyboardInterrupt in the main thread wherever that is: after a lock was taken and
before the block that gives it back, in the midst of a call that HDF5 makes, while a thread starts.
What must not end there runs on a thread of its own, which is asked to stop.

Imports cannot: many a library takes any exception for an optional part that is missing. Signals
wait until they are done.
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

# How long a signal waits before it looks again whether an import is done.
_IMPORT_RETRY_S = 0.05
# How long this thread waits for the work at a time. A signal that strikes between Python's last
# look for signals and the wait is not seen before the wait is over.
_POLL_S = 0.1
# How long after a signal others do nothing: they may come together, and the second before anyone
# has heard of the first. Not for ever, for a library may swallow the first.
_IGNORE_REPEATS_S = 1.0
_last_signal_s = -math.inf

# Called wherever work may be stopped; raises `Cancelled` there once it is to stop.
CancelCheck = Callable[[], None]

_Result = TypeVar("_Result")


class Cancelled(Exception):  # noqa: N818 - no error
    """The work was asked to stop."""


def run_cancellable(work: Callable[[CancelCheck], _Result]) -> _Result:
    """Give what the work gives, done on a thread of its own.

    An exception that strikes this thread meanwhile, as Ctrl-C or a signal's handler does, is raised
    once the work has ended; signals that follow it do nothing.

    Parameters
    ----------
    work : callable
        Called with a `CancelCheck`.
    """
    results: list[_Result] = []
    errors: list[BaseException] = []
    begin, ended = threading.Lock(), threading.Lock()
    begin.acquire()
    ended.acquire()
    stopping = False

    def check() -> None:
        if stopping:
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
        stopping = True
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
def _signals_muted() -> Iterator[None]:
    """Have signals do nothing: another Ctrl-C would leave the work alone while it stops.

    They get a handler, for an ignored signal would be ignored by processes started here, too.
    """
    if threading.current_thread() is not threading.main_thread():  # signals strike that one only
        yield
        return
    before = {
        number: signal.signal(number, lambda number, frame: None)
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            # None: one that was not set from Python, and cannot be set again from here.
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


def exit_on_signals() -> None:
    """Have SIGTERM exit as Ctrl-C does, in order, and neither of them strike within an import.

    Of signals that come close together the first one counts.
    """
    signal.signal(signal.SIGTERM, _raise_outside_imports)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not ignored
        signal.signal(signal.SIGINT, _raise_outside_imports)


def _raise_outside_imports(number: int, frame: FrameType | None) -> None:
    at = frame
    while at is not None:
        if at.f_code.co_filename.startswith("<frozen importlib"):
            # To this thread, the main one: another's would not wake it where it waits.
            again = threading.Timer(
                _IMPORT_RETRY_S, signal.pthread_kill, (threading.get_ident(), number)
            )
            again.daemon = True
            again.start()
            return
        at = at.f_back
    global _last_signal_s
    if time.monotonic() < _last_signal_s + _IGNORE_REPEATS_S:
        return
    _last_signal_s = time.monotonic()
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    sys.exit(128 + number)
