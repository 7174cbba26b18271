"""A whole pair on a GPU, and what scoring takes there as the poses grow."""

import tempfile

import torch

from benchmarks.figure import Figure
from benchmarks.scoring import GRIDS
from model.benchmark import time_settings

FRAMES_PER_SECOND = 500  # wanted at the default grid


def gpu() -> list[Figure]:
    """One pair at a time on a GPU, VGG16's sizes, float32.

    Nothing where there is no GPU.
    """
    if not torch.cuda.is_available():
        return []
    figures = [Figure("device", torch.cuda.get_device_name())]
    with tempfile.TemporaryDirectory() as folder:
        figures += [_pair(grid, folder) for grid in GRIDS]
    return figures


def _pair(grid: str, folder: str) -> Figure:
    """All stages at one grid."""
    torch.cuda.reset_peak_memory_stats()
    cost = time_settings(grid=grid, device="cuda", cache=folder, runs=21)
    whole = cost.encode_s + cost.aggregate_s + cost.score_s
    measured = (
        f"{cost.frames_per_second:,.0f} frames a second; {cost.encode_s * 1e3:.2f} ms to encode, "
        f"{cost.aggregate_s * 1e3:.2f} ms to aggregate, {cost.score_s * 1e3:.2f} ms to score "
        f"({cost.score_s / whole:.0%}); at most {torch.cuda.max_memory_allocated() / 1e6:,.0f} MB "
        "in all"
    )
    what = f"{cost.poses:,} poses"
    if grid != "21x21x64":
        return Figure(what, measured)
    fast = cost.frames_per_second >= FRAMES_PER_SECOND
    return Figure(what, measured, f"{FRAMES_PER_SECOND} frames a second", fast)
