"""The command on generated data: synth."""

import importlib
import time
from typing import Any

import click

from slicemask.cli.options import ImageSize, NameList, as_json_option
from slicemask.cli.output import print_result, progress_bar
from slicemask.synth.vary.switches import SWITCHES

_VARY_HELP = "VIGOR: domain randomisation, all or some of " + "; ".join(
    f"{switch.name} ({switch.help})" for switch in SWITCHES.values()
)

# The options of each format that not all have.
_OPTIONS = {
    "vigor": {
        "cities",
        "panoramas",
        "panorama_size",
        "places",
        "vary",
        "plain_places",
        "label_noise_m",
    },
    "kitti": {"frames", "image_size"},
    "table": {"panoramas", "panorama_size", "image_size"},
    "drive": {"drives", "seconds", "rate_hz", "panorama_size"},
}


@click.command()
@click.option(
    "--format", "kind", type=click.Choice(list(_OPTIONS)), required=True, help="Of the files."
)
@click.option("--out", metavar="DIR", required=True, help="Root of the data set.")
@click.option("--cities", type=int, help="VIGOR: cities, 1 to 4.  [default: 1]")
@click.option("--panoramas", type=int, help="VIGOR, table: per city.  [default: 400]")
@click.option("--places", type=int, help="VIGOR: layouts of each city.  [default: 1]")
@click.option("--vary", type=NameList(), help=f"{_VARY_HELP}.")
@click.option(
    "--plain-places", type=int, help="VIGOR: so many of the places do not vary.  [default: 0]"
)
@click.option(
    "--label-noise-m", type=float, help="VIGOR: deviation of the labels' errors.  [default: 0]"
)
@click.option("--frames", type=int, help="KITTI: frames in all.  [default: 200]")
@click.option("--drives", type=int, help="Drive: how many.  [default: 1]")
@click.option("--seconds", type=float, help="Drive: how long each takes.  [default: 60]")
@click.option("--rate-hz", type=float, help="Drive: frames a second.  [default: 10]")
@click.option("--seed", type=int, default=0, show_default=True, help="Each is another city.")
@click.option(
    "--panorama-size",
    type=ImageSize(),
    help="VIGOR, table, drive.  [default: 2048x1024, for drive 512x256]",
)
@click.option(
    "--image-size", type=ImageSize(), help="KITTI, table.  [default: 1242x375, for table 640x480]"
)
@click.option("--tile-size", type=int, help="Pixels a side.  [default: 640, for KITTI 1280]")
@click.option("--jobs", type=int, help="Processes.  [default: all processors]")
@as_json_option
def synth(kind: str, out: str, as_json: bool, **options: Any) -> None:
    """Generate a city with exact poses: VIGOR, KITTI, a map, or drives.

    An interrupted command continues where it stopped when it is repeated.
    """
    try:
        generate = getattr(importlib.import_module("slicemask.synth"), f"generate_{kind}")
    except ModuleNotFoundError as error:
        extras = "synth,maps" if kind in ("table", "drive") else "synth"
        raise click.ClickException(
            f"slicemask synth needs {error.name}: pip install 'slicemask[{extras}]'"
        ) from error
    others = set().union(*_OPTIONS.values()) - _OPTIONS[kind]
    asked = {name: value for name, value in options.items() if value is not None}
    for name in sorted(asked.keys() & others):
        raise click.UsageError(f"--{name.replace('_', '-')} does not belong to --format {kind}.")
    start = time.perf_counter()
    with progress_bar("rendering", "images") as progress:
        result = generate(out, **asked, progress=progress)
    content = {
        "path": str(result.path),
        "images": result.images,
        "rendered": result.rendered,
        "seconds": round(time.perf_counter() - start, 3),
    }
    text = "{path}: {images} images, {rendered} of them rendered now, in {seconds:.1f} s"
    print_result(as_json, content, text.format(**content))
