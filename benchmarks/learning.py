"""Proof that the method learns: SliceMatch's Table 1 and range bands in small, on CPU.

``python -m benchmarks.learning`` generates two cities, trains the models of each row of the tables
on the first, evaluates them on the second, which none has seen, and keeps the figures in
``benchmarks/results/learning.json`` and the curves in ``docs/images/learning.svg``. Trainings that
are there already are not done again; one that was cut short goes on. Rows that are not asked for
keep their figures.
"""

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from benchmarks.commands import slicemask

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "benchmarks" / "results" / "learning.json"
PICTURE = ROOT / "docs" / "images" / "learning.svg"

CITY = (
    "--format", "vigor", "--cities", "2", "--panoramas", "800", "--seed", "1",
    "--panorama-size", "512x256", "--tile-size", "320",
)  # fmt: skip
# All rows: an encoder of 0.4 million weights, from random ones, cut at stride 8; 8 epochs.
SHARED = (
    "--data", "vigor", "--split", "cross-area", "--cities", "NewYork,SanFrancisco",
    "--encoder", "test_resnet", "--weights", "none", "--stride", "8",
    "--ground-size", "128,256", "--aerial-size", "256",
    "--batch-size", "8", "--learning-rate", "2e-3", "--schedule", "one-cycle", "--augment",
    "--epochs", "8", "--validation-fraction", "0.05", "--test-grid", "14x14x32",
    "--heat-map-every", "0", "--workers", "1", "--accelerator", "cpu",
)  # fmt: skip
TEST = ("--grid", "21x21x64", "--checkpoint", "last", "--limit", "400")


@dataclass(frozen=True)
class Row:
    """A row of a table: a setting, trained from some seeds and tested in some ways."""

    label: str
    flags: tuple[str, ...] = ()
    seeds: int = 1
    refines: tuple[str, ...] = ("none",)

    def runs(self, name: str) -> list[tuple[str, str]]:
        """Run folder and seed of each training."""
        return [(f"{name}_s{seed}" if seed else name, str(seed)) for seed in range(self.seeds)]


_ALONE = "--no-cross-view-attention"
_CROPPED = "--elevations=-45,45"
_FOUR = (_ALONE, "--bands", "6,12,24", _CROPPED)
_FINE = ("--slices", "32", "--alpha", "K")
_BOTH = ("none", "mean")
# SliceMatch's Table 1, by what differs from N = 16, alpha = 4, cross-view attention.
PAPER = {
    "n16": Row("N = 16"),
    "n01": Row("N = 1", ("--slices", "1")),
    "n04": Row("N = 4", ("--slices", "4")),
    "n08": Row("N = 8", ("--slices", "8")),
    "n32": Row("N = 32", ("--slices", "32")),
    "n16_alphaK": Row("N = 16, alpha = K", ("--alpha", "K")),
    "n16_nocva": Row("N = 16, no cross-view attention", (_ALONE,)),
}
# Bands of range: without cross-view attention, but for the last rows.
BANDS = {
    "b1": Row("B = 1", (_ALONE,), 3, _BOTH),
    "b2": Row("B = 2: 12 m", (_ALONE, "--bands", "12", _CROPPED), 1, _BOTH),
    "b3": Row("B = 3: 8, 20 m", (_ALONE, "--bands", "8,20", _CROPPED), 1, _BOTH),
    "b4": Row("B = 4: 6, 12, 24 m", _FOUR, 1, _BOTH),
    "b4_n32": Row("B = 4, N = 32, alpha = K", (*_FOUR, *_FINE), 1, _BOTH),
    "best": Row("the same, batches of 4", (*_FOUR, *_FINE, "--batch-size", "4"), 3, _BOTH),
    "b1_n32": Row(
        "B = 1, N = 32, alpha = K, batches of 4",
        (_ALONE, *_FINE, "--batch-size", "4"),
        1,
        _BOTH,
    ),
    "b1_cva": Row("B = 1, cross-view attention", (), 1, _BOTH),
    "b4_cva": Row("B = 4, cross-view attention", ("--bands", "6,12,24", _CROPPED), 1, _BOTH),
}
ROWS = PAPER | BANDS
# Rows whose curves are drawn.
DRAWN = ("n04", "n08", "n16", "n32", "b1", "b4", "best")
TABLES = {"SliceMatch's Table 1": PAPER, "Bands of range": BANDS}


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("rows", nargs=-1, type=click.Choice(list(ROWS)))
@click.option("--data", default="data/learning", show_default=True, help="Where the cities go.")
@click.option("--runs", default="runs/learning", show_default=True, help="Where the runs go.")
@click.option("--threads", default=1, show_default=True, help="Of a training.")
def main(rows: tuple[str, ...], data: str, runs: str, threads: int) -> None:
    """Train and test the ROWS named, or all, and print all that are there."""
    slicemask("synth", *CITY, "--out", data)
    found = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    for name in rows or ROWS:
        row = ROWS[name]
        for folder, seed in row.runs(name):
            _train_and_test(Path(runs) / folder, data, row, seed, threads)
        found[name] = _figures([Path(runs) / folder for folder, _ in row.runs(name)], row)
        found = {known: found[known] for known in ROWS if known in found}
        RESULTS.write_text(json.dumps(found, indent=2) + "\n")
    _draw(found)
    console = Console(width=None if sys.stdout.isatty() else 120)
    for title, table in TABLES.items():
        console.print(_table(title, {name: found[name] for name in table if name in found}))


def _train_and_test(run: Path, data: str, row: Row, seed: str, threads: int) -> None:
    """Train a run and test it, unless that is done."""
    if not (run / "cost.json").exists():
        cost = slicemask(
            "train", *SHARED, *row.flags, "--seed", seed, "--root", data, "--out", str(run),
            "--resume", threads=threads,
        )  # fmt: skip
        (run / "cost.json").write_text(json.dumps({**cost, "threads": threads}) + "\n")
    for refine in row.refines:
        out = run / f"unseen_{refine}"
        if not (out / "result.json").exists():
            slicemask(
                "evaluate", str(run), "--root", data, *TEST, "--refine", refine, "--out", str(out)
            )


def _figures(runs: list[Path], row: Row) -> dict[str, Any]:
    """What one row's runs came to."""
    by_refine = {
        refine: [json.loads((run / f"unseen_{refine}" / "result.json").read_text()) for run in runs]
        for refine in row.refines
    }
    first = by_refine[row.refines[0]][0]
    samples = first["per_sample"]
    # Guessing the tile's centre knows nothing of the image.
    centre = [np.hypot(s["true_u"] - 0.5, s["true_v"] - 0.5) * s["tile_metres"] for s in samples]
    metrics = [json.loads(line) for line in (runs[0] / "metrics.jsonl").read_text().splitlines()]
    return {
        "label": row.label,
        "seeds": row.seeds,
        "tests": {refine: _test_figures(results) for refine, results in by_refine.items()},
        "oracle": first["oracle"],
        "centre": {"place_mean_m": np.mean(centre), "place_median_m": np.median(centre)},
        "samples": len(samples),
        "training": json.loads((runs[-1] / "cost.json").read_text()),
        "curve": [
            {key: line[key] for key in ("epoch", "train/loss", "validation/place_median_m",
                                        "validation/heading_median_deg")}
            for line in metrics
        ],
    }  # fmt: skip


def _test_figures(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Errors, means over the seeds, with standard errors over the places; and readings of them."""
    place_m, heading_deg, probability = (
        np.array([[sample[key] for sample in result["per_sample"]] for result in results])
        for key in ("error_place_m", "error_heading_deg", "probability")
    )  # [seeds, samples]
    right, far, close = heading_deg <= 20, place_m > 15, place_m <= 8
    return {
        **errors_of(place_m, heading_deg),
        "by_seed": [
            _statistics(*seed) for seed in zip(place_m[:, None], heading_deg[:, None], strict=True)
        ],
        "readings": {
            "heading_within_20deg": right.mean(),
            "place_median_m_where_it_is": np.median(place_m[right]) if right.any() else None,
            "wrong_heading_of_those_beyond_15m": (~right[far]).mean() if far.any() else None,
            "probability_median_within_8m": np.median(probability[close]) if close.any() else None,
            "probability_median_beyond_8m":
                np.median(probability[~close]) if not close.all() else None,
        },
    }  # fmt: skip


def errors_of(place_m: np.ndarray, heading_deg: np.ndarray) -> dict[str, dict[str, float]]:
    """Mean and median of errors [seeds, samples], and their standard errors over the samples."""
    return {
        "errors": _statistics(place_m, heading_deg),
        "standard_errors": _standard_errors(place_m, heading_deg),
    }


def _statistics(place_m: np.ndarray, heading_deg: np.ndarray) -> dict[str, float]:
    """Mean and median errors [seeds, samples], each the mean over the seeds."""
    return {
        f"{kind}_{statistic.__name__}_{unit}": float(statistic(errors, axis=-1).mean())
        for kind, unit, errors in (("place", "m", place_m), ("heading", "deg", heading_deg))
        for statistic in (np.mean, np.median)
    }


def _standard_errors(place_m: np.ndarray, heading_deg: np.ndarray) -> dict[str, float]:
    """Standard errors of `_statistics`: bootstrap over the samples, the same for all seeds."""
    samples = place_m.shape[1]
    drawn = np.random.default_rng(0).integers(samples, size=(2000, samples))
    spread = [_statistics(place_m[:, chosen], heading_deg[:, chosen]) for chosen in drawn]
    return {key: float(np.std([some[key] for some in spread], ddof=1)) for key in spread[0]}


def _minutes(cost: dict[str, float]) -> str:
    """Processor time of a training; nothing of one that was trained by other means."""
    return f"{cost['processor_s'] / 60:.1f} min" if cost else ""


def _table(title: str, found: dict[str, dict[str, Any]]) -> Table:
    table = Table(
        "row", "refine", "seeds", "mean m", "median m", "mean deg", "median deg", "training",
        title=f"{title}: unseen city, unknown heading, 21x21x64 candidates; ± standard errors over "
        "the places",
    )  # fmt: skip
    for row in found.values():
        for refine, test in row["tests"].items():
            table.add_row(
                row["label"],
                refine,
                str(row["seeds"]),
                *(
                    f"{test['errors'][key]:.2f} ± {deviation:.2f}"
                    for key, deviation in test["standard_errors"].items()
                ),
                _minutes(row["training"]),
            )
    if found:
        row = next(iter(found.values()))
        for name, part, heading in (
            ("guessing the centre", row["centre"], ("90", "90")),
            ("oracle among the candidates", row["oracle"], None),
        ):
            heading = heading or [f"{part[f'heading_{k}_deg']:.2f}" for k in ("mean", "median")]
            places = (f"{part[f'place_{k}_m']:.2f}" for k in ("mean", "median"))
            table.add_row(name, "", "", *places, *heading, "")
    return table


def _draw(found: dict[str, dict[str, Any]]) -> None:
    """Curves of the validation errors, in the training city, over the epochs."""
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    panels = figure.subplots(1, 2)
    for name, row in found.items():
        if name not in DRAWN:
            continue
        epochs = [point["epoch"] + 1 for point in row["curve"]]
        for axes, key in zip(panels, ("place_median_m", "heading_median_deg"), strict=True):
            values = [point[f"validation/{key}"] for point in row["curve"]]
            axes.plot(epochs, values, "o-", markersize=3, label=ROWS[name].label)
    # A row that learns nothing (N = 1) stays above the picture.
    panels[0].set(xlabel="epoch", ylabel="median place error, m", ylim=(0, 20))
    panels[1].set(xlabel="epoch", ylabel="median heading error, degrees", ylim=(0, 60))
    for axes in panels:
        axes.grid(alpha=0.3)
    panels[0].legend(fontsize="small")
    figure.suptitle("Validation part of the training city, 14x14x32 candidates")
    PICTURE.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(PICTURE)


if __name__ == "__main__":
    main()
