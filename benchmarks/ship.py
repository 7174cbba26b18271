"""How the run that ships was trained: generated places alone, on a processor.

``python -m benchmarks.ship`` trains two networks on generated places, and packs them together:

- With bands of range: on places of great variety, from there on more places, half of them plain,
  and the mean of both trainings' weights (Wortsman and others, *Robust fine-tuning of zero-shot
  models*, CVPR 2022).
- With whole slices: on places nearly half of which are plain, in other styles, its encoders held
  near what ImageNet taught them. It knows photographs best, and finds what the first one does not,
  such as crossings.

Probabilities are tempered for photographs. What is there already is not done again, and a training
that was cut short goes on, so it may take several sittings. Processor time is printed at the end of
each step.
"""

import csv
import json
import shutil
from pathlib import Path
from typing import Any

import click
import numpy as np
import torch
from PIL import Image
from slicematch.evaluation.calibration import calibrate
from torch.utils.data import Dataset

from benchmarks.commands import slicemask
from slicemask.images import read_image

PLAIN = (
    "--format", "vigor", "--cities", "1", "--panorama-size", "512x256", "--tile-size", "320",
)  # fmt: skip
VARIED = (*PLAIN, "--vary", "all")
# By the names of their folders.
PLACES = {
    "varied": (*VARIED, "--seed", "23", "--panoramas", "1500", "--places", "30"),
    "mixed": (
        *VARIED, "--seed", "23", "--panoramas", "5000", "--places", "100", "--plain-places", "40",
    ),
    "plain": (*PLAIN, "--seed", "1", "--panoramas", "800"),
    "plain11": (*PLAIN, "--seed", "11", "--panoramas", "400"),
    "plain12": (*PLAIN, "--seed", "12", "--panoramas", "400"),
    "plain13": (*PLAIN, "--seed", "13", "--panoramas", "400"),
    "plain14": (*PLAIN, "--seed", "14", "--panoramas", "400"),
    "further": (*VARIED, "--seed", "71", "--panoramas", "3000", "--places", "100"),
    # By no network.
    "unseen": (*VARIED, "--seed", "29", "--panoramas", "640", "--places", "32"),
}  # fmt: skip
OF_WHOLE_SLICES = ("plain", "plain11", "plain12", "plain13", "plain14", "further")
TRAINING = (
    "--schedule", "one-cycle", "--augment", "--test-grid", "14x14x32", "--heat-map-every", "0",
    "--workers", "1", "--accelerator", "cpu", "--seed", "0",
)  # fmt: skip
OF_VIGOR = (
    "--data", "vigor", "--split", "cross-area", "--cities", "NewYork,SanFrancisco",
    "--batch-size", "4", "--validation-fraction", "0.05",
)  # fmt: skip
NETWORK = (
    "--encoder", "tf_efficientnet_lite0", "--weights", "imagenet", "--stride", "8",
    "--pyramid", "64", "--pyramid-to", "16", "--ground-size", "128,512", "--elevations=-30,30",
    "--aerial-size", "256", "--no-cross-view-attention",
)  # fmt: skip
BANDS = ("--slices", "32", "--bands", "6,12,24", "--alpha", "K")
OF_STYLES = ("--encoder-rate", "0.2", "--freeze-statistics")
# The grid that most answers are asked on, and so the one that the temperature is fitted to.
GRID = "21x21x64"
# Photographs are harder than generated places, and the first network is surer of them than it
# should be. With its factor, and with that of both together, the probabilities of being right are
# nearest to the shares of right answers on the nine real pairs, with the heading unknown and known
# to 20 degrees alike. The network that has seen other styles is less sure than it could be: with
# its factor the right answers are likeliest, and it counts for more. The last two are by the labels
# of `benchmarks.survey`. Besides choices, these are all that the real pairs decide.
BANDED, RESTYLED, TOGETHER = 1.35, 0.85, 1.1


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--work", default="runs/ship", show_default=True, help="Where data and runs go.")
@click.option("--out", default="runs/ship/generated-city", show_default=True, help="Packed run.")
def main(work: str, out: str) -> None:
    """Generate, train, average and pack the run that ships."""
    banded, restyled = of_bands(Path(work)), of_styles(Path(work))
    shutil.rmtree(out, ignore_errors=True)
    _slicemask("pack", str(banded), "--with", str(restyled), "--checkpoint", "last", "--grid", GRID,
               "--out", out)  # fmt: skip
    temper(Path(out) / "calibration.json", BANDED)
    temper(Path(out) / "members" / restyled.name / "calibration.json", RESTYLED)
    table = as_table(_places(Path(work), "unseen"))
    calibrate(out, dataset=TurnedPairs(table), device="cpu", workers=1)
    temper(Path(out) / "ensemble.json", TOGETHER)


class TurnedPairs(Dataset[dict[str, Any]]):
    """Pairs of a table as `calibrate` takes a program's own, with panoramas that face anywhere."""

    def __init__(self, table: Path) -> None:
        self.folder = table.parent
        with table.open(encoding="utf-8", newline="") as file:
            self.rows = list(csv.DictReader(file))

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, index: int) -> dict[str, Any]:
        row = self.rows[index]
        panorama = np.asarray(read_image(self.folder / row["ground"]))
        turn = int(np.random.default_rng(index).integers(panorama.shape[1]))
        heading_deg = float(row["heading_deg"]) + 360.0 * turn / panorama.shape[1]
        return {
            "ground": Image.fromarray(np.roll(panorama, -turn, axis=1)),
            "aerial": read_image(self.folder / row["tile"]),
            "pose": (float(row["u"]), float(row["v"]), heading_deg % 360.0),
            "metres_per_pixel": float(row["metres_per_pixel"]),
        }


def of_bands(work: Path) -> Path:
    """The network whose slices are cut into bands."""
    first, second, mean = (work / name for name in ("first", "second", "mean"))
    varied = ("--root", str(_places(work, "varied")))
    _train(first, *OF_VIGOR, *varied, *NETWORK, *BANDS, "--epochs", "11", "--learning-rate", "5e-4")
    mixed = ("--root", str(_places(work, "mixed")))
    _train(second, *OF_VIGOR, *mixed, "--init", str(first), "--epochs", "2",
           "--learning-rate", "2e-4")  # fmt: skip
    average(first, second, mean)
    _slicemask("calibrate", str(mean), "--grid", GRID, "--checkpoint", "last")
    return mean


def of_styles(work: Path) -> Path:
    """The network of whole slices that has seen its places in other styles, at last in fewer."""
    first, second, run = (work / name for name in ("styled", "further-styled", "restyled"))
    flags = (*_of_tables(work), *OF_STYLES)
    _train(first, *flags, *NETWORK, "--slices", "16", "--epochs", "3", "--learning-rate", "1e-3",
           "--restyle", "1", "--seed", "5")  # fmt: skip
    again = (*flags, "--epochs", "2", "--learning-rate", "6e-4")
    _train(second, *again, "--init", str(first), "--restyle", "0.6", "--seed", "7")
    _train(run, *again, "--init", str(second), "--restyle", "0.4", "--seed", "11")
    _slicemask("calibrate", str(run), "--grid", GRID, "--checkpoint", "last")
    return run


def _of_tables(work: Path) -> tuple[str, ...]:
    """Flags that name one table of the pairs for the network of whole slices."""
    table = work / "whole.csv"
    join([as_table(_places(work, name)) for name in OF_WHOLE_SLICES], table)
    return (
        "--data", "table", "--root", str(table), "--batch-size", "8",
        "--validation-fraction", "0.02",
    )  # fmt: skip


def _places(work: Path, name: str) -> Path:
    """The folder of generated places, which `synth` fills where it is not yet full."""
    _slicemask("synth", *PLACES[name], "--out", str(work / name))
    return work / name


def _train(run: Path, *flags: str) -> None:
    if not (run / "calibration.json").exists():
        _slicemask("train", *TRAINING, *flags, "--out", str(run), "--resume")


def as_table(root: Path) -> Path:
    """All pairs of generated places as a table beside their folder."""
    table = root.with_suffix(".csv")
    _slicemask("table", "from-vigor", str(root), "--split", "same-area", "--cities", "NewYork",
               "--out", str(table), "--overwrite")  # fmt: skip
    return table


def join(tables: list[Path], joined: Path) -> None:
    """One table of all pairs, to train on; identifiers begin with their table's name."""
    rows = []
    for table in tables:
        with table.open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file):
                rows.append({**row, "split": "train", "id": f"{table.stem}/{row['id']}"})
    with joined.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


def average(first: Path, second: Path, mean: Path) -> None:
    """A copy of the first run whose last weights are the mean of both runs' last ones."""
    shutil.rmtree(mean, ignore_errors=True)
    shutil.copytree(first, mean, ignore=shutil.ignore_patterns("best.ckpt", "calibration.json"))
    ours, theirs = (
        torch.load(run / "checkpoints" / "last.ckpt", map_location="cpu", weights_only=True)
        for run in (first, second)
    )
    for name, value in ours["state_dict"].items():
        if value.is_floating_point():
            value.add_(theirs["state_dict"][name]).div_(2)
    torch.save(ours, mean / "checkpoints" / "last.ckpt")


def temper(calibration: Path, factor: float) -> None:
    """Raise the temperature that was fitted to generated places to what photographs need."""
    content = json.loads(calibration.read_text(encoding="utf-8"))
    fitted = content.setdefault("fitted_temperature", content["temperature"])
    content["temperature"] = round(fitted * factor, 6)
    calibration.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _slicemask(*arguments: str) -> None:
    """Run a command on one thread, and say what it cost."""
    minutes = slicemask(*arguments, threads=1)["processor_s"] / 60
    click.echo(f"{arguments[0]}: {minutes:.1f} minutes of a processor", err=True)


if __name__ == "__main__":
    main()
