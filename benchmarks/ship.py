"""How the run that ships was trained: generated places alone, on a processor.

``python -m benchmarks.ship`` trains two networks on generated places, and packs them together. Both
learn from images in other styles, at first all, later fewer, and their encoders are held near what
ImageNet taught them: what they learnt of generated places by their look alone would not hold on
photographs. One cuts its slices into bands of range, and is exact; the other has whole slices,
knows photographs best, and finds which way a street is looked along.

Their probabilities are tempered for photographs. What is there already is not done again, and
a training that was cut short goes on, so it may take several sittings. Processor time is printed at
the end of each step.
"""

import csv
import functools
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from PIL import Image
from slicematch.evaluation.calibration import calibrate
from slicematch.runs.folder import RunFolder
from torch.utils.data import Dataset

from benchmarks.commands import slicemask
from slicemask.images import read_image

PLAIN = (
    "--format", "vigor", "--cities", "1", "--panorama-size", "512x256", "--tile-size", "320",
)  # fmt: skip
VARIED = (*PLAIN, "--vary", "all")
# By the names of their folders.
PLACES = {
    "plain": (*PLAIN, "--seed", "1", "--panoramas", "800"),
    **{
        f"plain{seed}": (*PLAIN, "--seed", str(seed), "--panoramas", "400")
        for seed in range(11, 34)
    },
    "varied71": (*VARIED, "--seed", "71", "--panoramas", "3000", "--places", "100"),
    "varied73": (*VARIED, "--seed", "73", "--panoramas", "2000", "--places", "70"),
    "varied74": (*VARIED, "--seed", "74", "--panoramas", "2000", "--places", "70"),
    # By no network.
    "unseen": (*VARIED, "--seed", "29", "--panoramas", "640", "--places", "32"),
}  # fmt: skip
FIRST = ("plain", "plain11", "plain12", "plain13", "plain14", "varied71")
MORE = (*FIRST, "plain15", "plain16", "plain17")
FRESH = ("varied73", "plain15", "plain16", "plain17", "plain18", "plain19", "plain20")
NEW = ("varied74", *(f"plain{seed}" for seed in range(18, 34)))
TRAINING = (
    "--schedule", "one-cycle", "--augment", "--test-grid", "14x14x32", "--heat-map-every", "0",
    "--workers", "1", "--accelerator", "cpu",
)  # fmt: skip
OF_TABLES = (
    "--data", "table", "--batch-size", "8", "--validation-fraction", "0.02",
    "--encoder-rate", "0.2", "--freeze-statistics",
)  # fmt: skip
NETWORK = (
    "--encoder", "tf_efficientnet_lite0", "--weights", "imagenet", "--stride", "8",
    "--pyramid", "64", "--pyramid-to", "16", "--ground-size", "128,512", "--elevations=-30,30",
    "--aerial-size", "256", "--no-cross-view-attention",
)  # fmt: skip
# By the names of the runs, which those of the last steps have.
SLICES = {
    "banded": ("--slices", "32", "--bands", "6,12,24", "--camera-height-m", "2.5", "--alpha", "K"),
    "whole": ("--slices", "16"),
}


class Step(NamedTuple):
    """A training from where the one before has come to."""

    places: tuple[str, ...]
    epochs: int
    learning_rate: float
    restyle: float
    seed: int


STEPS = {
    "banded": (
        Step(FIRST, 2, 1e-3, 1.0, 5),
        Step(FIRST, 2, 7e-4, 0.5, 6),
        Step(MORE, 2, 6e-4, 0.4, 13),
        Step(FRESH, 2, 5e-4, 0.3, 32),
    ),
    "whole": (
        Step(FIRST, 3, 1e-3, 1.0, 5),
        Step(FIRST, 2, 6e-4, 0.6, 7),
        Step(FIRST, 2, 6e-4, 0.4, 11),
        Step(MORE, 2, 5e-4, 0.3, 12),
        Step(NEW, 2, 5e-4, 0.3, 33),
    ),
}
# The grid that most answers are asked on, and so the one that the temperature is fitted to.
GRID = "21x21x64"
# Photographs differ from generated places: with its factor a network's right answers, and with the
# last one those of both together, are likeliest on the nine real pairs, by the labels of
# `benchmarks.survey`. Besides choices, these are all that the real pairs decide.
FACTORS = {"banded": 1.35, "whole": 1.3, "together": 0.9}


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--work", default="runs/ship", show_default=True, help="Where data and runs go.")
@click.option("--out", default="runs/ship/generated-city", show_default=True, help="Packed run.")
def main(work: str, out: str) -> None:
    """Generate, train and pack the run that ships."""
    banded, whole = (train(Path(work), name) for name in SLICES)
    packed = RunFolder(Path(out))
    shutil.rmtree(out, ignore_errors=True)
    _slicemask("pack", str(banded), "--with", str(whole), "--checkpoint", "last", "--grid", GRID,
               "--out", out)  # fmt: skip
    # It is measured on trees in VIGOR's layout, as `synth` writes them, not on its own tables.
    as_vigor = replace(packed.load_config(), data="vigor", root="places", split="cross-area",
                       data_settings={"cities": ("NewYork", "SanFrancisco")})  # fmt: skip
    as_vigor.save(packed.config_file)
    temper(packed.calibration_file, FACTORS["banded"])
    temper(packed.members()[0].calibration_file, FACTORS["whole"])
    unseen = TurnedPairs(_table(Path(work), "unseen"))
    calibrate(out, dataset=unseen, device="cpu", workers=1)
    temper(packed.ensemble_file, FACTORS["together"])


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


def train(work: Path, name: str) -> Path:
    """All steps of a network; gives the last one's run, calibrated."""
    start = (*NETWORK, *SLICES[name])
    for number, step in enumerate(STEPS[name], 1):
        last = number == len(STEPS[name])
        run = work / (name if last else f"{name}{number}")
        if not (run / "calibration.json").exists():
            table = run.with_suffix(".csv")
            join([_table(work, places) for places in step.places], table)
            _slicemask("train", *TRAINING, *OF_TABLES, "--root", str(table), *start,
                       "--epochs", str(step.epochs), "--learning-rate", str(step.learning_rate),
                       "--restyle", str(step.restyle), "--seed", str(step.seed),
                       "--out", str(run), "--resume")  # fmt: skip
        start = ("--init", str(run))
    _slicemask("calibrate", str(run), "--grid", GRID, "--checkpoint", "last")
    return run


@functools.cache
def _table(work: Path, places: str) -> Path:
    """All pairs of generated places, which `synth` completes where some are missing."""
    root = work / places
    _slicemask("synth", *PLACES[places], "--out", str(root))
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


def temper(calibration: Path, factor: float) -> None:
    """Bring the temperature that was fitted to generated places to what photographs need."""
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
