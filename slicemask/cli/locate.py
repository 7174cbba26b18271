"""The commands for maps: locate and tiles."""

from typing import Any

import click

from slicemask.cli.imports import without_collection
from slicemask.cli.messages import messages_on_stderr
from slicemask.cli.options import as_json_option, given_options
from slicemask.cli.output import print_result, progress_bar, status_line
from slicemask.cli.places import Length, map_crs_option, map_option, map_options
from slicemask.cli.run_options import (
    check_model_installed,
    dask_option,
    refine_option,
    run_options,
)

shared_option = click.option(
    "--share-tiles",
    "shared_m",
    type=Length(),
    help="Photographs this near to each other share a tile; 0 for none.  [default: a sixteenth of "
    "the tile's side]",
)


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
@shared_option
@refine_option
@dask_option
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
    with status_line("loading torch"), without_collection():
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


@click.command()
@click.argument("table")
@map_option()
@click.option("--out", required=True, metavar="DIR", help="Folder for photos.csv and tiles/.")
@map_crs_option
@click.option(
    "--tile-side",
    "side_m",
    type=Length(),
    help="Of the tiles on the ground; training cuts smaller ones out of them.  [default: 105m]",
)
@click.option("--pixels", type=int, help="Along each side of a tile.  [default: 768]")
@shared_option
@as_json_option
def tiles(table: str, aerial_map: str, out: str, as_json: bool, **options: Any) -> None:
    """Cut the aerial tiles of a TABLE of photographs from a map."""
    check_model_installed()
    from slicematch.data.cut_tiles import cut_tiles

    with messages_on_stderr("slicematch"), progress_bar("cutting", "photographs") as progress:
        cut = cut_tiles(table, aerial_map, out, progress=progress, **given_options(options))
    print_result(as_json, cut.summary(), cut.report())
