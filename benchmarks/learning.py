"""Proof that the method learns: SliceMatch's Table 1 in small, trained and tested on CPU.

``python -m benchmarks.learning`` generates two cities, trains one model a row of the table on the
first, evaluates each on the second, which none has seen, and keeps the figures in
``benchmarks/results/learning.json`` and the curves in ``docs/images/learning.svg``. What is there
already is not done again; a run that was cut short goes on.
"""

import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

import click
import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

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
    "--heat-map-every", "0", "--workers", "1", "--accelerator", "cpu", "--seed", "0",
)  # fmt: skip
# The rows of the paper's Table 1, by what differs from N = 16, alpha = 4, cross-view attention.
ROWS: dict[str, tuple[str, ...]] = {
    "n16": (),
    "n01": ("--slices", "1"),
    "n04": ("--slices", "4"),
    "n08": ("--slices", "8"),
    "n32": ("--slices", "32"),
    "n16_alphaK": ("--alpha", "K"),
    "n16_nocva": ("--no-cross-view-attention",),
}
NAMES = {
    "n16": "N = 16",
    "n01": "N = 1",
    "n04": "N = 4",
    "n08": "N = 8",
    "n32": "N = 32",
    "n16_alphaK": "N = 16, alpha = K",
    "n16_nocva": "N = 16, no cross-view attention",
}
TEST = ("--grid", "21x21x64", "--refine", "none", "--checkpoint", "last", "--limit", "400")


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("rows", nargs=-1, type=click.Choice(list(ROWS)))
@click.option("--data", default="data/learning", show_default=True, help="Where the cities go.")
@click.option("--runs", default="runs/learning", show_default=True, help="Where the runs go.")
@click.option("--threads", default=1, show_default=True, help="Of a training.")
def main(rows: tuple[str, ...], data: str, runs: str, threads: int) -> None:
    """Train and test the ROWS of the table named, or all, and print all that are there."""
    _slicemask("synth", *CITY, "--out", data)
    for name in rows or ROWS:
        run = Path(runs) / name
        if not (run / "cost.json").exists():
            cost = _slicemask(
                "train", *SHARED, *ROWS[name], "--root", data, "--out", str(run), "--resume",
                threads=threads,
            )  # fmt: skip
            (run / "cost.json").write_text(json.dumps({**cost, "threads": threads}) + "\n")
        if not (run / "unseen" / "result.json").exists():
            _slicemask("evaluate", str(run), "--root", data, *TEST, "--out", str(run / "unseen"))
    found = {name: _figures(Path(runs) / name) for name in ROWS if _is_done(Path(runs) / name)}
    RESULTS.write_text(json.dumps(found, indent=2) + "\n")
    _draw(found)
    Console(width=None if sys.stdout.isatty() else 120).print(_table(found))


def _slicemask(*arguments: str, threads: int | None = None) -> dict[str, float]:
    """Run a command; give its wall and processor seconds."""
    click.echo("slicemask " + " ".join(arguments), err=True)
    environment = os.environ | ({} if threads is None else {"OMP_NUM_THREADS": str(threads)})
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run([sys.executable, "-m", "slicemask", *arguments], check=True, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"wall_s": round(time.perf_counter() - start), "processor_s": round(processor)}


def _is_done(run: Path) -> bool:
    return (run / "cost.json").exists() and (run / "unseen" / "result.json").exists()


def _figures(run: Path) -> dict:
    """What one row's run came to."""
    result = json.loads((run / "unseen" / "result.json").read_text())
    samples = result["per_sample"]
    place_m, heading_deg, probability = (
        np.array([sample[key] for sample in samples])
        for key in ("error_place_m", "error_heading_deg", "probability")
    )
    right, far, close = heading_deg <= 20, place_m > 15, place_m <= 8
    # Guessing the tile's centre knows nothing of the image.
    centre = [np.hypot(s["true_u"] - 0.5, s["true_v"] - 0.5) * s["tile_metres"] for s in samples]
    metrics = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    return {
        "errors": result["errors"],
        "standard_errors": _standard_errors(place_m, heading_deg),
        "readings": {
            "heading_within_20deg": right.mean(),
            "place_median_m_where_it_is": np.median(place_m[right]) if right.any() else None,
            "wrong_heading_of_those_beyond_15m": (~right[far]).mean() if far.any() else None,
            "probability_median_within_8m": np.median(probability[close]) if close.any() else None,
            "probability_median_beyond_8m":
                np.median(probability[~close]) if not close.all() else None,
        },
        "oracle": result["oracle"],
        "centre": {"place_mean_m": np.mean(centre), "place_median_m": np.median(centre)},
        "samples": len(samples),
        "training": json.loads((run / "cost.json").read_text()),
        "curve": [
            {key: line[key] for key in ("epoch", "train/loss", "validation/place_median_m",
                                        "validation/heading_median_deg")}
            for line in metrics
        ],
    }  # fmt: skip


def _standard_errors(place_m: np.ndarray, heading_deg: np.ndarray) -> dict[str, float]:
    """Standard errors of the means and medians: bootstrap over the samples."""
    drawn = np.random.default_rng(0).integers(len(place_m), size=(2000, len(place_m)))
    return {
        f"{kind}_{statistic.__name__}_{unit}": statistic(errors[drawn], axis=1).std(ddof=1)
        for kind, unit, errors in (("place", "m", place_m), ("heading", "deg", heading_deg))
        for statistic in (np.mean, np.median)
    }


def _table(found: dict[str, dict]) -> Table:
    table = Table(
        "row", "mean m", "median m", "mean deg", "median deg", "training, processor",
        title="Unseen city, unknown heading, 21x21x64 candidates; ± bootstrap standard errors",
    )  # fmt: skip
    for name, row in found.items():
        errors = row["errors"]
        table.add_row(
            NAMES[name],
            *(f"{errors[key]:.2f} ± {deviation:.2f}"
              for key, deviation in row["standard_errors"].items()),
            f"{row['training']['processor_s'] / 60:.1f} min",
        )  # fmt: skip
    if found:
        row = next(iter(found.values()))
        for name, part, heading in (
            ("guessing the centre", row["centre"], ("90", "90")),
            ("oracle among the candidates", row["oracle"], None),
        ):
            heading = heading or [f"{part[f'heading_{k}_deg']:.2f}" for k in ("mean", "median")]
            places = (f"{part[f'place_{k}_m']:.2f}" for k in ("mean", "median"))
            table.add_row(name, *places, *heading, "")
    return table


def _draw(found: dict[str, dict]) -> None:
    """Curves of the validation errors, in the training city, over the epochs."""
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    panels = figure.subplots(1, 2)
    for name, row in found.items():
        epochs = [point["epoch"] + 1 for point in row["curve"]]
        for axes, key in zip(panels, ("place_median_m", "heading_median_deg"), strict=True):
            values = [point[f"validation/{key}"] for point in row["curve"]]
            axes.plot(epochs, values, "o-", markersize=3, label=NAMES[name])
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
