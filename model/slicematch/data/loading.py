"""Loading samples in worker processes, with the resources that these need."""

import errno
import multiprocessing.queues
import os
import re
import signal
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from torch.utils.data import DataLoader

from slicemask.errors import SlicemaskError
from slicematch.data.errors import LoaderError


class _Cause(NamedTuple):
    """A resource that ran out: what the system or torch says, its name, and what mends it."""

    pattern: str
    what: str
    remedy: str


_OPEN_FILES = _Cause(
    r"Too many open files|ancdata|received 0 items|Errno 2[34]\b",
    "open files ran out",
    "allow more (ulimit -n 4096)",
)
_SHARED_MEMORY = _Cause(
    r"Bus error|torch_\d+.*No space left|No space left.*torch_\d+|insufficient shared memory",
    "shared memory (/dev/shm) ran out",
    "give it more (docker run --shm-size=8g)",
)
_MEMORY = _Cause(
    r"Cannot allocate memory|out of memory|MemoryError|Errno 12\b|can't allocate memory",
    "memory ran out",
    "choose smaller batches",
)
_PROCESSES = _Cause(
    r"Resource temporarily unavailable|can't start new thread|Errno 11\b",
    "processes or threads ran out",
    "allow more (ulimit -u)",
)
_CAUSES = (_OPEN_FILES, _SHARED_MEMORY, _MEMORY, _PROCESSES)
# What a worker ends with by `_end_worker`, and what the system ends it with.
_STATUS = {101 + number: cause for number, cause in enumerate(_CAUSES)}
_SIGNALS = {"SIGBUS": _SHARED_MEMORY, "SIGKILL": _MEMORY}


def raise_lack_of_resources(error: BaseException) -> None:
    """Raise what an error comes from, if that is a lack of memory or of open files.

    A sample whose file cannot be opened for such a reason is not unreadable.
    """
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, MemoryError) or (
            isinstance(cause, OSError) and cause.errno in (errno.EMFILE, errno.ENFILE, errno.ENOMEM)
        ):
            raise cause
        cause = cause.__cause__


class PoseLoader(DataLoader[Any]):
    """A torch `DataLoader` that says in one sentence which resource its workers lack.

    Workers start with the first batch. One that can hand no batch over ends, so that nobody waits
    for it.

    Raises
    ------
    LoaderError
        While iterating, if shared memory, open files, memory or processes run out, or a worker
        is killed.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        with _no_advice():
            super().__init__(*arguments, **options)
        self.worker_init_fn = _watch_resources

    def __iter__(self) -> Any:
        """The batches of an epoch."""
        return _Batches(self)

    def start(self) -> Iterator[Any]:
        """Start the workers; their batches, with torch's own errors."""
        # Torch raises from a signal's handler if a worker dies, wherever the process happens to be:
        # in the middle of a training step, say. It also looks while it waits for a batch, which is
        # where the error belongs.
        child_signal = getattr(signal, "SIGCHLD", None)
        in_main_thread = threading.current_thread() is threading.main_thread()
        before = signal.getsignal(child_signal) if child_signal is not None else None
        with _no_advice():
            batches = super().__iter__()
        if child_signal is not None and in_main_thread:
            signal.signal(child_signal, before or signal.SIG_DFL)
        return batches


class _Batches:
    """The batches of an epoch, from workers that start with the first one."""

    def __init__(self, loader: PoseLoader) -> None:
        self._loader = loader
        self._batches: Iterator[Any] | None = None

    def __iter__(self) -> "_Batches":
        return self

    def __next__(self) -> Any:
        try:
            if self._batches is None:
                self._batches = self._loader.start()
            return next(self._batches)
        except (OSError, RuntimeError, MemoryError, EOFError) as error:
            explained = _explain(error, self._loader.num_workers, self._exit_codes(error))
            if explained is None:
                raise
            raise explained from error

    def __len__(self) -> int:
        return len(self._loader)

    def _exit_codes(self, error: BaseException) -> list[int]:
        """How those workers ended that did not end well."""
        workers = getattr(self._batches, "_workers", ())
        if isinstance(error, ConnectionError | EOFError | FileNotFoundError):
            # A worker hung up; the system may take a moment to say how it ended.
            deadline = time.monotonic() + 1.0
            while not any(worker.exitcode for worker in workers) and time.monotonic() < deadline:
                time.sleep(0.01)
        return [worker.exitcode for worker in workers if worker.exitcode]


@contextmanager
def _no_advice() -> Iterator[None]:
    """Torch advises at each start against more workers than processors; they are a setting."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="This DataLoader will create")
        yield


def _watch_resources(_: int) -> None:
    """Let a worker end where its threads would print an error and go on, and be waited for."""
    multiprocessing.queues.Queue._on_queue_feeder_error = staticmethod(  # type: ignore[attr-defined]
        lambda error, _: _end_worker(error)
    )
    sys.excepthook = lambda _kind, error, _trace: _end_worker(error)
    if hasattr(signal, "SIGBUS"):  # torch's handler prints its own advice
        signal.signal(signal.SIGBUS, signal.SIG_DFL)


def _end_worker(error: BaseException) -> None:
    """End this process; its exit status says which resource ran out."""
    text = f"{type(error).__name__}: {error}"
    try:
        with open(os.devnull):  # without a file to open, imports fail by other names
            pass
    except OSError as failure:
        text = str(failure)
    for status, cause in _STATUS.items():
        if re.search(cause.pattern, text):
            os._exit(status)
    traceback.print_exception(error)
    os._exit(1)


def _explain(error: BaseException, workers: int, exit_codes: list[int]) -> LoaderError | None:
    """One sentence on the resource that ran out; None if the error says of none."""
    # A sample's own fault, such as a missing file, is no lack of resources.
    if workers == 0 or isinstance(error, SlicemaskError):
        return None
    text = f"{type(error).__name__}: {error}"
    matching = [cause for cause in _CAUSES if re.search(cause.pattern, text)]
    for code in exit_codes:
        name = _signal_name(code)
        if cause := _STATUS.get(code) or _SIGNALS.get(name):
            matching.insert(0, cause)
        elif not matching:
            return LoaderError(
                f"a process that loads images ended by {name}; what it was doing shows when images "
                "are loaded in none (--workers 0)"
            )
    if not matching:
        return None
    what, remedy = matching[0].what, matching[0].remedy
    processes = "1 process" if workers == 1 else f"{workers} processes"
    return LoaderError(
        f"{what} while {processes} loaded images; {remedy}, or load in fewer processes "
        "(--workers 0 for none)"
    )


def _signal_name(code: int) -> str:
    """How a process ended, such as SIGKILL or exit status 1."""
    if code >= 0:
        return f"exit status {code}"
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"signal {-code}"
