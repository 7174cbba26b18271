"""Ctrl-C that tears no step apart.

Python raises KeyboardInterrupt in the main thread wherever that is: after a lock was taken and
before the block that gives it back, in the midst of a call that HDF5 makes, while a thread starts.
What must not end there runs on a thread of its own, which is asked to stop.
"""

import threading
from collections.abc import Callable
from typing import TypeVar

_Result = TypeVar("_Result")


class Stopped(Exception):  # noqa: N818 - no error
    """The work was asked to stop."""


def shielded(work: Callable[[Callable[[], None]], _Result]) -> _Result:
    """Give what the work gives, done on a thread of its own.

    An exception that strikes this thread meanwhile, as Ctrl-C or a signal's handler does, is raised
    once the work has ended.

    Parameters
    ----------
    work : callable
        Called with a function that it calls wherever it may be stopped, which raises `Stopped`
        there once it is to stop.
    """
    results: list[_Result] = []
    errors: list[BaseException] = []
    begin, ended = threading.Lock(), threading.Lock()
    begin.acquire()
    ended.acquire()
    stopping = False

    def check() -> None:
        if stopping:
            raise Stopped

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
        ended.acquire()
    except BaseException:
        stopping = True
        if begin.locked():
            begin.release()
        if not results and not errors:
            ended.acquire()
        raise
    for error in errors:
        raise error
    return results[0]
