"""Estimating the poses of samples, in this process or in many."""

import functools
import tempfile
import uuid
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from slicematch.data.dataset import BadSampleLog, PoseDataset, collate
from slicematch.data.loading import PoseLoader
from slicematch.errors import RunError
from slicematch.evaluation.headings import HeadingUnit, read_headings
from slicematch.evaluation.samples import ChosenSamples
from slicematch.localization.estimate import Estimate
from slicematch.localization.localizer import Localizer
from slicematch.localization.modes import within_reach
from slicematch.localization.probabilities import credible_region
from slicematch.parts import Progress, Row
from slicematch.runs.config import TrainConfig

# What is kept of a sample: not its scores, which are many.
SAMPLE_COLUMNS = {
    "index": "int64",
    "true_u": "float64",
    "true_v": "float64",
    "true_heading_deg": "float64",
    "u": "float64",
    "v": "float64",
    "heading_deg": "float64",
    "score": "float64",
    "probability": "float64",
    "within_reach": "bool",
    "in_credible_region": "bool",
    "region_area": "float64",
    "tile_metres": "float64",
    "error": "string",
}
TRUTH, ESTIMATE = ("true_u", "true_v", "true_heading_deg"), ("u", "v", "heading_deg")


@dataclass(frozen=True)
class Measuring:
    """What is measured: it goes to other processes, and loads the run once in each.

    Attributes
    ----------
    run, part : str
        The run's folder, and the part of its data set.
    split, data, root : str or None
        As `slicematch.evaluate` takes them.
    data_settings : mapping
        Likewise.
    heading_half_width_deg : float or None
        Likewise.
    headings : str or None
        Likewise, with their unit.
    settings : tuple of (name, value)
        Further arguments of `Localizer.load`.
    call : str
        Tells calls apart: the run or its data may have changed since the last one.
    """

    run: str
    part: str
    split: str | None = None
    data: str | None = None
    root: str | None = None
    data_settings: Mapping[str, Any] = field(default_factory=dict, hash=False)
    heading_half_width_deg: float | None = None
    headings: str | None = None
    headings_unit: HeadingUnit = "degrees"
    settings: tuple[tuple[str, Any], ...] = ()
    call: str = field(default_factory=lambda: uuid.uuid4().hex)

    columns: ClassVar[Mapping[str, str]] = SAMPLE_COLUMNS

    def load(self, dataset: Any = None) -> tuple[Localizer, PoseDataset]:
        """The run and its samples, or those of a program's own data set."""
        headings_deg = (
            None if self.headings is None else read_headings(self.headings, self.headings_unit)
        )
        localizer = Localizer.load(self.run, **dict(self.settings))
        localizer.config = localizer.config.with_data(self.data, self.root, self.data_settings)
        if self.heading_half_width_deg is not None:
            _use_heading_prior(localizer, self.heading_half_width_deg)
        config = localizer.config
        samples = (
            config.dataset(self.part, split=self.split or config.split)
            if dataset is None
            else config.own_dataset(dataset, "test")
        )
        if headings_deg is not None:
            samples.use_headings(headings_deg)
        return localizer, samples

    def __call__(self, items: Sequence[int]) -> list[Row]:
        """Rows of the samples with these indices."""
        return measure(*_loaded(self), items, workers=0)


@functools.lru_cache(maxsize=1)
def _loaded(measuring: Measuring) -> tuple[Localizer, PoseDataset]:
    return measuring.load()


def measure(
    localizer: Localizer,
    samples: PoseDataset,
    chosen: Sequence[int],
    workers: int,
    progress: Progress | None = None,
) -> list[Row]:
    """Estimate the poses of some samples.

    Parameters
    ----------
    localizer : Localizer
        Of the run.
    samples : PoseDataset
        Of any part.
    chosen : sequence of int
        Their indices, each once.
    workers : int
        Processes that load images.
    progress : callable, optional
        Called with (samples done, samples in all).

    Returns
    -------
    rows : list of dict
        Of `SAMPLE_COLUMNS`, one a sample, in the order chosen. An unreadable sample has an error
        in place of the rest.

    Raises
    ------
    RunError
        If more are unreadable than the run's settings allow.
    """
    rows: dict[int, Row] = {}
    faults: dict[str, str] = {}
    batch_size = localizer.config.batch_size
    batches = read_batches(samples, chosen, localizer.config, workers, faults)
    for number, batch in enumerate(batches, start=1):
        if batch is not None:
            rows |= _rows(localizer, samples, batch)
        if progress is not None:
            progress(min(number * batch_size, len(chosen)), len(chosen))
    for index in {*chosen} - {*rows}:
        rows[index] = {"index": index, "error": faults.get(samples.names[index], "is unreadable")}
    return [rows[index] for index in chosen]


def read_batches(
    samples: PoseDataset,
    chosen: Sequence[int],
    config: TrainConfig,
    workers: int,
    faults: dict[str, str],
) -> Iterator[dict[str, Any] | None]:
    """Batches of samples, each of those that are readable: None where none is.

    Parameters
    ----------
    samples : PoseDataset
        Of any part.
    chosen : sequence of int
        Their indices, each once.
    config : TrainConfig
        With the batches' size, and how many samples may be unreadable.
    workers : int
        Processes that load images.
    faults : dict
        What is wrong with unreadable samples, by name, is entered here.

    Raises
    ------
    RunError
        If more are unreadable than the settings allow.
    """
    with tempfile.TemporaryDirectory() as scratch:
        # Those met in worker processes too; the limit is seen to here.
        log = BadSampleLog(Path(scratch, "bad_samples.jsonl"), len(samples))
        samples.bad_sample_log = log
        for batch in PoseLoader(
            ChosenSamples(samples, chosen),
            config.batch_size,
            num_workers=workers,
            collate_fn=collate,
        ):
            yield batch
            faults.update(log.entries())
            check_faults([*faults.values()], config)


def check_faults(faults: Sequence[str], config: TrainConfig) -> None:
    """Refuse a data set with more unreadable samples than the settings allow."""
    if len(faults) > config.max_bad_samples:
        raise RunError(
            f"more than {config.max_bad_samples} samples are unreadable; mend them, or name the "
            f"data's root; first: {faults[0]}"
        )


def estimates_of(
    localizer: Localizer, ground: Tensor, aerial: Tensor, tile_metres: NDArray[np.float64]
) -> list[Estimate]:
    """Estimates of normalised images."""
    descriptors = localizer.encode_ground_pixels(ground)
    features = localizer.encode_aerial_pixels(aerial)
    pixels = [aerial.shape[-1]] * len(aerial)
    return localizer.estimate(descriptors, features, pixels, tile_metres.tolist())


def _rows(localizer: Localizer, samples: PoseDataset, batch: dict[str, Any]) -> dict[int, Row]:
    """The rows of a batch, by index."""
    sides = batch["metres_per_pixel"].numpy() * samples.aerial_size
    found = estimates_of(localizer, batch["ground"], batch["aerial"], sides)
    content = zip(batch["index"].tolist(), batch["pose"].numpy(), found, sides, strict=True)
    return {
        index: {"index": index, "tile_metres": float(side), **_figures(estimate, truth)}
        for index, truth, estimate, side in content
    }


def _figures(estimate: Estimate, truth: NDArray[np.float64]) -> Row:
    grid = estimate.grid
    region = credible_region(estimate.place_map)
    row, column = np.abs(grid.v - truth[1]).argmin(), np.abs(grid.u - truth[0]).argmin()
    u0, v0, u1, v1 = grid.extent
    return {
        **dict(zip(TRUTH, truth.tolist(), strict=True)),
        **dict(zip(ESTIMATE, estimate.pose.tolist(), strict=True)),
        "score": estimate.score,
        "probability": estimate.modes[0].probability,
        "within_reach": bool(within_reach(estimate.pose, truth[None], grid)[0]),
        "in_credible_region": bool(region[row, column]),
        "region_area": float(region.mean() * (u1 - u0) * (v1 - v0)),
    }


def _use_heading_prior(localizer: Localizer, half_width_deg: float) -> None:
    """Give a localizer another heading prior than its run's, around the same centre."""
    config: TrainConfig = replace(localizer.config, heading_half_width_deg=half_width_deg)
    # A temperature was fitted to scores under the run's own priors.
    localizer.calibrated &= config.heading_prior() == localizer.config.heading_prior()
    localizer.config = config
