"""How the run that ships was trained: generated places alone, on a processor.

``python -m benchmarks.ship`` generates places of great variety, trains a small pretrained encoder
on them, and packs the result. What is there already is not done again, and a training that was cut
short goes on, so it may take several sittings. Processor time is printed at the end of each step.
"""

import shutil
from pathlib import Path

import click

from benchmarks.commands import slicemask

CITY = (
    "--format", "vigor", "--cities", "1", "--panorama-size", "512x256", "--tile-size", "320",
    "--vary", "all", "--panoramas", "1500", "--places", "30", "--seed", "23",
)  # fmt: skip
TRAINING = (
    "--data", "vigor", "--split", "cross-area", "--cities", "NewYork,SanFrancisco",
    "--epochs", "11", "--learning-rate", "5e-4", "--batch-size", "4", "--schedule", "one-cycle",
    "--augment", "--validation-fraction", "0.05",
    "--test-grid", "14x14x32", "--heat-map-every", "0", "--workers", "1", "--accelerator", "cpu",
    "--precision", "bf16-mixed", "--seed", "0",
)  # fmt: skip
NETWORK = (
    "--encoder", "tf_efficientnet_lite0", "--weights", "imagenet", "--stride", "8",
    "--pyramid", "64", "--pyramid-to", "16", "--ground-size", "128,512", "--elevations=-30,30",
    "--aerial-size", "256", "--slices", "32", "--bands", "6,12,24", "--no-cross-view-attention",
    "--alpha", "K",
)  # fmt: skip
# The grid that most answers are asked on, and so the one that the temperature is fitted to.
GRID = "21x21x64"


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--work", default="runs/ship", show_default=True, help="Where data and runs go.")
@click.option("--out", default="runs/ship/generated-city", show_default=True, help="Packed run.")
def main(work: str, out: str) -> None:
    """Generate, train and pack the run that ships."""
    data, run = Path(work) / "places", Path(work) / "run"
    _slicemask("synth", *CITY, "--out", str(data))
    if not (run / "calibration.json").exists():
        _slicemask("train", *TRAINING, *NETWORK, "--root", str(data), "--out", str(run), "--resume")
    _slicemask("calibrate", str(run), "--grid", GRID, "--checkpoint", "last")
    shutil.rmtree(out, ignore_errors=True)
    _slicemask("pack", str(run), "--checkpoint", "last", "--grid", GRID, "--out", out)


def _slicemask(*arguments: str) -> None:
    """Run a command on one thread, and say what it cost."""
    minutes = slicemask(*arguments, threads=1)["processor_s"] / 60
    click.echo(f"{arguments[0]}: {minutes:.1f} minutes of a processor", err=True)


if __name__ == "__main__":
    main()
