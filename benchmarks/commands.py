"""Commands as users type them, and what they cost."""

import os
import resource
import subprocess
import sys
import time

import click


def slicemask(*arguments: str, threads: int | None = None) -> dict[str, float]:
    """Run a command of slicemask; arguments as typed after its name."""
    return python_module("slicemask", *arguments, threads=threads)


def python_module(name: str, *arguments: str, threads: int | None = None) -> dict[str, float]:
    """Run a module as ``python -m`` does.

    Parameters
    ----------
    name
        Of the module.
    arguments
        As typed after it.
    threads
        Of torch; as the environment has it by default.

    Returns
    -------
    dict
        ``wall_s`` and ``processor_s``, whole seconds.
    """
    click.echo(" ".join((name, *arguments)), err=True)
    environment = os.environ | ({} if threads is None else {"OMP_NUM_THREADS": str(threads)})
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run([sys.executable, "-m", name, *arguments], check=True, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"wall_s": round(time.perf_counter() - start), "processor_s": round(processor)}
