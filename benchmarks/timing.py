"""Timing commands and functions: medians of several runs, on machines that are never quiet."""

import re
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


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
        peak = 0.0
        while process.poll() is None:
            peak = max(peak, _peak_mib(process.pid))
            time.sleep(0.01)
        seconds.append(time.perf_counter() - start)
        if process.returncode:
            raise SystemExit(f"slicemask {' '.join(arguments)} failed")
        peaks.append(peak)
    return CommandCost(statistics.median(seconds), max(peaks))


def _peak_mib(process: int) -> float:
    """Peak memory of a process so far; not its maxrss, which it takes over from its parent."""
    status = Path(f"/proc/{process}/status").read_text()
    found = re.search(r"VmHWM:\s*(\d+) kB", status)
    return int(found[1]) / 1024 if found else 0.0


def median_seconds(work: Callable[[], object], runs: int = 7) -> float:
    """Median seconds of a call, after one that is not counted."""
    work()
    seconds = []
    for _ in range(runs):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds)
