"""The command that answers: predict."""

from typing import Any

import click

from slicemask.cli.options import Numbers, as_json_option, given_options
from slicemask.cli.output import print_result, status_line
from slicemask.cli.run_options import check_model_installed, refine_option, run_options


@click.command()
@run_options
@click.option("--ground", required=True, metavar="IMAGE", help="Panorama or camera image.")
@click.option("--aerial", required=True, metavar="IMAGE", help="Square aerial tile, north up.")
@click.option("--metres-per-pixel", type=float, help="Of the aerial tile as it is.")
@click.option("--heading-prior", type=Numbers("centre,half_width"), help="In degrees.")
@click.option("--place-prior", type=Numbers("u,v,radius"), help="In shares of the tile's side.")
@click.option("--truth", type=Numbers("u,v,heading_deg"), help="The true pose, to be drawn.")
@click.option(
    "--centre", type=Numbers("lat,lon"), help="Of the tile, degrees: adds latitude and longitude."
)
@click.option("--geojson", metavar="FILE", help="GeoJSON of the pose; needs --centre.")
@click.option("--out", metavar="FILE", help="Picture of the heat map and the pose: PNG, SVG, PDF.")
@refine_option
@as_json_option
def predict(run: str, ground: str, aerial: str, as_json: bool, **options: Any) -> None:
    """Find where a ground image was taken, with a trained RUN."""
    if options["centre"] is not None and options["metres_per_pixel"] is None:
        raise click.UsageError("--centre needs --metres-per-pixel.")
    if options["geojson"] is not None and options["centre"] is None:
        raise click.UsageError("--geojson needs --centre and --metres-per-pixel.")
    if options["truth"] is not None and options["out"] is None:
        raise click.UsageError("--truth is drawn in the picture; it needs --out.")
    check_model_installed()
    with status_line("loading torch") as say:
        from slicematch._deferred_compiler import defer_compiler

        defer_compiler()
        from slicematch import predict

        prediction = predict(run, ground, aerial, progress=say, **given_options(options))
    print_result(as_json, prediction.as_dict(), prediction.report())
