"""Whole answers on a processor: seconds and memory of each network, beside others' backbones."""

import statistics
import tempfile
from collections.abc import Iterable

from benchmarks.answer_cost import SIDES
from benchmarks.figure import Figure
from benchmarks.timing import module_output, slicemask_command

ROUNDS = 3
# What `--recipe fast` is to stay within: half of others' features, and the command's memory.
MOST_SHARE, MOST_BYTES = 0.5, 450e6


def answers() -> list[Figure]:
    """An answer among 28,224 poses, one thread: processor seconds a pair, and peak memory.

    Each side runs in a process of its own, in turns; memory includes the interpreter, torch and
    loading.
    """
    seconds: dict[str, list[float]] = {side: [] for side in SIDES}
    peaks: dict[str, list[float]] = {side: [] for side in SIDES}
    with tempfile.TemporaryDirectory() as cache:
        for side in SIDES:  # builds the banks, which answers find in the cache
            module_output("benchmarks.answer_cost", side, cache)
        for _ in range(ROUNDS):
            for side in SIDES:
                found = module_output("benchmarks.answer_cost", side, cache)
                seconds[side] += found["seconds"]
                peaks[side].append(found["peak_bytes"])
        command = slicemask_command("predict", "generated-city", "--example", "1",
                                    "--cache", cache, runs=ROUNDS)  # fmt: skip
    peak = command.peak_mib * 2**20
    return [
        *_figures(seconds, peaks),
        Figure("slicemask predict generated-city --example 1, whole command",
               f"{command}, {peak / 1e6:,.0f} MB", f"{MOST_BYTES / 1e6:.0f} MB",
               peak <= MOST_BYTES),
    ]  # fmt: skip


def _figures(seconds: dict[str, list[float]], peaks: dict[str, list[float]]) -> Iterable[Figure]:
    peers = statistics.median(seconds["peers"])
    for side, (label, _) in SIDES.items():
        cost, peak = statistics.median(seconds[side]), statistics.median(peaks[side])
        text = f"{cost:.3f} s, {cost / peers:.1f} times others' features, {peak / 1e6:,.0f} MB"
        if side == "fast":
            yield Figure(label, text, f"{MOST_SHARE} times", cost <= MOST_SHARE * peers)
        else:
            yield Figure(label, text)
