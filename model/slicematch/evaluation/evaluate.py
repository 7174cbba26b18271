"""Errors of a trained run on a part of its data set, as numbers, tables and pictures."""

import csv
import io
import json
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from matplotlib.figure import Figure
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import Subset

from slicemask.files import check_folder, write_text
from slicemask.plot import save_figure
from slicematch.data.dataset import BadSampleLog, PoseDataset, collate
from slicematch.data.images import denormalise
from slicematch.data.loading import PoseLoader
from slicematch.devices import Precision, precision_note
from slicematch.errors import ConfigError, RunError
from slicematch.evaluation.drawing import draw_errors, draw_estimate
from slicematch.evaluation.metrics import Floor, PoseErrors, candidate_floor, pose_errors
from slicematch.localization.localizer import Estimate, Localizer
from slicematch.localization.probabilities import Calibration, region
from slicematch.localization.refinement import DEFAULT, Refine, near
from slicematch.runs.config import check_workers
from slicematch.runs.folder import Checkpoint

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Evaluation:
    """Results of one run on n samples.

    Attributes
    ----------
    settings : dict
        What was evaluated: run, checkpoint, data, split, part, grid, priors.
    names : list of str
        Of the samples.
    truths, estimates : float64 [n, 3]
        u, v, heading_deg. The true headings are the ones that the data set drew from its seed.
    scores : float64 [n]
        Of the estimates.
    tile_metres : float64 [n]
        Side of each tile on the ground.
    errors : PoseErrors
        Of the estimates.
    floor : Floor
        What the candidates alone cost on these samples, unrefined.
    calibration : Calibration
        What the estimates' probabilities are worth.
    outside : int
        True places outside the grid's extent, where no candidate can find them.
    unreadable : dict
        Samples that could not be read, with what is wrong.
    """

    settings: dict[str, Any]
    names: list[str]
    truths: NDArray[np.float64]
    estimates: NDArray[np.float64]
    scores: NDArray[np.float64]
    tile_metres: NDArray[np.float64]
    errors: PoseErrors
    floor: Floor
    calibration: Calibration
    outside: int
    unreadable: dict[str, str]

    def summary(self) -> dict[str, Any]:
        """Settings and figures, without the samples."""
        return {
            **self.settings,
            "samples": len(self.names),
            "unreadable": self.unreadable,
            "labels_outside_the_grid": self.outside,
            "errors": self.errors.summary(),
            "floor": self.floor.summary(),
            "calibration": self.calibration.summary(),
        }

    def report(self) -> str:
        """The figures as a few lines of text."""
        errors, floor = self.errors.summary(), self.floor.summary()
        lines = [
            f"{len(self.names):,} samples of {self.settings['data']} {self.settings['split']} "
            f"{self.settings['part']}, candidates {self.settings['grid']}, "
            f"refine {self.settings['refine']}{precision_note(self.settings['precision'])}",
            "           mean      median    floor of the grid (mean, median)",
        ]
        for kind, unit in (("place", "m"), ("heading", "deg")):
            mean, median = (f"{kind}_{figure}_{unit}" for figure in ("mean", "median"))
            lines.append(
                f"{kind:<9}{errors[mean]:7.2f} {unit:<3}{errors[median]:7.2f} {unit:<3} "
                f"{floor[mean]:6.2f} {unit}, {floor[median]:.2f} {unit}"
            )
        lines.append("recall     at 1      at 5")
        for kind, unit in (("lateral", "m"), ("longitudinal", "m"), ("heading", "deg")):
            one, five = (errors[f"{kind}_recall_{threshold}{unit}"] for threshold in (1, 5))
            lines.append(f"{kind:<13}{one:6.1%}{five:10.1%}   ({unit})")
        sure = self.calibration.summary()
        source = "fitted" if self.settings["calibrated"] else "not fitted to these candidates"
        lines += [
            f"probabilities at temperature {self.settings['temperature']:.4g} ({source})",
            f"calibration error {sure['expected_error']:.3f}: {sure['mean_probability']:.1%} "
            f"promised on average, {sure['share_near']:.1%} found within reach",
            f"95 % region {sure['region_share']:.1%} of the tile on average; it holds "
            f"{sure['share_in_region']:.1%} of the true places",
        ]
        if self.outside:
            lines.append(f"{self.outside:,} true places lie outside the grid's extent")
        if self.unreadable:
            lines.append(f"{len(self.unreadable)} samples could not be read")
        return "\n".join(lines)

    def rows(self) -> list[dict[str, Any]]:
        """One row a sample: name, truth, estimate, score and errors."""
        errors = asdict(self.errors)
        return [
            {
                "name": name,
                **_named("true_", self.truths[n]),
                **_named("", self.estimates[n]),
                "score": float(self.scores[n]),
                "probability": float(self.calibration.probability[n]),
                "near": bool(self.calibration.near[n]),
                "in_region": bool(self.calibration.in_region[n]),
                "tile_metres": float(self.tile_metres[n]),
                **{f"error_{kind}": float(values[n]) for kind, values in errors.items()},
            }
            for n, name in enumerate(self.names)
        ]


def evaluate(
    run: str | Path,
    *,
    grid: str | None = None,
    bank: str | Path | None = None,
    split: str | None = None,
    part: str = "test",
    root: str | None = None,
    limit: int | None = None,
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
        Only so many samples, spread evenly over the part.
    checkpoint : {"best", "last"}
        Which weights.
    out : path, optional
        Folder of the results; by default one in the run folder that is named after what was
        evaluated.
    overwrite : bool
        Replace results that are there.
    device : str
        As for `choose_device`.
    workers : int, optional
        Processes that load images; the run's own number by default.
    cache : path, optional
        The folder of banks.
    refine : {"none", "mean", "fine", "continuous"}
        How estimates are refined (`slicematch.localization.refinement`).
    precision : {"32-true", "16-mixed", "bf16-mixed"}
        In which the encoders compute, as for `Localizer.load`.
    progress : callable, optional
        Called with (samples done, samples in all).

    Returns
    -------
    evaluation : Evaluation
        The results.
    folder : Path
        With ``result.json`` (everything), ``samples.csv``, ``errors.png`` and ``best.png``,
        ``median.png`` and ``worst.png`` (by distance from the true place).

    Raises
    ------
    RunError
        If the run cannot be loaded, or the results are there already.
    ConfigError, DatasetError
        If the request does not fit the run or its data.
    """
    if limit is not None and limit < 1:
        raise ConfigError(f"limit is {limit}; it must be at least 1")
    if workers is not None:
        check_workers(workers)
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
    config = localizer.config
    split = split or config.split
    dataset = config.dataset(part, root, split)
    name = f"{split}_{part}_{localizer.grid}_{checkpoint}"
    if refine != "none":
        name += f"_{refine}"
    if precision != "32-true":
        name += f"_{precision}"
    if limit is not None:
        name += f"_{limit}"
    chosen = Subset(dataset, spread(len(dataset), limit))
    folder = Path(out) if out is not None else Path(run) / "evaluation" / name
    if (folder / "result.json").exists() and not overwrite:
        raise RunError(
            f"{folder}: holds results already; replace them with --overwrite, or name another "
            "folder with --out"
        )
    check_folder(folder, RunError)
    settings = {
        "run": str(run),
        "checkpoint": checkpoint,
        "data": config.data,
        "split": split,
        "part": part,
        "grid": str(localizer.grid),
        "extent": localizer.grid.extent,
        "places": localizer.grid.places,
        "heading_prior": config.heading_prior(),
        "place_prior": config.place_prior,
        "seed": config.seed,
        "labels_left_out": dataset.left_out,
        "refine": refine,
        "precision": precision,
        "temperature": localizer.temperature,
        "calibrated": localizer.calibrated,
    }
    workers = config.workers if workers is None else workers
    with tempfile.TemporaryDirectory() as scratch:
        # Those met in worker processes too; `_measure` sees to the limit.
        dataset.bad_sample_log = BadSampleLog(Path(scratch, "bad_samples.jsonl"), len(dataset))
        evaluation = _measure(settings, localizer, chosen, workers, progress)
        figures = _draw(evaluation, localizer, dataset)
    _write(evaluation, figures, folder)
    return evaluation, folder


def spread(count: int, limit: int | None) -> list[int]:
    """At most `limit` of the numbers 0 to count - 1, spread evenly."""
    some = count if limit is None else min(limit, count)
    return np.linspace(0, count - 1, some).round().astype(int).tolist()


def _measure(
    settings: dict[str, Any],
    localizer: Localizer,
    chosen: Subset,
    workers: int,
    progress: Progress | None,
) -> Evaluation:
    """Estimate the pose of every sample chosen.

    Raises
    ------
    RunError
        If none can be read, or more cannot than the run's settings bear.
    """
    dataset = chosen.dataset
    loader = PoseLoader(
        chosen, localizer.config.batch_size, num_workers=workers, collate_fn=collate
    )
    read: list[int] = []
    estimates: list[_Kept] = []
    for number, batch in enumerate(loader, start=1):
        if batch is not None:
            read += batch["index"].tolist()
            truths = batch["pose"].numpy()
            metres = dataset.tile_metres[batch["index"].numpy()]
            found = _estimates(localizer, batch["ground"], batch["aerial"], metres)
            estimates += map(_keep, found, truths)
        if progress is not None:
            progress(min(number * localizer.config.batch_size, len(chosen)), len(chosen))
        unreadable = dataset.bad_sample_log.entries()
        if len(unreadable) > localizer.config.max_bad_samples:
            raise RunError(
                f"more than {localizer.config.max_bad_samples} samples are unreadable; mend them, "
                f"or name the data's root; first: {next(iter(unreadable.values()))}"
            )
    if not read:
        raise RunError(
            f"none of the {len(chosen)} samples can be read; mend them, or name the data's root; "
            f"first: {next(iter(unreadable.values()))}"
        )
    poses = np.array([kept.pose for kept in estimates])
    truths, tile_metres = dataset.poses()[read], dataset.tile_metres[read]
    return Evaluation(
        settings=settings,
        names=[dataset.names[index] for index in read],
        truths=truths,
        estimates=poses,
        scores=np.array([kept.score for kept in estimates]),
        tile_metres=tile_metres,
        errors=pose_errors(poses, truths, tile_metres),
        floor=candidate_floor(localizer.within().poses, truths, tile_metres),
        calibration=Calibration(
            probability=np.array([kept.probability for kept in estimates]),
            near=np.array([kept.near for kept in estimates]),
            in_region=np.array([kept.in_region for kept in estimates]),
            region_share=np.array([kept.region_share for kept in estimates]),
        ),
        outside=dataset.count_outside(localizer.grid.extent, read),
        unreadable=unreadable,
    )


class _Kept(NamedTuple):
    """What is kept of an estimate: not its scores, which are many."""

    pose: NDArray[np.float64]
    score: float
    probability: float
    near: bool
    in_region: bool
    region_share: float


def _keep(estimate: Estimate, truth: NDArray[np.float64]) -> _Kept:
    grid = estimate.grid
    held = region(estimate.place_map)
    row, column = np.abs(grid.v - truth[1]).argmin(), np.abs(grid.u - truth[0]).argmin()
    u0, v0, u1, v1 = grid.extent
    return _Kept(
        estimate.pose,
        estimate.score,
        estimate.modes[0].probability,
        bool(near(estimate.pose, truth[None], grid)[0]),
        bool(held[row, column]),
        float(held.mean() * (u1 - u0) * (v1 - v0)),
    )


def _write(evaluation: Evaluation, figures: dict[str, Figure], folder: Path) -> None:
    """Write every file whole; ``result.json``, which says that results are there, is the last."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, figure in figures.items():
        save_figure(figure, folder / f"{name}.png")
    rows, table = evaluation.rows(), io.StringIO(newline="")
    writer = csv.DictWriter(table, list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    unreadable = (
        json.dumps({"name": name, "error": error}) + "\n"
        for name, error in evaluation.unreadable.items()
    )
    content = {**evaluation.summary(), "per_sample": rows}
    for name, text in (
        ("samples.csv", table.getvalue()),
        ("bad_samples.jsonl", "".join(unreadable)),
        ("result.json", json.dumps(content, indent=1, allow_nan=False) + "\n"),
    ):
        write_text(folder / name, text, RunError)


def _draw(evaluation: Evaluation, localizer: Localizer, dataset: PoseDataset) -> dict[str, Figure]:
    """Pictures of the errors and of three cases, by name."""
    figures = {"errors": draw_errors(evaluation.errors, evaluation.floor)}
    order = np.argsort(evaluation.errors.place_m, kind="stable")
    cases = {"best": order[0], "median": order[(len(order) - 1) // 2], "worst": order[-1]}
    index_of = {name: index for index, name in enumerate(dataset.names)}
    for case, n in cases.items():
        name = evaluation.names[n]
        sample = dataset[index_of[name]]
        metres = evaluation.tile_metres[n : n + 1]
        (estimate,) = _estimates(localizer, sample["ground"][None], sample["aerial"][None], metres)
        place_m, heading_deg = evaluation.errors.place_m[n], evaluation.errors.heading_deg[n]
        figures[case] = draw_estimate(
            denormalise(sample["aerial"], *localizer.config.normalisation()),
            estimate.heat_map,
            localizer.grid,
            evaluation.estimates[n],
            localizer.frustum,
            truth=evaluation.truths[n],
            ground=denormalise(sample["ground"], *localizer.config.normalisation()),
            title=f"{case}: {place_m:.2f} m and {heading_deg:.1f}° off\n{name}",
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


def _named(prefix: str, pose: NDArray[np.float64]) -> dict[str, float]:
    names = ("u", "v", "heading_deg")
    return {prefix + name: float(value) for name, value in zip(names, pose, strict=True)}
