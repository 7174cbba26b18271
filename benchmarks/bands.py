"""What bands of range cost, against the same without bands in the same run."""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from slicematch.network.aggregation import unit
from slicematch.scoring.candidates import Candidates
from slicematch.scoring.scores import score_candidates

from benchmarks.figure import Figure
from benchmarks.timing import in_turn, slicemask_commands, times
from slicemask import Frustum, open_bank, slice_masks

RANGES = (0.08, 0.17, 0.33)
# Of the encoder of benchmarks/learning.py, and of VGG16.
CHANNELS = (48, 512)


def bands() -> list[Figure]:
    """Four bands of range, against slices without bands."""
    figures = []
    with tempfile.TemporaryDirectory() as folder:
        banks = {}
        for engine in ("shapely", "rays"):
            commands = []
            for banded in (False, True):
                path = banks[engine, banded] = Path(folder) / f"{engine}{banded}.h5"
                cut = ("--bands", ",".join(map(str, RANGES))) if banded else ()
                commands.append(("build", "--grid", "21x21x64", "--engine", engine, *cut,
                                 "--out", str(path), "--force"))  # fmt: skip
            plain, banded_cost = slicemask_commands(*commands, runs=7)
            ratio = times(banded_cost.runs, plain.runs)
            figures.append(Figure(
                f"build 21x21x64 --engine {engine} with 4 bands, whole command",
                f"{banded_cost.seconds:.2f} s, {ratio:.2f} times {plain.seconds:.2f} s",
                "3 times", ratio <= 3,
            ))  # fmt: skip
        sizes = [banks["shapely", banded].stat().st_size / 1e6 for banded in (False, True)]
        figures.append(Figure(
            "its bank on disk",
            f"{sizes[1]:.2f} MB, {sizes[1] / sizes[0]:.2f} times {sizes[0]:.2f} MB",
            "2 times", sizes[1] <= 2 * sizes[0],
        ))  # fmt: skip
        figures += _masks()
        figures += _scores([banks["rays", banded] for banded in (False, True)])
    return figures


def _masks() -> list[Figure]:
    """One mask by the closed form: a band's against a slice's."""
    rng = np.random.default_rng(0)
    poses = np.column_stack([rng.random((32, 2)), rng.uniform(0, 360, 32)])
    tensor = torch.from_numpy(poses)
    torch.set_num_threads(1)
    figures = []
    for kind, hfov_deg in (("equirectangular", 360.0), ("pinhole", 81.5)):
        plain = Frustum(hfov_deg, 16, kind)  # type: ignore[arg-type]
        cut = Frustum(hfov_deg, 16, kind, RANGES)  # type: ignore[arg-type]
        for library, some in (("NumPy", poses), ("torch", tensor)):
            slow, fast = in_turn(
                *(_seconds(lambda f=f, some=some: slice_masks(some, f, 32, "rays"))
                  for f in (cut, plain)),
                runs=9,
            )  # fmt: skip
            ratio = times(slow, fast) / cut.band_count
            figures.append(Figure(
                f"one banded mask by the closed form, {kind}, {library}",
                f"{ratio:.2f} times one without bands", "4 times", ratio <= 4,
            ))  # fmt: skip
    return figures


def _scores(banks: list[Path]) -> list[Figure]:
    """Scores of 28,224 poses without cross-view attention, one pair, one thread."""
    torch.set_num_threads(1)
    candidates = []
    for path in banks:
        with open_bank(path) as bank:
            candidates.append(Candidates.from_bank(bank))
    figures = []
    for shared in (True, False):
        for channels in CHANNELS:
            works = []
            for some in candidates:
                parts = some.index.shape[1] * some.index.shape[2]
                generator = torch.Generator().manual_seed(0)
                ground = unit(torch.rand(1, parts, channels, generator=generator))
                features = torch.randn(1, channels, 32, 32, generator=generator).relu()
                maps = 1 if shared else parts
                attention = torch.rand(1, maps, 32, 32, generator=generator)
                arguments = ground, features, attention, some
                works.append(_seconds(lambda arguments=arguments: _score(*arguments)))
            plain, banded = in_turn(*works, runs=7)
            ratio = times(banded, plain)
            attention_kind = "one attention map" if shared else "cross-view attention"
            figures.append(Figure(
                f"scores of 28,224 poses, C = {channels}, {attention_kind}",
                f"{1e3 * float(np.median(banded)):.0f} ms, {ratio:.2f} times "
                f"{1e3 * float(np.median(plain)):.0f} ms",
                "2.5 times", ratio <= 2.5,
            ))  # fmt: skip
    return figures


@torch.no_grad()
def _score(*arguments: object) -> None:
    score_candidates(*arguments)  # type: ignore[arg-type]


def _seconds(work: Callable[[], object]) -> Callable[[], float]:
    """Processor seconds of a call: what other work does to the clock is left out."""

    def seconds() -> float:
        start = time.process_time()
        work()
        return time.process_time() - start

    return seconds
