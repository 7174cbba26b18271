"""How far long work is, as lines for where nobody watches a bar, and a log may keep each."""

import time
from collections.abc import Callable

SECONDS_BETWEEN_LINES = 30.0


class TimedLines:
    """Says how far something is, about every 30 seconds, with the time left.

    It is called with how many are done and how many there are in all.

    Parameters
    ----------
    what, unit : str
        What is being done, and to what, such as "building" and "poses".
    say : callable
        Called with each line.
    clock : callable
        Gives seconds.

    Examples
    --------
    >>> seconds = iter([0, 20, 40])
    >>> progress = TimedLines("building", "poses", print, lambda: next(seconds))
    >>> for done in (1000, 2000):
    ...     progress(done, 5000)
    building: 2,000 of 5,000 poses, about 60 s left
    """

    def __init__(
        self,
        what: str,
        unit: str,
        say: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._what = what
        self._unit = unit
        self._say = say
        self._clock = clock
        self._start = self._said = clock()

    def __call__(self, done: int, total: int) -> None:
        """Say it, if it is time again."""
        now = self._clock()
        if now - self._said < SECONDS_BETWEEN_LINES or not 0 < done < total:
            return
        self._said = now
        left = readable_time((now - self._start) / done * (total - done))
        self._say(f"{self._what}: {done:,} of {total:,} {self._unit}, about {left} left")


def readable_time(seconds: float) -> str:
    """A time as people read it.

    Examples
    --------
    >>> readable_time(45), readable_time(700), readable_time(12_600)
    ('45 s', '12 min', '3.5 h')
    """
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 99.5 * 60 else f"{seconds / 3600:.1f} h"
