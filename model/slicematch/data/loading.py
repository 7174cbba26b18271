"""Loading samples in worker processes, with the resources that these need."""

import re
from collections.abc import Iterator
from typing import Any

from torch.utils.data import DataLoader

from slicemask.errors import SlicemaskError
from slicematch.data.errors import LoaderError

# What torch and the operating system say when a resource runs out. Shared memory that is full
# ends a worker by a bus error; too few open files break the pipes between processes.
_CAUSES = (
    (
        r"Bus error|shared memory|shm|No space left",
        "shared memory (/dev/shm) ran out",
        "give it more (docker run --shm-size=8g)",
    ),
    (
        r"Too many open files|ancdata|received 0 items|Errno 24",
        "open files ran out",
        "allow more (ulimit -n 4096)",
    ),
    (
        r"Cannot allocate memory|Killed|out of memory|MemoryError",
        "memory ran out",
        "choose smaller batches",
    ),
    (
        r"Resource temporarily unavailable|can't start new thread|Errno 11",
        "processes or threads ran out",
        "allow more (ulimit -u)",
    ),
    (
        r"DataLoader worker .*(exited unexpectedly|killed by signal)",
        "a loader process was killed, most likely for want of memory or shared memory",
        "give it more (docker run --shm-size=8g)",
    ),
)


class PoseLoader(DataLoader[Any]):
    """A torch `DataLoader` that says in one sentence which resource its workers lack.

    Raises
    ------
    LoaderError
        While iterating, if shared memory, open files, memory or processes run out.
    """

    def __iter__(self) -> Any:
        try:
            batches = super().__iter__()
        except (OSError, RuntimeError) as error:
            if explained := _explain(error, self.num_workers):
                raise explained from error
            raise
        return _Batches(batches, self.num_workers)


class _Batches:
    """The batches of an iterator of `DataLoader`, which is reached for everything else."""

    def __init__(self, batches: Iterator[Any], workers: int) -> None:
        self._batches = batches
        self._workers = workers

    def __iter__(self) -> "_Batches":
        return self

    def __next__(self) -> Any:
        try:
            return next(self._batches)
        except (OSError, RuntimeError) as error:
            if explained := _explain(error, self._workers):
                raise explained from error
            raise

    def __len__(self) -> int:
        return len(self._batches)  # type: ignore[arg-type]

    def __getattr__(self, name: str) -> Any:
        return getattr(self._batches, name)


def _explain(error: Exception, workers: int) -> LoaderError | None:
    """One sentence on the resource that ran out; None if the error says of none."""
    # A sample's own fault, such as a missing file, is no lack of resources.
    if workers == 0 or isinstance(error, SlicemaskError):
        return None
    for pattern, what, remedy in _CAUSES:
        if re.search(pattern, f"{type(error).__name__}: {error}"):
            return LoaderError(
                f"{what} while {workers} processes loaded images; {remedy}, or load in fewer "
                "processes (--workers 0 for none)"
            )
    return None
