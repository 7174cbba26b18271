"""Timing commands and functions: medians of several runs, on machines that are never quiet."""

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class CommandCost:
    """Median wall seconds of a command, and the largest peak memory of its runs, in MiB."""

    seconds: float
    peak_mib: float


def slicemask_command(*arguments: str, runs: int = 5) -> CommandCost:
    """Cost of a whole ``slicemask`` command, the interpreter's start included."""
    seconds, peaks = [], []
    for _ in range(runs):
        start = time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, "-m", "cli", *arguments], stdout=subprocess.DEVNULL
        )
        _, status, usage = os.wait4(process.pid, 0)
        seconds.append(time.perf_counter() - start)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise SystemExit(f"slicemask {' '.join(arguments)} failed")
        peaks.append(usage.ru_maxrss / 1024)
    return CommandCost(statistics.median(seconds), max(peaks))


def median_seconds(work: Callable[[], object], runs: int = 7) -> float:
    """Median seconds of a call, after one that is not counted."""
    work()
    seconds = []
    for _ in range(runs):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds)
