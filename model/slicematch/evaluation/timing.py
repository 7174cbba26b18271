"""What a pose estimate costs: encoding, aggregation and scoring, each timed apart."""

import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor

from slicemask import Frustum, PoseGrid, build_bank
from slicemask.bank.build import Progress
from slicemask.errors import is_out_of_memory
from slicematch.devices import choose_device, precision_note
from slicematch.errors import ConfigError
from slicematch.localization.localizer import Localizer
from slicematch.localization.members import load_candidates
from slicematch.network.bands import RangeBands
from slicematch.network.slicematch import SliceMatch
from slicematch.precision import Precision
from slicematch.runs.folder import Checkpoint
from slicematch.scoring.candidates import Candidates
from slicematch.scoring.scores import score_candidates

_PANORAMA = Frustum()


@dataclass(frozen=True)
class Timings:
    """Seconds of one batch, medians over the runs.

    Attributes
    ----------
    encode_s : float
        Both encoders: images to z_g and z_a.
    aggregate_s : float
        Ground descriptors (eq. 2) and cross-view attention (eq. 3).
    score_s : float
        Scores of all candidates (eq. 4 and the cosine).
    poses : int
        K.
    distinct_masks : int
        How many different masks the candidates have.
    batch_size : int
        Pairs in a batch.
    device : str
        Where it ran.
    precision : {"32-true", "16-mixed", "bf16-mixed"}
        In which the encoders computed.
    threads : int
        Threads of torch on the CPU.
    """

    encode_s: float
    aggregate_s: float
    score_s: float
    poses: int
    distinct_masks: int
    batch_size: int
    device: str
    precision: Precision
    threads: int

    @property
    def frames_per_second(self) -> float:
        """Pairs a second, all stages together."""
        return self.batch_size / (self.encode_s + self.aggregate_s + self.score_s)

    def as_dict(self) -> dict[str, Any]:
        """All figures by name."""
        return {**asdict(self), "frames_per_second": self.frames_per_second}

    def __str__(self) -> str:
        return self.report()

    def report(self) -> str:
        """The figures as a few lines of text."""
        stages = (
            ("encode", self.encode_s, "both encoders"),
            ("aggregate", self.aggregate_s, "ground descriptors, attention"),
            ("score", self.score_s, f"{self.poses:,} poses, {self.distinct_masks:,} masks"),
        )
        lines = [f"{name:<10}{1e3 * s:>10.1f} ms  {what}" for name, s, what in stages]
        where = self.device if self.device != "cpu" else f"cpu, {self.threads} threads"
        lines.append(
            f"{self.frames_per_second:.2f} frames a second ({where}, batches of {self.batch_size}"
            f"{precision_note(self.precision)})"
        )
        return "\n".join(lines)


def time_run(
    run: str | Path,
    *,
    grid: str | None = None,
    bank: str | Path | None = None,
    checkpoint: Checkpoint = "best",
    device: str = "auto",
    cache: str | Path | None = None,
    precision: Precision = "32-true",
    batch_size: int = 1,
    runs: int = 5,
) -> Timings:
    """Time a trained run on images of its size.

    Parameters
    ----------
    run : path
        A run folder.
    grid : str, optional
        Candidates such as "21x21x64"; the run's test grid by default.
    bank : path, optional
        A bank of candidates instead.
    checkpoint : {"best", "last"}
        Which weights.
    device : str
        "auto" (CUDA where it is there, else the CPU), "cpu", "cuda" or "cuda:N".
    cache : path, optional
        The folder of banks; SLICEMASK_CACHE or ``./masks_cache`` by default.
    precision : {"32-true", "16-mixed", "bf16-mixed"}
        In which the encoders compute.
    batch_size : int
        Pairs in a batch.
    runs : int
        Batches that are timed, after one that is not.

    Returns
    -------
    timings : Timings

    Raises
    ------
    RunError, ConfigError, BankError
        If run or bank cannot be loaded, or batch size or runs are below 1.
    """
    _check(batch_size, runs)
    loaded = Localizer.load(
        run,
        bank,
        checkpoint=checkpoint,
        grid=grid,
        device=device,
        cache=cache,
        precision=precision,
        alone=True,
    )
    ground_size = cast(tuple[int, int], loaded.config.ground_size)
    return time_stages(
        loaded.model,
        loaded.within(),
        loaded.device,
        ground_size,
        loaded.config.aerial_size,
        batch_size,
        runs,
    )


def time_settings(
    *,
    grid: str = "21x21x64",
    frustum: Frustum = _PANORAMA,
    encoder: str = "vgg16",
    weights: str | Path = "none",
    stride: int = 16,
    ground_size: tuple[int, int] = (320, 640),
    aerial_size: int = 512,
    device: str = "auto",
    cache: str | Path | None = None,
    precision: Precision = "32-true",
    batch_size: int = 1,
    runs: int = 5,
    progress: Progress | None = None,
) -> Timings:
    """Time an untrained model, whose arithmetic is that of a trained one.

    Parameters
    ----------
    grid : str
        The candidate poses: see `slicemask.PoseGrid.parse`.
    frustum : Frustum
        Of the ground images; the paper's panoramas by default.
    encoder : str
        timm backbone of both images.
    weights : str or path
        "imagenet", "none" or a file.
    stride : int
        Of the feature maps.
    ground_size : (height, width)
        Pixels of the ground images.
    aerial_size : int
        Pixels along each side of the aerial images.
    device : str
        "auto" (CUDA where it is there, else the CPU), "cpu", "cuda" or "cuda:N".
    cache : path, optional
        The folder of banks; SLICEMASK_CACHE or ``./masks_cache`` by default.
    precision : {"32-true", "16-mixed", "bf16-mixed"}
        In which the encoders compute.
    batch_size : int
        Pairs in a batch.
    runs : int
        Batches that are timed, after one that is not.
    progress : callable, optional
        Follows the bank's building, if it has to be built.

    Returns
    -------
    timings : Timings

    Raises
    ------
    ConfigError, WeightsError, SpecError, PoseError, BankError
        If a setting is invalid.
    """
    _check(batch_size, runs)
    if min(*ground_size, aerial_size) < 1:
        raise ConfigError(
            f"image sizes are {ground_size} and {aerial_size} pixels; they must be at least 1"
        )
    chosen = choose_device(device)
    poses = PoseGrid.parse(grid)
    model = SliceMatch(
        encoder,
        weights,
        ground_size,
        aerial_size,
        stride,
        frustum.slices,
        bands=_some_bands(frustum),
    )
    model.for_inference(chosen, precision)
    bank = build_bank(poses, frustum, model.cells, cache=cache, progress=progress).path
    candidates, _ = load_candidates(bank, frustum, model.cells)
    return time_stages(model, candidates, chosen, ground_size, aerial_size, batch_size, runs)


def _some_bands(frustum: Frustum) -> RangeBands | None:
    """Bands of a network for a frustum's; which rows they look at changes no time."""
    if not frustum.bands:
        return None
    ranges_m = tuple(70.0 * share for share in frustum.bands)
    return RangeBands(
        ranges_m=ranges_m,
        camera_height_m=2.5,
        elevations_deg=(-45.0, 45.0),
        projection=frustum.projection,
    )


def time_stages(
    model: SliceMatch,
    candidates: Candidates,
    device: torch.device,
    ground_size: tuple[int, int],
    aerial_size: int,
    batch_size: int = 1,
    runs: int = 5,
) -> Timings:
    """Time a model's stages on random images, on a device to which model and candidates move.

    Raises
    ------
    ConfigError
        If there is not enough memory.
    """

    def encode() -> tuple[Tensor, Tensor]:
        return model.ground_encoder(ground_images), model.aerial_encoder(aerial_images)

    def aggregate() -> tuple[Tensor, Tensor]:
        ground = model.ground_aggregator(ground_features)
        return ground, model.attend(aerial, ground)

    def score() -> Tensor:
        return score_candidates(ground, aerial, attention, candidates)

    try:
        model, candidates = model.to(device), candidates.to(device)
        with torch.no_grad():
            ground_images = torch.randn(batch_size, 3, *ground_size, device=device)
            aerial_images = torch.randn(batch_size, 3, aerial_size, aerial_size, device=device)
            encode_s, (ground_features, aerial) = median_seconds(encode, runs, device)
            aggregate_s, (ground, attention) = median_seconds(aggregate, runs, device)
            score_s, _ = median_seconds(score, runs, device)
    except (MemoryError, RuntimeError) as error:
        if not is_out_of_memory(error):
            raise
        raise ConfigError(
            f"batches of {batch_size} with images of {ground_size} and {aerial_size} pixels take "
            "more memory than there is; choose smaller ones"
        ) from error
    return Timings(
        encode_s=encode_s,
        aggregate_s=aggregate_s,
        score_s=score_s,
        poses=len(candidates.poses),
        distinct_masks=len(torch.unique(candidates.index)),
        batch_size=batch_size,
        device=str(candidates.index.device),
        precision=model.aerial_encoder.precision,
        threads=torch.get_num_threads(),
    )


def _check(batch_size: int, runs: int) -> None:
    for name, value in (("batch size", batch_size), ("runs", runs)):
        if value < 1:
            raise ConfigError(f"{name} is {value}; it must be at least 1")


def median_seconds(stage: Callable[[], Any], runs: int, device: torch.device) -> tuple[float, Any]:
    """Median seconds of a stage after one run that is not counted, and what it gives."""
    result = stage()
    seconds = []
    for _ in range(runs):
        _finish(device)
        start = time.perf_counter()
        result = stage()
        _finish(device)
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds), result


def _finish(device: torch.device) -> None:
    """Wait for what a GPU has been given to do."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)
