"""How many channels slices are pooled in: what a narrower projection costs, and what it saves.

``python -m benchmarks.widths`` trains the network of ``make demo`` with 32, 64 and 128 channels and
two seeds on one generated city, asks each run for another city, and times its answers. Figures are
kept in ``benchmarks/results/widths.json``. What is there already is not done again, and a training
that was cut short goes on.
"""

import json
import os
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks import learning
from benchmarks.commands import slicemask

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "benchmarks" / "results" / "widths.json"
CITIES = ("--format", "vigor", "--cities", "2", "--panoramas", "400", "--seed", "1",
          "--panorama-size", "512x256", "--tile-size", "320")  # fmt: skip
SETTINGS = ROOT / "examples" / "demo.yaml"
GRID = ("--grid", "21x21x64")
TEST = (*GRID, "--checkpoint", "last", "--limit", "200")
WIDTHS, SEEDS, TIMINGS = (32, 64, 128), (0, 1), 3


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--work", default="runs/widths", show_default=True, help="Where data and runs go.")
def main(work: str) -> None:
    """Train with each width, and measure in an unseen city."""
    data = Path(work) / "data"
    slicemask("synth", *CITIES, "--out", str(data))
    runs = {width: [Path(work) / f"{width}-{seed}" for seed in SEEDS] for width in WIDTHS}
    for width, some in runs.items():
        for seed, run in zip(SEEDS, some, strict=True):
            _train(width, seed, data, run)
    found = {str(width): _measure(some) for width, some in runs.items()}
    for name, seconds in _time({str(width): some[0] for width, some in runs.items()}).items():
        found[name] |= seconds
    RESULTS.write_text(json.dumps(found, indent=2) + "\n")
    Console(width=110).print(_table(found))


def _train(width: int, seed: int, data: Path, run: Path) -> None:
    unseen = run / "unseen"
    if not (unseen / "result.json").exists():
        slicemask(
            "train", "--config", str(SETTINGS), "--root", str(data), "--pyramid", str(width),
            "--seed", str(seed), "--out", str(run), "--resume", threads=1,
        )  # fmt: skip
        slicemask("evaluate", str(run), *TEST, "--out", str(unseen), "--overwrite", threads=1)


def _measure(runs: list[Path]) -> dict[str, Any]:
    """Errors in the unseen city, the mean over the seeds."""
    samples = [json.loads((run / "unseen" / "result.json").read_text())["per_sample"]
               for run in runs]  # fmt: skip
    errors = (
        np.array([[sample[key] for sample in some] for some in samples])
        for key in ("error_place_m", "error_heading_deg")
    )
    return learning.errors_of(*errors)


def _time(runs: dict[str, Path]) -> dict[str, dict[str, float]]:
    """Medians of encoding and scoring, taken in turns, on one thread."""
    found: dict[str, dict[str, list[float]]] = {
        name: {"encode_s": [], "score_s": []} for name in runs
    }
    one_thread = os.environ | {"OMP_NUM_THREADS": "1"}
    for _ in range(TIMINGS):
        for name, run in runs.items():
            command = [sys.executable, "-m", "slicemask", "benchmark", str(run), *GRID, "--json"]
            timed = json.loads(subprocess.check_output(command, text=True, env=one_thread))
            for part, seconds in found[name].items():
                seconds.append(timed[part])
    return {
        name: {part: round(statistics.median(seconds), 4) for part, seconds in parts.items()}
        for name, parts in found.items()
    }


def _table(found: dict[str, dict[str, Any]]) -> Table:
    table = Table(
        "channels", "mean m", "median m", "mean deg", "median deg", "encoding s", "scoring s",
        title="An unseen city, heading unknown, mean of two seeds; ± standard errors over places",
    )  # fmt: skip
    for name, row in found.items():
        table.add_row(
            name,
            *(f"{error:.2f} ± {row['standard_errors'][key]:.2f}"
              for key, error in row["errors"].items()),
            f"{row['encode_s']:.3f}",
            f"{row['score_s']:.3f}",
        )  # fmt: skip
    return table


if __name__ == "__main__":
    main()
