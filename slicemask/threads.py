"""How many threads or processes to use."""

import os

from slicemask.errors import SpecError
from slicemask.geometry.numbers import is_whole


def thread_count(jobs: int | None) -> int:
    """Return how many threads to use.

    Parameters
    ----------
    jobs : int or None
        The number asked for; None means as many as there are processors for this process.

    Returns
    -------
    count : int
        At least 1.

    Raises
    ------
    SpecError
        If the number asked for is less than 1 or not whole.
    """
    if jobs is None:
        if hasattr(os, "sched_getaffinity"):
            return len(os.sched_getaffinity(0))
        return os.cpu_count() or 1
    if not is_whole(jobs) or jobs < 1:
        raise SpecError(f"jobs is {jobs!r}; it must be a whole number of at least 1")
    return int(jobs)
