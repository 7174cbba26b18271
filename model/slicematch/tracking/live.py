"""Frames as they come: the newest is worked on, those that it overtakes are dropped and counted."""

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Item = TypeVar("Item")


class Newest(Generic[Item]):
    """Hands items to a worker on a thread of its own, which never falls behind; made by `newest`.

    While the worker is busy only the newest item waits; another one takes its place.

    Parameters
    ----------
    work : callable
        Called with an item, and how many were dropped since the one before.
    """

    def __init__(self, work: Callable[[Item, int], None]) -> None:
        self._work = work
        self._waiting: list[Item] = []
        self._dropped = 0
        self._open = True
        self._error: BaseException | None = None
        self._change = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="newest", daemon=True)
        self._thread.start()

    def put(self, item: Item) -> None:
        """Hand in an item, without waiting.

        Raises
        ------
        BaseException
            What the worker raised, if it did; nothing is worked on after that.
        """
        with self._change:
            if self._error is not None:
                raise self._error
            self._dropped += len(self._waiting)
            self._waiting = [item]
            self._change.notify()

    def close(self) -> None:
        """Work on what waits, and end the thread.

        Raises
        ------
        BaseException
            What the worker raised, if it did.
        """
        with self._change:
            self._open = False
            self._change.notify()
        self._thread.join()
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        try:
            while True:
                with self._change:
                    self._change.wait_for(lambda: self._waiting or not self._open)
                    if not self._waiting:
                        return
                    item, dropped = self._waiting.pop(), self._dropped
                    self._dropped = 0
                self._work(item, dropped)
        except BaseException as error:  # handed to who puts or closes
            self._error = error


def newest(work: Callable[[Item, int], None]) -> Newest[Item]:
    """Work on the newest of what comes, on a thread of its own.

    Parameters
    ----------
    work : callable
        Called with an item, and how many were dropped since the one before.

    Returns
    -------
    Newest
        `Newest.put` takes an item at any time, `Newest.close` ends it.

    Examples
    --------
    >>> done = []
    >>> frames = newest(lambda frame, dropped: done.append(frame))
    >>> frames.put("a frame")
    >>> frames.close()
    >>> done
    ['a frame']
    """
    return Newest(work)
