"""Parts of work on many processes and machines, by Dask distributed."""

import contextlib
import logging
import sys
import threading
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Any

from slicemask._version import __version__
from slicemask.threads import thread_count
from slicematch.errors import ConfigError, RunError
from slicematch.parts import Parts, Work, do_part

# Parts that wait at the scheduler at once; more come as these are done.
_WAITING = 1000
_WAIT_S = 60
# Dask has its workers give freed memory back at once. Scoring uses the same megabytes over and
# over, and would take three times as long, most of it to get them again.
WORKER_ENVIRON = {
    "MALLOC_ARENA_MAX": "1",
    "MALLOC_TRIM_THRESHOLD_": str(512 * 2**20),
    "MALLOC_MMAP_THRESHOLD_": str(32 * 2**20),
}
# GDAL's files and a run's kept tiles are for one thread at a time.
_one_at_a_time = threading.Lock()


def do_on_dask(
    work: Work, parts: Parts, groups: dict[int, Sequence[Any]], where: str
) -> Iterator[int]:
    """Do parts on Dask's workers, each of which writes its own.

    A worker that ends leaves its part to another. A part that ends several workers is an error.

    Parameters
    ----------
    work : Work
        What is done.
    parts : Parts
        Where parts are kept: a folder that all workers see by this name.
    groups : dict
        Number to items of each part.
    where : str
        "local", a number of processes, or a scheduler's address.

    Yields
    ------
    number : int
        Of each part that is done.

    Raises
    ------
    ConfigError
        If Dask is not installed, or there is no such cluster.
    RunError
        If a part cannot be done.
    """
    distributed = _distributed()
    with _client(distributed, where) as client:
        _check_workers(client, where)
        shared = client.scatter((work, parts), broadcast=False)
        left = iter(groups.items())

        def submit(number: int, items: Sequence[Any]) -> Any:
            return client.submit(
                _do, shared, number, items, key=f"part-{number}-{id(shared)}", pure=False
            )

        running = distributed.as_completed([submit(*one) for one in islice(left, _WAITING)])
        for future in running:
            try:
                yield future.result()
            except distributed.KilledWorker as error:
                raise RunError(
                    f"part {future.key.split('-')[1]} ended every worker that tried it; give them "
                    "more memory, and look at their logs"
                ) from error
            for one in islice(left, 1):
                running.add(submit(*one))


def _do(shared: tuple[Work, Parts], number: int, items: Sequence[Any]) -> int:
    """Do one part in a worker."""
    from distributed import get_worker

    work, parts = shared
    with _one_at_a_time:
        # The worker's threads do one part together. Dask would give torch one of them.
        if torch := sys.modules.get("torch"):
            torch.set_num_threads(get_worker().state.nthreads)
        return do_part(work, parts, number, items)


@contextlib.contextmanager
def _client(distributed: Any, where: str) -> Iterator[Any]:
    """A client of a cluster: this machine's processes, or the one at an address."""
    if "://" in where:
        try:
            client = distributed.Client(where, timeout=_WAIT_S)
        except (OSError, ValueError) as error:
            raise ConfigError(
                f"no Dask scheduler answers at {where!r} ({_first(error)}); start one (dask "
                "scheduler), or start processes here (--dask local)"
            ) from error
        with client:
            yield client
        return
    processors = thread_count(None)
    if where != "local" and not (where.isascii() and where.isdigit() and int(where) > 0):
        raise ConfigError(
            f"dask is {where!r}; it must be local, a number of processes, or a scheduler's address "
            "such as tcp://host:8786"
        )
    processes = processors if where == "local" else int(where)
    with (
        _set_in_dask({"distributed.nanny.pre-spawn-environ": WORKER_ENVIRON}),
        distributed.LocalCluster(
            n_workers=processes,
            threads_per_worker=max(1, processors // processes),
            processes=True,
            dashboard_address=None,
            # The system's own limit is enough: Dask would end processes that only read a map.
            memory_limit=0,
            silence_logs=logging.CRITICAL,
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


def _set_in_dask(settings: dict[str, Any]) -> Any:
    import dask

    return dask.config.set(settings)


def _check_workers(client: Any, where: str) -> None:
    """See that there are workers, with this version of slicemask."""
    try:
        client.wait_for_workers(1, timeout=_WAIT_S)
    except TimeoutError as error:
        raise ConfigError(
            f"no worker has come to {where!r} within {_WAIT_S} s; start some: dask worker {where}"
        ) from error
    for worker, version in client.run(_version, on_error="return").items():
        if isinstance(version, Exception):
            raise ConfigError(
                f"worker {worker} cannot import slicemask ({_first(version)}); install it there"
            )
        if version != __version__:
            raise ConfigError(
                f"worker {worker} has slicemask {version}; expected {__version__}, as here: "
                "install the same one everywhere"
            )


def _version() -> str:
    from slicemask._version import __version__

    return __version__


def _distributed() -> Any:
    try:
        import distributed
    except ImportError as error:
        raise ConfigError(
            f"--dask needs Dask distributed, which cannot be imported ({error}); install: "
            "pip install 'slicemask[maps,dask]'"
        ) from error
    return distributed


def _first(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]
