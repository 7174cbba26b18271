"""A whole pair on a GPU, and what scoring takes there as the poses grow."""

import tempfile
from typing import Any

import torch
from slicematch.evaluation.timing import median_seconds, time_settings
from slicematch.scoring.candidates import Candidates
from slicematch.scoring.scores import score_candidates

from benchmarks.figure import Figure
from benchmarks.scoring import GRIDS, random_pair
from slicemask import Frustum, PoseGrid, build_bank, open_bank

FRAMES_PER_SECOND = 500  # wanted at the default grid, float32, one pair at a time
RUNS = 21


def gpu() -> list[Figure]:
    """Pairs on a GPU, VGG16's sizes. Nothing where there is no GPU."""
    if not torch.cuda.is_available():
        return []
    figures = [Figure("device", torch.cuda.get_device_name())]
    with tempfile.TemporaryDirectory() as folder:
        figures += [_pairs(grid, folder) for grid in GRIDS]
        for precision, batch_size in (("32-true", 8), ("bf16-mixed", 1), ("bf16-mixed", 8)):
            figures.append(_pairs("21x21x64", folder, precision=precision, batch_size=batch_size))
        figures.append(_against_plain(folder))
    return figures


def _pairs(grid: str, folder: str, **settings: Any) -> Figure:
    """All stages at one grid."""
    torch.cuda.reset_peak_memory_stats()
    cost = time_settings(grid=grid, device="cuda", cache=folder, runs=RUNS, **settings)
    whole = cost.encode_s + cost.aggregate_s + cost.score_s
    measured = (
        f"{cost.frames_per_second:,.0f} frames a second; {cost.encode_s * 1e3:.2f} ms to encode, "
        f"{cost.aggregate_s * 1e3:.2f} ms to aggregate, {cost.score_s * 1e3:.2f} ms to score "
        f"({cost.score_s / whole:.0%}); at most {torch.cuda.max_memory_allocated() / 1e6:,.0f} MB "
        "in all"
    )
    if settings:
        what = f"{cost.poses:,} poses, encoders {cost.precision}, batches of {cost.batch_size}"
        return Figure(what, measured)
    what = f"{cost.poses:,} poses"
    if grid != "21x21x64":
        return Figure(what, measured)
    fast = cost.frames_per_second >= FRAMES_PER_SECOND
    return Figure(what, measured, f"{FRAMES_PER_SECOND} frames a second", fast)


def _against_plain(folder: str) -> Figure:
    """Scoring by the kernel, and by plain torch operations in blocks of several sizes."""
    with open_bank(build_bank(PoseGrid.parse("21x21x64"), Frustum(), cache=folder).path) as bank:
        candidates = Candidates.from_bank(bank, "cuda")
    pair = [x.cuda() for x in random_pair()]
    device = torch.device("cuda")
    kernel, expected = median_seconds(lambda: score_candidates(*pair, candidates), RUNS, device)
    seconds = {}
    for values in (1 << 22, 1 << 24, 1 << 26):
        seconds[values], scores = median_seconds(
            lambda values=values: score_candidates(*pair, candidates, values),
            RUNS,
            device,
        )
        torch.testing.assert_close(scores, expected, rtol=1e-4, atol=1e-6)
    plain = ", ".join(f"{s * 1e3:.2f} ms in blocks of {v:,}" for v, s in seconds.items())
    return Figure(
        "scoring 28,224 poses by the kernel, and by plain operations",
        f"{kernel * 1e3:.2f} ms; {plain}: {min(seconds.values()) / kernel:.1f} times the kernel",
    )
