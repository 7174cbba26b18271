"""Scoring against the encoders, and against other ways to the same scores."""

import copy
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from slicematch.network.aggregation import unit
from slicematch.network.slicematch import SliceMatch
from slicematch.scoring.candidates import Candidates
from slicematch.scoring.scores import score_candidates, score_masks
from slicematch.training.losses import contrastive_loss
from torch import Tensor

from benchmarks.figure import Figure
from benchmarks.timing import module_output, slicemask_command
from slicemask import Frustum, open_bank, slice_masks

SLICES, CHANNELS, CELLS = 16, 512, 32  # VGG16's
GRIDS = {"7x7x16": 784, "21x21x64": 28_224, "64x64x64": 262_144, "128x128x64": 1_048_576}


def scoring() -> list[Figure]:
    """Scores of one pair, VGG16's sizes, one thread: against the encoders, dense and CSR."""
    from benchmarks.curves import draw_scoring

    # Seconds of the processor, on one thread: what other work does to the clock is left out.
    torch.set_num_threads(1)
    torch.manual_seed(0)
    model = SliceMatch("vgg16", "none")
    figures = []
    with tempfile.TemporaryDirectory() as folder:
        banks = {grid: Path(folder) / f"{grid}.h5" for grid in GRIDS}
        for grid, path in banks.items():
            slicemask_command(
                "build", "--grid", grid, "--engine", "rays", "--out", str(path), runs=1
            )
        figures += _against_peers(model, banks["21x21x64"])
        costs = {GRIDS[grid]: _cost(path) for grid, path in banks.items()}
        figures += _growth(costs)
        draw_scoring({poses: (cost["seconds"], cost["peak"]) for poses, cost in costs.items()})
        figures += _training(model, banks["7x7x16"])
    return figures


def random_pair() -> tuple[Tensor, Tensor, Tensor]:
    """Ground descriptors, features as after a ReLU, and attention, for a batch of one."""
    generator = torch.Generator().manual_seed(0)
    ground = unit(torch.rand(1, SLICES, CHANNELS, generator=generator))
    features = torch.randn(1, CHANNELS, CELLS, CELLS, generator=generator).relu()
    return ground, features, torch.rand(1, SLICES, CELLS, CELLS, generator=generator)


def _against_peers(model: SliceMatch, bank: Path) -> list[Figure]:
    candidates = _candidates(bank)
    model = copy.deepcopy(model).for_inference(torch.device("cpu"))
    pair = random_pair()
    images = torch.randn(1, 3, 320, 640), torch.randn(1, 3, 512, 512)
    rows = _csr_rows(bank)
    with open_bank(bank) as opened:
        # One heading of each place: a sample of the dense product, whose cost is the same for all.
        masks = torch.from_numpy(opened.masks(range(0, len(opened), 64))).float()
    share = len(masks) / len(candidates.poses)
    ways: dict[str, Callable[[], object]] = {
        "encoders": lambda: (model.ground_encoder(images[0]), model.aerial_encoder(images[1])),
        "ours": lambda: score_candidates(*pair, candidates),
        "CSR": lambda: _csr_scores(*pair, candidates, rows),
        "dense": lambda: [score_masks(*pair, some[None]) for some in masks.split(64)],
    }
    with torch.no_grad():
        found, peer = ways["ours"](), ways["CSR"]()
        dense = torch.cat(ways["dense"](), dim=1)
        assert torch.allclose(found, peer, rtol=1e-4, atol=0)
        assert torch.allclose(found[:, ::64], dense, rtol=1e-4, atol=0)
        seconds = _alternate(ways, rounds=5)
    seconds["dense"] /= share
    ours = seconds["ours"]
    ratio = ours / seconds["encoders"]
    return [
        Figure("VGG16, forward, of one pair", f"{seconds['encoders']:.2f} s"),
        Figure(
            "scoring 28,224 poses",
            f"{ours:.2f} s, {ratio:.2f} times the encoders",
            "at most 1.0, aim 0.5", ratio <= 1,
        ),
        Figure(
            f"dense product of eq. 4, {len(masks)} poses scaled to 28,224",
            f"{seconds['dense']:.2f} s, {seconds['dense'] / ours:.1f} times the scoring",
            "4 times", seconds["dense"] >= 4 * ours,
        ),
        Figure(
            "torch CSR product over the distinct masks",
            f"{seconds['CSR']:.2f} s, {seconds['CSR'] / ours:.1f} times the scoring",
            "2 times", seconds["CSR"] >= 2 * ours,
        ),
    ]  # fmt: skip


def _csr_rows(bank: Path, at_once: int = 2048) -> list[Tensor]:
    """All distinct masks of a bank, as torch CSR matrices of so many rows, 32-bit indices."""
    with open_bank(bank) as opened:
        csr = opened.csr()
    # Means instead of sums: of a hair of a cell, too, the descriptor is longer than its epsilon.
    areas = np.add.reduceat(np.append(csr.data, np.float32(0)), csr.indptr[:-1])
    csr.data /= np.repeat(areas, np.diff(csr.indptr))
    return [
        torch.sparse_csr_tensor(
            torch.from_numpy(some.indptr),
            torch.from_numpy(some.indices),
            torch.from_numpy(some.data),
            size=some.shape,
        )
        for some in (csr[start : start + at_once] for start in range(0, csr.shape[0], at_once))
    ]


def _csr_scores(
    ground: Tensor, features: Tensor, attention: Tensor, candidates: Candidates, rows: list[Tensor]
) -> Tensor:
    """The same scores: each slice number's attended features, times the CSR matrix of all masks."""
    dots = torch.zeros(1, len(candidates.index))
    there = torch.zeros_like(dots)
    for n in range(SLICES):
        attended = (features * attention[:, n, None]).flatten(2)[0].T.contiguous()
        descriptors = [unit(some @ attended) for some in rows]
        at = candidates.index[:, n, 0]  # no bands
        dots += torch.cat([some @ ground[0, n] for some in descriptors])[at]
        there += torch.cat([some.any(dim=-1) for some in descriptors])[at]
    return dots / (there.sqrt() * ground.square().sum().sqrt()).clamp(min=1e-30)


def _cost(bank: Path) -> dict[str, float]:
    """Seconds of the last call and of the first, and peak bytes."""
    found = module_output("benchmarks.score_bank", str(bank))
    return {
        "seconds": found["seconds"][-1],
        "first": found["seconds"][0],
        "peak": found["peak_bytes"],
    }


def _growth(costs: dict[int, dict[str, float]]) -> list[Figure]:
    figures = []
    for poses, cost in costs.items():
        most = {28_224: 400e6}.get(poses)
        figures.append(Figure(
            f"{poses:,} poses",
            f"{cost['seconds']:.2f} s (first call {cost['first']:.2f} s), extra memory "
            f"{cost['peak'] / 1e6:,.0f} MB",
            "" if most is None else f"{most / 1e6:.0f} MB",
            None if most is None else cost["peak"] <= most,
        ))  # fmt: skip
    return figures


def _training(model: SliceMatch, bank: Path, batch: int = 4) -> list[Figure]:
    """A training step without its optimiser: the encoders, and all that comes after them."""
    candidates = _candidates(bank)
    images = torch.randn(batch, 3, 320, 640), torch.randn(batch, 3, 512, 512)
    poses = torch.rand(batch, 3, dtype=torch.float64) * torch.tensor([1.0, 1.0, 360.0])
    frustum = Frustum()

    def encode() -> tuple[Tensor, Tensor]:
        return model.ground_encoder(images[0]), model.aerial_encoder(images[1])

    def encoders() -> None:
        sum(features.sum() for features in encode()).backward()

    with torch.no_grad():
        encoded = encode()
    ground_features, aerial = (features.detach().requires_grad_() for features in encoded)

    def rest() -> None:
        ground = model.ground_aggregator(ground_features)
        attention = model.attend(aerial, ground)
        masks = slice_masks(poses, frustum, CELLS, engine="rays")
        truth = score_masks(ground, aerial, attention, masks[:, None])[:, 0]
        scores = score_candidates(ground, aerial, attention, candidates)
        contrastive_loss(truth, scores).mean().backward()

    seconds = _alternate({"encoders": encoders, "rest": rest}, rounds=3)
    ratio = seconds["rest"] / seconds["encoders"]
    return [
        Figure(
            "training, batch of 4: the encoders, forward and backward",
            f"{seconds['encoders']:.1f} s",
        ),
        Figure(
            "all that comes after them, 784 poses",
            f"{seconds['rest']:.2f} s, {ratio:.3f} times the encoders",
            "at most 0.2", ratio <= 0.2,
        ),
    ]  # fmt: skip


def _candidates(bank: Path) -> Candidates:
    with open_bank(bank) as opened:
        return Candidates.from_bank(opened)


def _alternate(ways: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Median seconds of the processor for each way, taken in turns."""
    seconds: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(rounds):
        for name, way in ways.items():
            start = time.process_time()
            way()
            seconds[name].append(time.process_time() - start)
    return {name: statistics.median(times) for name, times in seconds.items()}
