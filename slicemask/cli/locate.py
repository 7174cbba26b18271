"""The commands for maps: locate and tiles."""

from typing import Any

import click

from slicemask.cli.messages import messages_on_stderr
from slicemask.cli.options import as_json_option, given_options
from slicemask.cli.output import print_result, progress_bar, status_line
from slicemask.cli.places import Length, map_option, map_options
from slicemask.cli.run_options import check_model_installed, refine_option, run_options


@click.command()
@run_options
@click.argument("photos", nargs=-1, required=True)
@map_option()
@click.option(
    "--out",
    required=True,
    metavar="FILE",
    help="The answers: .gpkg, .geojson, .csv or .parquet.",
)
@click.option("--picture", metavar="FILE", help="The map with all answers: PNG, SVG, PDF.")
@map_options
@click.option(
    "--share-tiles",
    "shared_m",
    type=Length(),
    help="Photographs this near to each other share a tile; 0 for none.  [default: a sixteenth of "
    "the tile's side]",
)
@refine_option
@click.option(
    "--dask",
    metavar="WHERE",
    help="Do it on Dask: local, a number of processes here, or tcp://scheduler:8786.",
)
@click.option("--overwrite", is_flag=True, help="Replace answers that are there.")
@as_json_option
def locate(
    run: str,
    photos: tuple[str, ...],
    aerial_map: str,
    out: str,
    as_json: bool,
    near: tuple[float, float] | None,
    within_m: float | None,
    heading: tuple[float | None, float | None] | None,
    **options: Any,
) -> None:
    """Find where PHOTOS were taken on a map, with a trained RUN.

    PHOTOS are images, folders, patterns, or tables with a column ground.
    """
    check_model_installed()
    with status_line("loading torch"):
        from slicematch import Priors, locate

    with messages_on_stderr("slicematch"), progress_bar("locating", "photographs") as progress:
        located = locate(
            run,
            photos,
            aerial_map,
            out,
            priors=Priors(near, within_m, *(heading or ())),
            progress=progress,
            **given_options(options),
        )
    print_result(as_json, located.summary(), located.report())
    if len(located.failed) == len(located.answers):
        raise click.ClickException(f"none was located: {located.answers['error'].iloc[0]}")
