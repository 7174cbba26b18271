"""The command that follows a camera on a map: track."""

from typing import Any

import click

from slicemask.cli.imports import without_collection
from slicemask.cli.messages import messages_on_stderr
from slicemask.cli.options import Numbers, as_json_option, cache_option, given_options
from slicemask.cli.output import print_result, progress_bar, status_line
from slicemask.cli.places import Heading, Length, map_crs_option, map_option
from slicemask.cli.run_options import (
    check_model_installed,
    checkpoint_option,
    device_option,
    precision_option,
    run_argument,
)

# Of a compass, where a heading is given without how far it may be off.
_HEADING_DEG = 15.0


@click.command()
@run_argument
@click.option(
    "--drive",
    required=True,
    metavar="PATH",
    help="A table of frames, a KITTI raw drive, or a ROS bag (.mcap, .bag, a ROS 2 bag's folder).",
)
@map_option()
@click.option(
    "--out", required=True, metavar="FILE", help="The track: .tum, .txt (KITTI), .geojson, .csv, "
    ".mcap."
)  # fmt: skip
@click.option("--near", type=Numbers("lat,lon"), help="Where it begins.  [default: its first fix]")
@click.option(
    "--within",
    "within_m",
    type=Length(),
    help="How far from there, about.  [default: anywhere in the tile; with --no-fixes the first "
    "one's accuracy, at least 20 m]",
)
@click.option("--heading", type=Heading(), help="At the start, such as 90+-15.  [default: any]")
@click.option(
    "--fixes/--no-fixes", default=True, show_default=True, help="Use GNSS along the way, not only "
    "where it begins."
)  # fmt: skip
@click.option("--smooth", "smoothed", is_flag=True, help="Let later frames have a say too.")
@click.option("--picture", metavar="FILE", help="The track on its map: PNG, SVG, PDF.")
@click.option("--animation", metavar="FILE", help="The track frame by frame: GIF.")
@click.option("--rerun", metavar="FILE", help="For the Rerun viewer: .rrd.")
@click.option("--image-topic", help="Of a bag.  [default: its only one of images]")
@click.option("--odometry-topic", help="Of a bag.  [default: its only one of odometry]")
@click.option("--imu-topic", help="Of a bag, for yaw rates.  [default: its only one]")
@click.option("--fix-topic", help="Of a bag, NavSatFix.  [default: its only one]")
@map_crs_option
@click.option(
    "--tile-side", "side_m", type=Length(), help="Of the tiles that are cut.  [default: the run's]"
)
@checkpoint_option
@device_option
@precision_option
@cache_option
@as_json_option
def track(
    run: str,
    drive: str,
    aerial_map: str,
    out: str,
    heading: tuple[float | None, float | None] | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Follow a camera along a drive on a map, with a trained RUN."""
    check_model_installed()
    names = ("image_topic", "odometry_topic", "imu_topic", "fix_topic")
    topics = {name: options.pop(name) for name in names}
    if heading is not None and heading[0] is not None:
        options["heading"] = heading[0], _HEADING_DEG if heading[1] is None else heading[1]
    with status_line("loading torch"), without_collection():
        from slicematch.tracking.track import track

    with messages_on_stderr("slicematch"), progress_bar("tracking", "frames") as progress:
        tracked = track(
            run,
            drive,
            aerial_map,
            out,
            topics=given_options(topics),
            progress=progress,
            **given_options(options),
        )
    print_result(as_json, tracked.summary(), tracked.report())
