"""Evaluating a trained run on a part of its data set."""

import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from matplotlib.figure import Figure
from numpy.typing import NDArray
from torch import Tensor

from slicemask.files import check_folder
from slicematch.angles import angle_difference_deg
from slicematch.data import OWN
from slicematch.data.dataset import BadSampleLog, PoseDataset, collate
from slicematch.data.images import denormalise
from slicematch.data.loading import PoseLoader
from slicematch.errors import ConfigError, RunError
from slicematch.evaluation.calibration import Calibration
from slicematch.evaluation.drawing import draw_errors, draw_estimate
from slicematch.evaluation.headings import HeadingUnit, read_headings
from slicematch.evaluation.metrics import RECALLS, oracle_error, pose_errors
from slicematch.evaluation.report import Evaluation, write_results
from slicematch.evaluation.samples import ChosenSamples, evenly_spaced_indices
from slicematch.localization.estimate import Estimate
from slicematch.localization.localizer import Localizer
from slicematch.localization.modes import REACH, REACH_DEG, within_reach
from slicematch.localization.probabilities import credible_region
from slicematch.localization.refinement import DEFAULT, Refine
from slicematch.localization.tiles import trained_window
from slicematch.precision import Precision
from slicematch.priors import count_outside
from slicematch.runs.config import TrainConfig, check_workers
from slicematch.runs.folder import Checkpoint

Progress = Callable[[int, int], None]


def evaluate(
    run: str | Path,
    *,
    dataset: Any = None,
    grid: str | None = None,
    bank: str | Path | None = None,
    split: str | None = None,
    part: str = "test",
    root: str | None = None,
    limit: int | None = None,
    heading_half_width_deg: float | None = None,
    headings: str | Path | None = None,
    headings_unit: HeadingUnit = "degrees",
    recalls: Sequence[float] = RECALLS,
    checkpoint: Checkpoint = "best",
    out: str | Path | None = None,
    overwrite: bool = False,
    device: str = "auto",
    workers: int | None = None,
    cache: str | Path | None = None,
    refine: Refine = DEFAULT,
    precision: Precision = "32-true",
    progress: Progress | None = None,
) -> tuple[Evaluation, Path]:
    """Evaluate a run and write its results.

    Parameters
    ----------
    run : path
        A run folder.
    dataset : torch.utils.data.Dataset, optional
        Samples of the program's own, as `slicematch.PoseDataset` documents them, instead of a part
        of the run's data set.
    grid : str, optional
        Candidates such as "21x21x64"; the run's test grid by default.
    bank : path, optional
        A bank of candidates instead.
    split : {"same-area", "cross-area"}, optional
        The run's own by default.
    part : {"test", "validation", "train"}
        Part of the data set.
    root : str, optional
        Where the data lie, if not where they lay in training.
    limit : int, optional
        Only so many samples, evenly spaced over the part.
    heading_half_width_deg : float, optional
        How far headings lie from the data set's own, in degrees to either side: 0 for known
        headings, 180 for any. By default the run's own. Where the data set draws its test
        headings, it draws them from this range, too.
    headings : path, optional
        A list of true headings, instead of those drawn: see
        `slicematch.evaluation.headings.read_headings`.
    headings_unit : {"degrees", "radians", "turns"}
        Of that list.
    recalls : sequence of float
        Metres and degrees below which recalls count.
    checkpoint : {"best", "last"}
        Which weights.
    out : path, optional
        Folder of the results; by default one in the run folder that is named after what was
        evaluated.
    overwrite : bool
        Replace results that are there.
    device : str
        "auto", "cpu", "cuda" or "cuda:N".
    workers : int, optional
        Processes that load images; the run's own number by default.
    cache : path, optional
        The folder of banks.
    refine : {"none", "mean", "fine", "continuous"}
        How estimates are refined (`slicematch.localization.refinement`).
    precision : {"32-true", "16-mixed", "bf16-mixed"}
        In which the encoders compute.
    progress : callable, optional
        Called with (samples done, samples in all).

    Returns
    -------
    evaluation : Evaluation
        The results.
    folder : Path
        With ``result.json`` (everything), ``samples.csv``, ``errors.png`` and ``best.png``,
        ``median.png`` and ``worst.png`` (by place and heading together: a tenth of the tile's side
        counts as much as 30 degrees).

    Raises
    ------
    RunError
        If the run cannot be loaded, or the results are there already.
    ConfigError, DatasetError
        If the request does not fit the run or its data.
    """
    if limit is not None and limit < 1:
        raise ConfigError(f"limit is {limit}; it must be at least 1")
    recalls = _check_recalls(recalls)
    if workers is not None:
        check_workers(workers)
    headings_deg = None if headings is None else read_headings(headings, headings_unit)
    localizer = Localizer.load(
        run,
        bank,
        grid=grid,
        checkpoint=checkpoint,
        device=device,
        cache=cache,
        refine=refine,
        precision=precision,
    )
    if heading_half_width_deg is not None:
        _use_heading_prior(localizer, heading_half_width_deg)
    config = localizer.config
    split = split or config.split
    samples = (
        config.dataset(part, root, split)
        if dataset is None
        else config.own_dataset(dataset, "test")
    )
    if headings_deg is not None:
        samples.use_headings(headings_deg)
    name = [split, part] if dataset is None else [OWN]
    name += [str(localizer.grid), checkpoint]
    if refine != "none":
        name.append(refine)
    if precision != "32-true":
        name.append(precision)
    if heading_half_width_deg is not None:
        name.append(f"prior{heading_half_width_deg:g}")
    if headings is not None:
        name.append(Path(headings).stem)
    if limit is not None:
        name.append(str(limit))
    folder = Path(out) if out is not None else Path(run) / "evaluation" / "_".join(name)
    if (folder / "result.json").exists() and not overwrite:
        raise RunError(
            f"{folder}: holds results already; replace them with --overwrite, or name another "
            "folder with --out"
        )
    check_folder(folder, RunError)
    _check_tiles(samples, localizer)
    settings = {
        "run": str(run),
        "checkpoint": checkpoint,
        "data": config.data if dataset is None else OWN,
        "split": split,
        "part": part,
        "grid": str(localizer.grid),
        "extent": localizer.grid.extent,
        "places": localizer.grid.places,
        "heading_prior": config.heading_prior(),
        "place_prior": config.place_prior,
        "headings": None if headings is None else str(headings),
        "seed": config.seed,
        "labels_left_out": samples.left_out,
        "refine": refine,
        "precision": precision,
        "temperature": localizer.temperature,
        "calibrated": localizer.calibrated,
    }
    chosen = evenly_spaced_indices(len(samples), limit)
    workers = config.workers if workers is None else workers
    with tempfile.TemporaryDirectory() as scratch:
        # Those met in worker processes too; `_measure` sees to the limit.
        samples.bad_sample_log = BadSampleLog(Path(scratch, "bad_samples.jsonl"), len(samples))
        evaluation = _measure(settings, localizer, samples, chosen, recalls, workers, progress)
        figures = _draw(evaluation, localizer, samples)
    write_results(evaluation, figures, folder)
    return evaluation, folder


def _check_recalls(recalls: Sequence[float]) -> tuple[float, ...]:
    values = tuple(float(value) for value in recalls)
    if not values or not all(0 < value < math.inf for value in values):
        raise ConfigError(
            f"recalls are {','.join(f'{value:g}' for value in values)!r}; they must be distances "
            "in metres and degrees above 0, such as 1,3,5"
        )
    return values


def _use_heading_prior(localizer: Localizer, half_width_deg: float) -> None:
    """Give a localizer another heading prior than its run's, around the same centre."""
    config: TrainConfig = replace(localizer.config, heading_half_width_deg=half_width_deg)
    # A temperature was fitted to scores under the run's own priors.
    localizer.calibrated &= config.heading_prior() == localizer.config.heading_prior()
    localizer.config = config


def _check_tiles(dataset: PoseDataset, localizer: Localizer) -> None:
    """Hold the tiles' size on the ground against that in training."""
    size = dataset.aerial_size
    for metres in {float(dataset.tile_metres.min()), float(dataset.tile_metres.max())}:
        trained_window(size, metres / size, localizer.tile_side_m, crop=False)


def _measure(
    settings: dict[str, Any],
    localizer: Localizer,
    dataset: PoseDataset,
    chosen: list[int],
    recalls: tuple[float, ...],
    workers: int,
    progress: Progress | None,
) -> Evaluation:
    """Estimate the pose of every sample chosen.

    Raises
    ------
    RunError
        If none is readable, or more are unreadable than the run's settings allow.
    """
    log, config = dataset.bad_sample_log, localizer.config
    assert log is not None
    loader = PoseLoader(
        ChosenSamples(dataset, chosen),
        config.batch_size,
        num_workers=workers,
        collate_fn=collate,
    )
    read: list[int] = []
    poses: list[NDArray[np.float64]] = []
    sides: list[NDArray[np.float64]] = []
    answers: list[_Answer] = []
    for number, batch in enumerate(loader, start=1):
        if batch is not None:
            read += batch["index"].tolist()
            poses.append(batch["pose"].numpy())
            sides.append(batch["metres_per_pixel"].numpy() * dataset.aerial_size)
            found = _estimates(localizer, batch["ground"], batch["aerial"], sides[-1])
            answers += map(_answer, found, poses[-1])
        if progress is not None:
            progress(min(number * config.batch_size, len(chosen)), len(chosen))
        faults = log.entries()
        if len(faults) > config.max_bad_samples:
            raise RunError(
                f"more than {config.max_bad_samples} samples are unreadable; mend them, or name "
                f"the data's root; first: {next(iter(faults.values()))}"
            )
    if not read:
        raise RunError(
            f"none of the {len(chosen)} samples is readable; mend them, or name the data's root; "
            f"first: {next(iter(faults.values()))}"
        )
    estimates = np.array([answer.pose for answer in answers])
    truths, tile_metres = np.concatenate(poses), np.concatenate(sides)
    settings["headings_outside_the_prior"] = _count_beyond(truths, config.heading_prior())
    return Evaluation(
        settings=settings,
        indices=read,
        names=[dataset.names[index] for index in read],
        truths=truths,
        estimates=estimates,
        scores=np.array([answer.score for answer in answers]),
        tile_metres=tile_metres,
        errors=pose_errors(estimates, truths, tile_metres),
        oracle=oracle_error(localizer.within().poses, truths, tile_metres),
        calibration=Calibration(
            probability=np.array([answer.probability for answer in answers]),
            within_reach=np.array([answer.within_reach for answer in answers]),
            in_credible_region=np.array([answer.in_credible_region for answer in answers]),
            region_area=np.array([answer.region_area for answer in answers]),
        ),
        outside=count_outside(truths, localizer.grid.extent),
        unreadable=[
            {"index": index, "name": name, "error": faults.get(name, "is unreadable")}
            for index in sorted({*chosen} - {*read})
            for name in [dataset.names[index]]
        ],
        recalls=recalls,
    )


def _count_beyond(truths: NDArray[np.float64], prior: tuple[float, float] | None) -> int:
    """How many true headings no candidate can find, because of the prior on headings."""
    if prior is None:
        return 0
    away = np.abs(angle_difference_deg(truths[:, 2], prior[0]))
    return int(np.count_nonzero(away > prior[1] + 1e-9))


class _Answer(NamedTuple):
    """What is kept of an estimate: not its scores, which are many."""

    pose: NDArray[np.float64]
    score: float
    probability: float
    within_reach: bool
    in_credible_region: bool
    region_area: float


def _answer(estimate: Estimate, truth: NDArray[np.float64]) -> _Answer:
    grid = estimate.grid
    region = credible_region(estimate.place_map)
    row, column = np.abs(grid.v - truth[1]).argmin(), np.abs(grid.u - truth[0]).argmin()
    u0, v0, u1, v1 = grid.extent
    return _Answer(
        estimate.pose,
        estimate.score,
        estimate.modes[0].probability,
        bool(within_reach(estimate.pose, truth[None], grid)[0]),
        bool(region[row, column]),
        float(region.mean() * (u1 - u0) * (v1 - v0)),
    )


def _draw(evaluation: Evaluation, localizer: Localizer, dataset: PoseDataset) -> dict[str, Figure]:
    """Pictures of the errors and of three cases, by name."""
    figures = {"errors": draw_errors(evaluation.errors, evaluation.oracle)}
    errors = evaluation.errors
    # In units of reach, so that neither metres nor degrees decide alone.
    together = errors.place_m / (REACH * evaluation.tile_metres) + errors.heading_deg / REACH_DEG
    order = np.argsort(together, kind="stable")
    cases = {"best": order[0], "median": order[(len(order) - 1) // 2], "worst": order[-1]}
    normalisation = localizer.config.normalisation()
    for case, n in cases.items():
        index = evaluation.indices[n]
        sample = dataset[index]
        if sample is None:  # it has become unreadable since
            continue
        metres = evaluation.tile_metres[n : n + 1]
        (estimate,) = _estimates(localizer, sample["ground"][None], sample["aerial"][None], metres)
        figures[case] = draw_estimate(
            denormalise(sample["aerial"], *normalisation),
            estimate.heat_map,
            localizer.grid,
            evaluation.estimates[n],
            localizer.frustum,
            truth=evaluation.truths[n],
            ground=denormalise(sample["ground"], *normalisation),
            title=(
                f"{case.capitalize()}: {errors.place_m[n]:.2f} m and "
                f"{errors.heading_deg[n]:.1f}° off\nsample {index}, {evaluation.names[n]}"
            ),
            estimate=estimate,
            tile_metres=float(metres[0]),
            # KITTI turns its crops, each by another angle.
            north_up=localizer.config.data != "kitti",
        )
    return figures


def _estimates(
    localizer: Localizer, ground: Tensor, aerial: Tensor, tile_metres: NDArray[np.float64]
) -> list[Estimate]:
    """Estimates of normalised images."""
    with torch.no_grad():
        descriptors = localizer.model.encode_ground(ground.to(localizer.device))
        features = localizer.model.encode_aerial(aerial.to(localizer.device))
    pixels = [aerial.shape[-1]] * len(aerial)
    return localizer.estimate(descriptors, features, pixels, tile_metres.tolist())
