"""What each switch of domain randomisation does by itself: on photographs, and in a plain city.

``python -m benchmarks.switches PAIRS`` generates a small data set without variety, one with each
switch of ``slicemask synth --vary`` alone and one with all of them, trains a smaller network than
that of `benchmarks.ship` on each, and asks every run for the real pairs of `benchmarks.real_pairs`
and for a plain city that none has seen. Figures are kept in ``benchmarks/results/switches.json``.
What is there already is not done again, and a training that was cut short goes on.
"""

import json
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks import learning, ship
from benchmarks.commands import python_module, slicemask
from slicemask.synth.vary.switches import SWITCHES

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "benchmarks" / "results" / "switches.json"
SIZES = ("--format", "vigor", "--panorama-size", "512x256", "--tile-size", "320")
# Every data set has the same places but for what the switch draws.
PLACES = (*SIZES, "--cities", "1", "--seed", "31", "--panoramas", "200", "--places", "10")
# Of the plain cities the second is the one that is asked.
PLAIN = (*SIZES, "--cities", "2", "--seed", "1", "--panoramas", "100")
# The network with bands that ships, on half as many columns and slices.
TRAINING = (
    *ship.TRAINING, *ship.NETWORK, *ship.SLICES["banded"],
    "--data", "vigor", "--split", "cross-area", "--cities", "NewYork,SanFrancisco",
    "--batch-size", "4", "--validation-fraction", "0.05", "--seed", "0",
    "--ground-size", "128,256", "--slices", "16", "--learning-rate", "5e-4", "--epochs", "5",
)  # fmt: skip
TEST = ("--grid", ship.GRID, "--checkpoint", "last", "--refine", "mean", "--limit", "100")
ROWS = ("none", *SWITCHES, "all")


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("pairs", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--row", "rows", multiple=True, type=click.Choice(ROWS), help="[default: all]")
@click.option("--work", default="runs/switches", show_default=True, help="Where data and runs go.")
def main(pairs: Path, rows: tuple[str, ...], work: str) -> None:
    """Train with each switch alone, and measure on the real PAIRS and in an unseen city."""
    city = str(Path(work) / "plain")
    slicemask("synth", *PLAIN, "--out", city)
    found = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    for name in rows or ROWS:
        data, run = Path(work) / f"{name}_data", Path(work) / name
        _train(name, data, run)
        found[name] = _measure(run, pairs, city)
        found = {known: found[known] for known in ROWS if known in found}
        RESULTS.write_text(json.dumps(found, indent=2) + "\n")
    Console(width=120).print(_table(found))


def _train(name: str, data: Path, run: Path) -> None:
    if (run / "calibration.json").exists():
        return
    vary = () if name == "none" else ("--vary", name)
    slicemask("synth", *PLACES, *vary, "--out", str(data))
    slicemask(
        "train", *TRAINING, "--root", str(data), "--out", str(run), "--resume", threads=1
    )  # fmt: skip


def _measure(run: Path, pairs: Path, city: str) -> dict[str, Any]:
    """Errors on the real pairs and in the plain city, from what is there or measured now."""
    real, unseen = run / "real_pairs.json", run / "unseen"
    if not real.exists():
        python_module(
            "benchmarks.real_pairs", str(run), str(pairs), "--checkpoint", "last",
            "--out", str(real), threads=1,
        )  # fmt: skip
    if not (unseen / "result.json").exists():
        slicemask("evaluate", str(run), "--root", city, *TEST, "--out", str(unseen), threads=1)
    samples = json.loads((unseen / "result.json").read_text())["per_sample"]
    errors = (
        np.array([[sample[key] for sample in samples]])
        for key in ("error_place_m", "error_heading_deg")
    )
    return {
        "real": json.loads(real.read_text())["figures"],
        "unseen": learning.errors_of(*errors),
    }


def _table(found: dict[str, dict[str, Any]]) -> Table:
    table = Table(
        "switch", "real: within 20 deg", "median m", "right", "city: mean m", "median m",
        "mean deg", "median deg",
        title="Nine real pairs and a plain unseen city, heading unknown; ± standard errors",
    )  # fmt: skip
    for name, row in found.items():
        real, unseen = row["real"], row["unseen"]
        table.add_row(
            name,
            f"{real['heading_within_20deg']:.0%} ± {real['heading_within_20deg_se']:.0%}",
            f"{real['place_median_m']:.1f} ± {real['place_median_m_se']:.1f}",
            f"{real['right']:.0%} ± {real['right_se']:.0%}",
            *(f"{error:.1f} ± {unseen['standard_errors'][key]:.1f}"
              for key, error in unseen["errors"].items()),
        )  # fmt: skip
    return table


if __name__ == "__main__":
    main()
