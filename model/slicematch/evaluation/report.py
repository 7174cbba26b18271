"""Results of an evaluation: as figures, as a table of samples, as text and as files."""

import csv
import io
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slicemask.files import write_text
from slicemask.plot import save_figure
from slicematch.devices import precision_note
from slicematch.errors import RunError
from slicematch.evaluation.calibration import Calibration
from slicematch.evaluation.metrics import RECALLS, OracleError, PoseErrors, recall_name


@dataclass(frozen=True)
class Evaluation:
    """Results of one run on n samples.

    Attributes
    ----------
    settings : dict
        What was evaluated: run, checkpoint, data, split, part, grid, priors.
    indices : list of int
        Of the samples: their places in the part's list, which alone tell them apart.
    names : list of str
        Of the samples; they may repeat.
    truths, estimates : float64 [n, 3]
        u, v, heading_deg. The true headings are those of the label files or of the list handed in,
        or else the ones that the data set drew from its seed.
    scores : float64 [n]
        Of the estimates.
    tile_metres : float64 [n]
        Side of each tile on the ground.
    errors : PoseErrors
        Of the estimates.
    oracle : OracleError
        What the candidates alone cost on these samples, unrefined.
    calibration : Calibration
        What the estimates' probabilities are worth.
    outside : int
        True places outside the grid's extent, where no candidate can find them.
    unreadable : list of dict
        Samples that are unreadable: index, name and error of each.
    recalls : tuple of float
        Thresholds in metres and degrees.
    """

    settings: dict[str, Any]
    indices: list[int]
    names: list[str]
    truths: NDArray[np.float64]
    estimates: NDArray[np.float64]
    scores: NDArray[np.float64]
    tile_metres: NDArray[np.float64]
    errors: PoseErrors
    oracle: OracleError
    calibration: Calibration
    outside: int
    unreadable: list[dict[str, Any]]
    recalls: tuple[float, ...] = RECALLS

    def summary(self) -> dict[str, Any]:
        """Settings and figures, without the samples."""
        return {
            **self.settings,
            "samples": len(self.names),
            "unreadable": self.unreadable,
            "labels_outside_the_grid": self.outside,
            "errors": self.errors.summary(self.recalls),
            "oracle": self.oracle.summary(),
            "calibration": self.calibration.summary(),
        }

    def __str__(self) -> str:
        return self.report()

    def report(self) -> str:
        """The figures as a few lines of text."""
        errors, oracle = self.errors.summary(self.recalls), self.oracle.summary()
        lines = [
            f"{len(self.names):,} samples of {self.settings['data']} {self.settings['split']} "
            f"{self.settings['part']}, candidates {self.settings['grid']}, "
            f"refine {self.settings['refine']}{precision_note(self.settings['precision'])}",
            "           mean      median    oracle among the candidates (mean, median)",
        ]
        for kind, unit in (("place", "m"), ("heading", "deg")):
            mean, median = (f"{kind}_{figure}_{unit}" for figure in ("mean", "median"))
            lines.append(
                f"{kind:<9}{errors[mean]:7.2f} {unit:<3}{errors[median]:7.2f} {unit:<3} "
                f"{oracle[mean]:6.2f} {unit}, {oracle[median]:.2f} {unit}"
            )
        lines.append("recall   " + "".join(f"{f'at {value:g}':>10}" for value in self.recalls))
        for kind, unit in (("lateral", "m"), ("longitudinal", "m"), ("heading", "deg")):
            found = (errors[recall_name(kind, value, unit)] for value in self.recalls)
            lines.append(f"{kind:<12}" + "".join(f"{value:10.1%}" for value in found)[3:])
            lines[-1] += f"   ({unit})"
        sure = self.calibration.summary()
        source = "fitted" if self.settings["calibrated"] else "not fitted to these candidates"
        lines += [
            f"probabilities at temperature {self.settings['temperature']:.4g} ({source})",
            f"calibration error {sure['expected_error']:.3f}: {sure['mean_probability']:.1%} "
            f"promised on average, {sure['within_reach']:.1%} found within reach",
            f"95 % credible region {sure['region_area']:.1%} of the tile on average; it holds "
            f"{sure['coverage']:.1%} of the true places",
        ]
        for count, one, many in (
            (
                self.settings["labels_left_out"],
                "label lies off its tile and was left out",
                "labels lie off their tiles and were left out",
            ),
            (
                self.outside,
                "sample has its true place outside the grid's extent",
                "samples have their true place outside the grid's extent",
            ),
            (
                self.settings["headings_outside_the_prior"],
                "sample has a true heading outside the heading prior",
                "samples have a true heading outside the heading prior",
            ),
            (len(self.unreadable), "sample could not be read", "samples could not be read"),
        ):
            if count:
                lines.append(f"{count:,} {one if count == 1 else many}")
        return "\n".join(lines)

    def rows(self) -> list[dict[str, Any]]:
        """One row a sample: index, name, truth, estimate, score and errors."""
        errors = asdict(self.errors)
        return [
            {
                "index": index,
                "name": name,
                **_named("true_", self.truths[n]),
                **_named("", self.estimates[n]),
                "score": float(self.scores[n]),
                "probability": float(self.calibration.probability[n]),
                "within_reach": bool(self.calibration.within_reach[n]),
                "in_credible_region": bool(self.calibration.in_credible_region[n]),
                "tile_metres": float(self.tile_metres[n]),
                **{f"error_{kind}": float(values[n]) for kind, values in errors.items()},
            }
            for n, (index, name) in enumerate(zip(self.indices, self.names, strict=True))
        ]


def write_results(evaluation: Evaluation, figures: dict[str, Figure], folder: Path) -> None:
    """Write every file whole; ``result.json``, which says that results are there, is the last.

    Raises
    ------
    RunError, PlotError
        If a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, figure in figures.items():
        save_figure(figure, folder / f"{name}.png")
    rows, table = evaluation.rows(), io.StringIO(newline="")
    writer = csv.DictWriter(table, list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    unreadable = (json.dumps(entry) + "\n" for entry in evaluation.unreadable)
    content = {**evaluation.summary(), "per_sample": rows}
    for name, text in (
        ("samples.csv", table.getvalue()),
        ("bad_samples.jsonl", "".join(unreadable)),
        ("result.json", json.dumps(content, indent=1, allow_nan=False) + "\n"),
    ):
        write_text(folder / name, text, RunError)


def _named(prefix: str, pose: NDArray[np.float64]) -> dict[str, float]:
    names = ("u", "v", "heading_deg")
    return {prefix + name: float(value) for name, value in zip(names, pose, strict=True)}
