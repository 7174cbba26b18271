"""Bands by depth on KITTI's format: lateral and longitudinal errors with and without them.

``python -m benchmarks.learning_kitti`` generates drives in KITTI's format, trains a small encoder
from random weights without bands and with bands of depth, the heading known to 10 degrees, tests
both in the unseen area, and keeps the figures in ``benchmarks/results/learning_kitti.json``.
Trainings that are there already are not done again; one that was cut short goes on.
"""

import json
import sys
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.commands import slicemask

RESULTS = Path(__file__).parent / "results" / "learning_kitti.json"
DRIVES = (
    "--format", "kitti", "--frames", "900", "--seed", "5", "--image-size", "424x128",
    "--tile-size", "512",
)  # fmt: skip
TRAINING = (
    "--data", "kitti", "--split", "cross-area", "--encoder", "test_resnet", "--weights", "none",
    "--stride", "8", "--ground-size", "128,424", "--aerial-size", "256", "--heading-prior", "10",
    "--no-cross-view-attention", "--batch-size", "4", "--learning-rate", "2e-3",
    "--schedule", "one-cycle", "--augment", "--epochs", "8", "--validation-fraction", "0.05",
    "--heat-map-every", "0", "--workers", "1", "--accelerator", "cpu", "--seed", "0",
)  # fmt: skip
ROWS = {
    "k1": ("B = 1", ()),
    "k4": ("B = 4: depths of 6, 12, 24 m", ("--bands", "6,12,24")),
}
REFINES = ("none", "mean")
WITHIN_M = (1, 3, 5)


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--data", default="data/learning-kitti", show_default=True)
@click.option("--runs", default="runs/learning", show_default=True)
@click.option("--threads", default=1, show_default=True, help="Of a training.")
def main(data: str, runs: str, threads: int) -> None:
    """Train and test without bands and with them."""
    slicemask("synth", *DRIVES, "--out", data)
    found = {}
    for name, (label, flags) in ROWS.items():
        run = Path(runs) / name
        if not (run / "calibration.json").exists():
            slicemask("train", *TRAINING, *flags, "--root", data, "--out", str(run), "--resume",
                      threads=threads)  # fmt: skip
        for refine in REFINES:
            out = run / f"unseen_{refine}"
            if not (out / "result.json").exists():
                slicemask("evaluate", str(run), "--checkpoint", "last", "--limit", "400",
                          "--refine", refine, "--out", str(out))  # fmt: skip
            result = json.loads((out / "result.json").read_text())
            found[f"{name}_{refine}"] = {"label": label, "refine": refine, **figures(result)}
    RESULTS.write_text(json.dumps(found, indent=2) + "\n")
    Console(width=None if sys.stdout.isatty() else 140).print(_table(found))


def figures(result: dict[str, Any]) -> dict[str, Any]:
    """Errors of one test, with their standard errors: bootstrap over the frames."""
    keys = ("place_m", "lateral_m", "longitudinal_m", "heading_deg")
    errors = np.array([[frame[f"error_{key}"] for key in keys] for frame in result["per_sample"]])
    drawn = np.random.default_rng(0).integers(len(errors), size=(2000, len(errors)))
    whole = _statistics(errors)
    spread = [_statistics(errors[chosen]) for chosen in drawn]
    deviations = {key: float(np.std([some[key] for some in spread], ddof=1)) for key in whole}
    return {"frames": len(errors), "errors": whole, "standard_errors": deviations}


def _statistics(errors: np.ndarray) -> dict[str, float]:
    """Of errors [frames, 4]: place, lateral, longitudinal, heading."""
    place, lateral, longitudinal, heading = errors.T
    found = {
        f"{name}_{statistic.__name__}": float(statistic(values))
        for name, values in (("place_m", place), ("heading_deg", heading))
        for statistic in (np.mean, np.median)
    }
    for name, values in (("lateral", lateral), ("longitudinal", longitudinal)):
        found[f"{name}_median_m"] = float(np.median(values))
        for metres in WITHIN_M:
            found[f"{name}_within_{metres}m"] = float(np.mean(values <= metres))
    return found


def _table(found: dict[str, dict[str, Any]]) -> Table:
    table = Table(
        "row", "refine", "mean m", "median m", "mean deg", "median deg",
        "lateral 1, 3, 5 m", "longitudinal 1, 3, 5 m",
        title="KITTI's format, unseen area, heading known to 10 degrees; ± standard errors",
    )  # fmt: skip
    for row in found.values():
        errors, deviations = row["errors"], row["standard_errors"]
        table.add_row(
            row["label"],
            row["refine"],
            *(
                f"{errors[key]:.1f} ± {deviations[key]:.1f}"
                for key in ("place_m_mean", "place_m_median",
                            "heading_deg_mean", "heading_deg_median")
            ),
            *(
                ", ".join(f"{errors[f'{way}_within_{metres}m']:.0%}" for metres in WITHIN_M)
                for way in ("lateral", "longitudinal")
            ),
        )  # fmt: skip
    return table


if __name__ == "__main__":
    main()
