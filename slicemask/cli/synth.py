"""The command on generated data: synth."""

import time
from typing import Any

import click

from slicemask.cli.options import ImageSize, NameList, as_json_option
from slicemask.cli.output import print_result, progress_bar
from slicemask.synth.vary.switches import SWITCHES

_VARY_HELP = "VIGOR: domain randomisation, all or some of " + "; ".join(
    f"{switch.name} ({switch.help})" for switch in SWITCHES.values()
)


@click.command()
@click.option(
    "--format", "kind", type=click.Choice(["vigor", "kitti"]), required=True, help="Of the files."
)
@click.option("--out", metavar="DIR", required=True, help="Root of the data set.")
@click.option("--cities", type=int, help="VIGOR: cities, 1 to 4.  [default: 1]")
@click.option("--panoramas", type=int, help="VIGOR: panoramas per city.  [default: 400]")
@click.option("--places", type=int, help="VIGOR: layouts of each city.  [default: 1]")
@click.option("--vary", type=NameList(), help=f"{_VARY_HELP}.")
@click.option(
    "--label-noise-m", type=float, help="VIGOR: deviation of the labels' errors.  [default: 0]"
)
@click.option("--frames", type=int, help="KITTI: frames in all.  [default: 200]")
@click.option("--seed", type=int, default=0, show_default=True, help="Each is another city.")
@click.option("--panorama-size", type=ImageSize(), help="VIGOR's panoramas.  [default: 2048x1024]")
@click.option("--image-size", type=ImageSize(), help="KITTI's ground images.  [default: 1242x375]")
@click.option("--tile-size", type=int, help="Pixels a side.  [default: 640, for KITTI 1280]")
@click.option("--jobs", type=int, help="Processes.  [default: all processors]")
@as_json_option
def synth(kind: str, out: str, as_json: bool, **options: Any) -> None:
    """Generate a city with exact poses, on disk as VIGOR or KITTI.

    An interrupted command continues where it stopped when it is repeated.
    """
    try:
        from slicemask.synth import generate_kitti, generate_vigor
    except ModuleNotFoundError as error:
        raise click.ClickException(
            f"slicemask synth needs {error.name}: pip install 'slicemask[synth]'"
        ) from error
    others = (
        ("frames", "image_size")
        if kind == "vigor"
        else ("cities", "panoramas", "panorama_size", "places", "vary", "label_noise_m")
    )
    asked = {name: value for name, value in options.items() if value is not None}
    for name in asked.keys() & set(others):
        raise click.UsageError(f"--{name.replace('_', '-')} does not belong to --format {kind}.")
    generate = generate_vigor if kind == "vigor" else generate_kitti
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
