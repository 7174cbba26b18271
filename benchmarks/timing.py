"""Timing commands and functions, on machines that are never quiet.

What is to be compared runs in turn, A B A B, so that both sides meet the same disturbances;
figures are medians, and ratios medians of the pairs' ratios.
"""

import os
import re
import select
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

# What the installed `slicemask` script runs; modules are found compiled, as they are for it.
_SCRIPT = "from cli import main; main()"
_ENVIRONMENT = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}


@dataclass(frozen=True)
class CommandCost:
    """Wall seconds of a command's runs, and the largest peak memory of them, in MiB."""

    runs: tuple[float, ...]
    peak_mib: float

    @property
    def seconds(self) -> float:
        """The median."""
        return statistics.median(self.runs)


def slicemask_command(*arguments: str, runs: int = 5) -> CommandCost:
    """Cost of a whole ``slicemask`` command, the interpreter's start included."""
    return slicemask_commands(arguments, runs=runs)[0]


def slicemask_commands(*commands: tuple[str, ...], runs: int) -> list[CommandCost]:
    """Costs of whole ``slicemask`` commands, run in turn."""
    costs: list[list[tuple[float, float]]] = [[] for _ in commands]
    for _ in range(runs):
        for command, cost in zip(commands, costs, strict=True):
            cost.append(_run(command))
    return [CommandCost(tuple(s for s, _ in cost), max(peak for _, peak in cost)) for cost in costs]


def _run(arguments: tuple[str, ...]) -> tuple[float, float]:
    """Wall seconds and peak memory of one run, in MiB."""
    peak = 0.0
    start = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-c", _SCRIPT, *arguments], stdout=subprocess.DEVNULL, env=_ENVIRONMENT
    )
    ended = os.pidfd_open(process.pid)
    while not select.select([ended], [], [], 0.01)[0]:
        peak = max(peak, _peak_mib(process.pid))
    seconds = time.perf_counter() - start
    os.close(ended)
    if process.wait():
        raise SystemExit(f"slicemask {' '.join(arguments)} failed")
    return seconds, peak


def _peak_mib(process: int) -> float:
    """Peak memory of a process so far; not its maxrss, which it takes over from its parent."""
    status = Path(f"/proc/{process}/status").read_text()
    found = re.search(r"VmHWM:\s*(\d+) kB", status)
    return int(found[1]) / 1024 if found else 0.0


def in_turn(*works: Callable[[], float], runs: int) -> list[list[float]]:
    """Seconds that each of the works says it took, in turn, after one round that is not counted."""
    rounds = [[work() for work in works] for _ in range(runs + 1)]
    return [list(seconds) for seconds in zip(*rounds[1:], strict=True)]


def times(slow: list[float] | tuple[float, ...], fast: list[float] | tuple[float, ...]) -> float:
    """How many times faster: the median of the ratios of runs in turn."""
    return statistics.median(s / f for s, f in zip(slow, fast, strict=True))


def median_seconds(work: Callable[[], object], runs: int = 7) -> float:
    """Median seconds of a call, after one that is not counted."""

    def seconds() -> float:
        start = time.perf_counter()
        work()
        return time.perf_counter() - start

    return statistics.median(in_turn(seconds, runs=runs)[0])
