"""Timing commands and functions, on machines that are never quiet.

What is to be compared runs in turn, A B A B, so that both sides meet the same disturbances;
figures are medians, and ratios medians of the pairs' ratios.
"""

import json
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
from typing import Any

# What the installed `slicemask` script runs; modules are found compiled, as they are for it.
_SCRIPT = "from slicemask.cli.main import main; main()"
_ENVIRONMENT = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}


@dataclass(frozen=True)
class CommandCost:
    """A command's runs: wall seconds, processor seconds, and the largest peak memory, in MiB."""

    runs: tuple[float, ...]
    processor: tuple[float, ...]
    peak_mib: float

    @property
    def seconds(self) -> float:
        """The median wall seconds."""
        return statistics.median(self.runs)

    def __str__(self) -> str:
        work = statistics.median(self.processor)
        return f"{self.seconds:.2f} s ({work:.2f} s of processor time)"


def slicemask_command(*arguments: str, runs: int = 5) -> CommandCost:
    """Cost of a whole ``slicemask`` command, the interpreter's start included."""
    return slicemask_commands(arguments, runs=runs)[0]


def slicemask_commands(*commands: tuple[str, ...], runs: int) -> list[CommandCost]:
    """Costs of whole ``slicemask`` commands, run in turn."""
    rounds = [[_run(command) for command in commands] for _ in range(runs)]
    costs = []
    for of_command in zip(*rounds, strict=True):
        seconds, processor, peaks = zip(*of_command, strict=True)
        costs.append(CommandCost(seconds, processor, max(peaks)))
    return costs


def module_output(name: str, *arguments: str) -> Any:
    """What a module prints as JSON, run in a process of its own as ``python -m`` does."""
    process = subprocess.run(
        [sys.executable, "-m", name, *arguments], stdout=subprocess.PIPE, check=True
    )
    return json.loads(process.stdout)


def _run(arguments: tuple[str, ...]) -> tuple[float, float, float]:
    """Wall seconds, processor seconds and peak memory (MiB) of one run."""
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
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"slicemask {' '.join(arguments)} failed")
    return seconds, used.ru_utime + used.ru_stime, peak


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


def median_seconds(
    work: Callable[[], object], runs: int = 7, clock: Callable[[], float] = time.perf_counter
) -> float:
    """Median seconds of a call, after one that is not counted."""

    def seconds() -> float:
        start = clock()
        work()
        return clock() - start

    return statistics.median(in_turn(seconds, runs=runs)[0])
