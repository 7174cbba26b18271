"""How the run that ships was trained: generated places alone, on a processor.

``python -m benchmarks.ship`` generates places of great variety, trains a small pretrained encoder
on them, trains on from there on more places, half of them plain, takes the mean of both trainings'
weights (Wortsman and others, *Robust fine-tuning of zero-shot models*, CVPR 2022), tempers its
probabilities for photographs, and packs the result. What is there already is not done again, and a
training that was cut short goes on, so it may take several sittings. Processor time is printed at
the end of each step.
"""

import json
import shutil
from pathlib import Path

import click
import torch

from benchmarks.commands import slicemask

CITY = (
    "--format", "vigor", "--cities", "1", "--panorama-size", "512x256", "--tile-size", "320",
    "--vary", "all", "--seed", "23",
)  # fmt: skip
VARIED = ("--panoramas", "1500", "--places", "30")
MIXED = ("--panoramas", "5000", "--places", "100", "--plain-places", "40")
TRAINING = (
    "--data", "vigor", "--split", "cross-area", "--cities", "NewYork,SanFrancisco",
    "--batch-size", "4", "--schedule", "one-cycle", "--augment", "--validation-fraction", "0.05",
    "--test-grid", "14x14x32", "--heat-map-every", "0", "--workers", "1", "--accelerator", "cpu",
    "--seed", "0",
)  # fmt: skip
NETWORK = (
    "--encoder", "tf_efficientnet_lite0", "--weights", "imagenet", "--stride", "8",
    "--pyramid", "64", "--pyramid-to", "16", "--ground-size", "128,512", "--elevations=-30,30",
    "--aerial-size", "256", "--slices", "32", "--bands", "6,12,24", "--no-cross-view-attention",
    "--alpha", "K",
)  # fmt: skip
# The grid that most answers are asked on, and so the one that the temperature is fitted to.
GRID = "21x21x64"
# Photographs are harder than generated places, and scores surer of them than they should be. With
# this factor the mean probability is the share of right answers on the nine real pairs, with the
# heading unknown and known to 20 degrees alike: the one thing besides choices that they decide.
PHOTOGRAPHS = 1.35


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--work", default="runs/ship", show_default=True, help="Where data and runs go.")
@click.option("--out", default="runs/ship/generated-city", show_default=True, help="Packed run.")
def main(work: str, out: str) -> None:
    """Generate, train, average and pack the run that ships."""
    varied, mixed = Path(work) / "varied", Path(work) / "mixed"
    first, second, mean = (Path(work) / name for name in ("first", "second", "mean"))
    _slicemask("synth", *CITY, *VARIED, "--out", str(varied))
    _train(first, varied, *NETWORK, "--epochs", "11", "--learning-rate", "5e-4")
    _slicemask("synth", *CITY, *MIXED, "--out", str(mixed))
    _train(second, mixed, "--init", str(first), "--epochs", "2", "--learning-rate", "2e-4")
    average(first, second, mean)
    _slicemask("calibrate", str(mean), "--grid", GRID, "--checkpoint", "last")
    temper(mean / "calibration.json")
    shutil.rmtree(out, ignore_errors=True)
    _slicemask("pack", str(mean), "--checkpoint", "last", "--grid", GRID, "--out", out)


def _train(run: Path, data: Path, *flags: str) -> None:
    if not (run / "calibration.json").exists():
        _slicemask("train", *TRAINING, *flags, "--root", str(data), "--out", str(run), "--resume")


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


def temper(calibration: Path) -> None:
    """Raise the temperature that was fitted to generated places to what photographs need."""
    content = json.loads(calibration.read_text(encoding="utf-8"))
    fitted = content.setdefault("fitted_temperature", content["temperature"])
    content["temperature"] = round(fitted * PHOTOGRAPHS, 6)
    calibration.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _slicemask(*arguments: str) -> None:
    """Run a command on one thread, and say what it cost."""
    minutes = slicemask(*arguments, threads=1)["processor_s"] / 60
    click.echo(f"{arguments[0]}: {minutes:.1f} minutes of a processor", err=True)


if __name__ == "__main__":
    main()
