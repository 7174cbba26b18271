"""Evaluating a trained run on a part of its data set."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slicemask.files import check_folder
from slicematch.angles import angle_difference_deg
from slicematch.data import OWN
from slicematch.data.dataset import PoseDataset
from slicematch.data.images import denormalise
from slicematch.errors import ConfigError, RunError
from slicematch.evaluation.calibration import Calibration
from slicematch.evaluation.drawing import draw_errors, draw_estimate
from slicematch.evaluation.headings import HeadingUnit
from slicematch.evaluation.measure import (
    ESTIMATE,
    TRUTH,
    Measuring,
    check_faults,
    estimates_of,
    measure,
)
from slicematch.evaluation.metrics import RECALLS, oracle_error, pose_errors
from slicematch.evaluation.report import Evaluation, write_results
from slicematch.evaluation.samples import check_one_source, evenly_spaced_indices
from slicematch.localization.localizer import Localizer
from slicematch.localization.modes import REACH, REACH_DEG
from slicematch.localization.refinement import DEFAULT, Refine
from slicematch.localization.tiles import trained_window
from slicematch.parts import Parts, Progress, Row, digest, run_parts, split_groups
from slicematch.precision import Precision
from slicematch.priors import count_outside
from slicematch.runs.config import TrainConfig, check_workers, plain
from slicematch.runs.folder import Checkpoint, RunFolder
from slicematch.runs.shipped import find_run


def evaluate(
    run: str | Path,
    *,
    dataset: Any = None,
    grid: str | None = None,
    bank: str | Path | None = None,
    split: str | None = None,
    part: str = "test",
    data: str | None = None,
    root: str | None = None,
    data_settings: Mapping[str, Any] | None = None,
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
    alone: bool = False,
    dask: str | None = None,
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
    data : {"vigor", "kitti", "table"}, optional
        The data set, if not the run's own, for runs of panoramas; with its root. Tables' aerial
        tiles are cut to the size of those in training.
    root : str, optional
        Where the data lie, if not where they lay in training.
    data_settings : mapping, optional
        Settings of the data set's own in place of the run's or of its defaults, such as `map`,
        which a table's rows are cut from: see `VigorConfig`, `KittiConfig` and `TableConfig`.
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
    alone : bool
        Of an ensemble, evaluate the first network alone.
    dask : str, optional
        Measure on Dask: "local", a number of processes here, or a scheduler's address. Stopped and
        repeated, it goes on where it was. Each process computes with its own threads, and loads
        images by itself.
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
    loading = {
        "bank": None if bank is None else str(bank),
        "grid": grid,
        "checkpoint": checkpoint,
        "device": device,
        "cache": None if cache is None else str(cache),
        "refine": refine,
        "precision": precision,
        "alone": alone,
    }
    measuring = Measuring(
        run=str(run),
        part=part,
        split=split,
        data=data,
        root=root,
        data_settings=dict(data_settings or {}),
        heading_half_width_deg=heading_half_width_deg,
        headings=None if headings is None else str(headings),
        headings_unit=headings_unit,
        settings=tuple(loading.items()),
    )
    if dask is not None and dataset is not None:
        raise ConfigError(
            "a data set of the program's own is measured in one process, without dask"
        )
    check_one_source(dataset, data, root, data_settings)
    localizer, samples = measuring.load(dataset)
    config = localizer.config
    split = split or config.split
    name = [split, part] if dataset is None else [OWN]
    if data is not None:
        name.insert(0, data)
    name += [str(localizer.grid), checkpoint]
    if refine != "none":
        name.append(refine)
    if precision != "32-true":
        name.append(precision)
    if alone:
        name.append("alone")
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
        "root": config.root if dataset is None else None,
        "data_settings": plain(config.data_settings) if dataset is None else None,
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
        "networks": len(localizer.members),
        "temperature": localizer.temperature,
        "calibrated": localizer.calibrated,
    }
    chosen = evenly_spaced_indices(len(samples), limit)
    if dask is None:
        workers = config.workers if workers is None else workers
        rows = measure(localizer, samples, chosen, workers, progress)
    else:
        rows = _measure_on_dask(measuring, settings, chosen, config, folder, dask, progress)
    evaluation = _evaluation(settings, localizer, samples, rows, recalls)
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


def _check_tiles(dataset: PoseDataset, localizer: Localizer) -> None:
    """Hold the tiles' size on the ground against that in training."""
    size = dataset.aerial_size
    for metres in {float(dataset.tile_metres.min()), float(dataset.tile_metres.max())}:
        trained_window(size, metres / size, localizer.tile_side_m, crop=False)


def _measure_on_dask(
    measuring: Measuring,
    settings: dict[str, Any],
    chosen: list[int],
    config: TrainConfig,
    folder: Path,
    dask: str,
    progress: Progress | None,
) -> list[Row]:
    """Rows of the samples chosen, from many processes: the same as from one."""
    request = {**settings, "samples": digest(chosen), "weights": _weights(settings)}
    # Whole batches, as one process makes them: the sums of others differ in their last digits.
    size = config.batch_size
    batches = [chosen[start : start + size] for start in range(0, len(chosen), size)]
    groups = [
        [index for batch in part for index in batch]
        for part in split_groups([[batch] for batch in batches])
    ]
    parts = Parts(folder / "parts", request)
    table = run_parts(measuring, parts, groups, dask, progress)
    rows: list[Row] = table.to_pylist()
    parts.remove()
    check_faults([row["error"] for row in rows if row["error"] is not None], config)
    return rows


def _weights(settings: dict[str, Any]) -> str:
    return digest(RunFolder(find_run(settings["run"])).checkpoint(settings["checkpoint"]))


def _evaluation(
    settings: dict[str, Any],
    localizer: Localizer,
    dataset: PoseDataset,
    rows: list[Row],
    recalls: tuple[float, ...],
) -> Evaluation:
    """The evaluation that rows of samples make.

    Raises
    ------
    RunError
        If none of them is readable.
    """
    read = [row for row in rows if row.get("error") is None]
    unread = [row for row in rows if row.get("error") is not None]
    if not read:
        raise RunError(
            f"none of the {len(rows)} samples is readable; mend them, or name the data's root; "
            f"first: {unread[0]['error']}"
        )
    truths, estimates = (
        np.array([[row[name] for name in names] for row in read]) for names in (TRUTH, ESTIMATE)
    )
    columns = {
        name: np.array([row[name] for row in read])
        for name in ("probability", "within_reach", "in_credible_region", "region_area")
    }
    tile_metres = np.array([row["tile_metres"] for row in read])
    prior = localizer.config.heading_prior()
    settings["headings_outside_the_prior"] = _count_beyond(truths, prior)
    return Evaluation(
        settings=settings,
        indices=[row["index"] for row in read],
        names=[dataset.names[row["index"]] for row in read],
        truths=truths,
        estimates=estimates,
        scores=np.array([row["score"] for row in read]),
        tile_metres=tile_metres,
        errors=pose_errors(estimates, truths, tile_metres),
        oracle=oracle_error(localizer.within().poses, truths, tile_metres),
        calibration=Calibration(**columns),
        outside=count_outside(truths, localizer.grid.extent),
        unreadable=[
            {"index": row["index"], "name": dataset.names[row["index"]], "error": row["error"]}
            for row in sorted(unread, key=lambda row: row["index"])
        ],
        recalls=recalls,
    )


def _count_beyond(truths: NDArray[np.float64], prior: tuple[float, float] | None) -> int:
    """How many true headings no candidate can find, because of the prior on headings."""
    if prior is None:
        return 0
    away = np.abs(angle_difference_deg(truths[:, 2], prior[0]))
    return int(np.count_nonzero(away > prior[1] + 1e-9))


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
        (estimate,) = estimates_of(
            localizer, sample["ground"][None], sample["aerial"][None], metres
        )
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
