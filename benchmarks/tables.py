"""The figures: one function a table, each with its targets and its peers in the same run."""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from unittest.mock import patch

import numpy as np

from benchmarks.answers import answers
from benchmarks.bands import bands
from benchmarks.figure import Figure
from benchmarks.gpu import gpu
from benchmarks.peers import exactextract_masks, plain_loop_seconds, random_slices
from benchmarks.scoring import scoring
from benchmarks.timing import (
    in_turn,
    median_seconds,
    slicemask_command,
    slicemask_commands,
    times,
)
from slicemask import Frustum, PoseGrid, open_bank, slice_masks
from slicemask.geometry import masks
from slicemask.geometry.masks import Engine

DEFAULT = ("build", "--grid", "21x21x64", "--hfov", "360", "--force")
DEFAULT_MASKS = 451_584
MIB_PER_GIB = 1024


def bank() -> list[Figure]:
    """The default bank: time, size, memory, against a plain loop and exactextract."""
    figures = []
    with tempfile.TemporaryDirectory() as folder:
        build = slicemask_command(*DEFAULT, "--cache", folder)
        figures.append(Figure("build 21x21x64, whole command", str(build), "aim 3 s",
                              build.seconds <= 3))  # fmt: skip
        sample = 200
        plain = plain_loop_seconds(sample) * DEFAULT_MASKS
        figures.append(Figure(
            f"plain per-cell Shapely loop, {sample} masks scaled to {DEFAULT_MASKS:,}",
            f"{plain:,.0f} s, {plain / build.seconds:,.0f} times the build",
            "200 times", plain / build.seconds >= 200,
        ))  # fmt: skip
        sample = 2000
        peer = exactextract_masks(sample)[0] * DEFAULT_MASKS
        figures.append(Figure(
            f"exactextract 0.3.0, {sample:,} polygons scaled to {DEFAULT_MASKS:,}",
            f"{peer:,.1f} s, {peer / build.seconds:,.1f} times the build",
            "10 times", peer / build.seconds >= 10,
        ))  # fmt: skip
        (path,) = Path(folder).glob("*.h5")
        size = path.stat().st_size / 1e6
        figures.append(Figure("the bank on disk", f"{size:.2f} MB", "8 MB", size <= 8))
        seconds = median_seconds(lambda: open_bank(path).csr())
        figures.append(Figure("opening it and holding its CSR", f"{seconds:.3f} s", "0.1 s",
                              seconds <= 0.1))  # fmt: skip
        large = slicemask_command("build", "--grid", "64x64x64", "--cache", folder, runs=1)
        for grid, peak, most in (
            ("21x21x64", build.peak_mib, 0.6),
            ("64x64x64", large.peak_mib, 1),
        ):
            figures.append(Figure(f"peak memory of build {grid}", f"{peak / MIB_PER_GIB:.2f} GiB",
                                  f"{most} GiB", peak <= most * MIB_PER_GIB))  # fmt: skip
    return figures


def engine() -> list[Figure]:
    """The closed form: one mask, whole builds, ground-truth masks, against its peers.

    What runs on one thread is given in processor time, which other work on the machine hardly
    touches; whole commands in wall time.
    """
    figures = _public_masks()
    with tempfile.TemporaryDirectory() as folder:
        default, closed = slicemask_commands(
            (*DEFAULT, "--cache", folder),
            (*DEFAULT, "--engine", "rays", "--cache", folder),
            runs=7,
        )
    ratio = times(default.runs, closed.runs)
    figures.append(Figure("build 21x21x64 --engine rays, whole command",
                          str(closed), "1.0 s", closed.seconds <= 1))  # fmt: skip
    figures.append(Figure("the default engine, in turn",
                          f"{default}, {ratio:.1f} times",
                          "3 times", ratio >= 3))  # fmt: skip
    poses = np.column_stack([*np.random.default_rng(0).random((2, 64)), np.arange(64) * 5.625])
    seconds = median_seconds(
        lambda: slice_masks(poses, Frustum(), 32, "rays"), clock=time.process_time
    )
    seconds /= len(poses)
    figures.append(Figure("dense masks of a pose, NumPy, one thread, batch of 64, 16 slices",
                          f"{seconds * 1e3:.2f} ms", "0.3 ms", seconds <= 3e-4))  # fmt: skip
    figures += _bands_on_the_fly()
    seconds = _torch_seconds(poses) / len(poses)
    figures.append(Figure("the same on torch CPU, one thread, forward and backward",
                          f"{seconds * 1e3:.2f} ms", "1 ms", seconds <= 1e-3))  # fmt: skip
    return figures


def _public_masks() -> list[Figure]:
    """Masks as users call for them, in fresh memory, against exactextract's, in turn."""
    assert masks._compiled() is not None, "numba is missing: pip install '.[bench]'"
    figures = []
    for count, runs in ((64, 25), (1_000, 11), (10_000, 5), (100_000, 3)):
        u, v, left_deg, _ = random_slices(count)
        poses, frustum = np.column_stack([u, v, left_deg + 11.25]), Frustum(22.5, 1)
        # What exactextract takes for a mask does not depend on how many there are.
        sample = min(count, 1_000)

        def mask_seconds(engine: Engine, some: np.ndarray, frustum: Frustum = frustum) -> float:
            start = time.process_time()
            slice_masks(some, frustum, 32, engine)
            return (time.process_time() - start) / len(some)

        def numpy_seconds(poses: np.ndarray = poses) -> float:
            with patch.object(masks, "_compiled", return_value=None):
                return mask_seconds("rays", poses)

        works = [
            lambda: mask_seconds("rays", poses),  # noqa: B023
            lambda: exactextract_masks(sample)[0],  # noqa: B023
        ]
        if count == 1_000:
            ours = slice_masks(poses, frustum, 32, "rays")[:, 0]
            # Its coverage is float32.
            assert np.abs(exactextract_masks(count)[1] - ours).max() < 1e-6
            works += [numpy_seconds, lambda: mask_seconds("shapely", poses)]  # noqa: B023
        ours, peer, *others = in_turn(*works, runs=runs)
        ratio = times(peer, ours)
        figures.append(Figure(
            f"slice_masks(engine='rays'), {count:,} masks of 32x32, one thread",
            f"{median(ours) * 1e6:.1f} us a mask, exactextract 0.3.0 {median(peer) * 1e6:.0f} us: "
            f"{ratio:.1f} times", "10 times", ratio >= 10,
        ))  # fmt: skip
        for name, theirs in zip(("without numba", "the Shapely engine"), others, strict=False):
            figures.append(Figure(
                f"{name}, on the same slices, in turn",
                f"{median(theirs) * 1e6:.1f} us, {times(theirs, ours):.1f} times",
            ))  # fmt: skip
    return figures


def _bands_on_the_fly() -> list[Figure]:
    """Masks of poses that no bank holds, in an array that is kept from call to call."""
    poses = np.random.default_rng(0).random((500, 3)) * [1.0, 1.0, 360.0]
    frustum = Frustum(bands=(0.08, 0.17, 0.33))
    out = slice_masks(poses, frustum, 32, "rays")

    def seconds() -> float:
        return median_seconds(
            lambda: slice_masks(poses, frustum, 32, "rays", out=out), clock=time.process_time
        )

    ours = seconds()
    with patch.object(masks, "_compiled", return_value=None):
        plain = seconds()
    return [
        Figure(
            "500 poses, 16 slices of 4 bands, 32x32, NumPy, one thread, out=",
            f"{ours * 1e3:.0f} ms, {ours / out[..., 0, 0].size * 1e6:.1f} us a mask",
            "40 ms", ours <= 0.04,
        ),
        Figure("the same without numba", f"{plain * 1e3:.0f} ms, {plain / ours:.1f} times"),
    ]  # fmt: skip


def _torch_seconds(poses: np.ndarray) -> float:
    import torch

    torch.set_num_threads(1)
    tensor = torch.tensor(poses, requires_grad=True)

    def forward_and_backward() -> None:
        tensor.grad = None
        slice_masks(tensor, Frustum(), 32, "rays").sum().backward()

    return median_seconds(forward_and_backward, clock=time.process_time)


def million() -> list[Figure]:
    """A million poses to a bank on disk, by both engines."""
    figures = []
    with tempfile.TemporaryDirectory() as folder:
        grid = ("build", "--grid", "128x128x64", "--force", "--cache", folder)
        closed = slicemask_command(*grid, "--engine", "rays", runs=1)
        default = slicemask_command(*grid, runs=1)
    gib = closed.peak_mib / MIB_PER_GIB
    figures.append(Figure("build 128x128x64 --engine rays (1,048,576 poses)",
                          f"{closed.seconds:.1f} s", "60 s", closed.seconds <= 60))  # fmt: skip
    figures.append(Figure("its peak memory", f"{gib:.2f} GiB", "1.5 GiB", gib <= 1.5))
    gib = default.peak_mib / MIB_PER_GIB
    figures.append(Figure("the default engine on the same grid",
                          f"{default.seconds:.1f} s, {gib:.2f} GiB"))  # fmt: skip
    return figures


def growth() -> list[Figure]:
    """Time and bytes against the number of poses, by both engines; draws them into docs/images."""
    from benchmarks.curves import draw

    grids = ("7x7x16", "14x14x32", "21x21x64", "32x32x64", "64x64x64", "128x128x64")
    rows: dict[str, list[tuple[int, int, float, float]]] = {"shapely": [], "rays": []}
    with tempfile.TemporaryDirectory() as folder:
        for engine_name, points in rows.items():
            for grid in grids:
                poses = len(PoseGrid.parse(grid))
                path = Path(folder) / "bank.h5"
                cost = slicemask_command(
                    "build", "--grid", grid, "--engine", engine_name, "--out", str(path), "--force",
                    runs=1 if poses > 300_000 else 3,
                )  # fmt: skip
                with open_bank(path, check=False) as opened:
                    masks = opened.rows
                points.append((poses, masks, cost.seconds, path.stat().st_size / 1e6))
    draw(rows)
    figures = []
    for engine_name, points in rows.items():
        for poses, masks, seconds, megabytes in points:
            figures.append(Figure(f"{engine_name}: {poses:,} poses, {masks:,} distinct masks",
                                  f"{seconds:.2f} s, {megabytes:.1f} MB"))  # fmt: skip
        masks, seconds = np.array([(m, s) for p, m, s, _ in points if p <= 262_144]).T
        slope, start = np.polyfit(masks, seconds, 1)
        straight = 1 - ((seconds - start - slope * masks) ** 2).sum() / seconds.var() / len(masks)
        figures.append(Figure(
            f"{engine_name}: straight line, 7x7x16 to 64x64x64",
            f"{start:.2f} s + {slope * 1e6:.0f} us a distinct mask, R2 {straight:.4f}",
            "R2 0.99", bool(straight >= 0.99),
        ))  # fmt: skip
    return figures


TABLES: dict[str, Callable[[], list[Figure]]] = {
    "answers": answers,
    "bank": bank,
    "engine": engine,
    "million": million,
    "growth": growth,
    "bands": bands,
    "scoring": scoring,
    "gpu": gpu,
}
