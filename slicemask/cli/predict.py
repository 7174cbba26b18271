"""The command that answers: predict."""

from typing import TYPE_CHECKING, Any

import click

from slicemask.cli.imports import without_collection
from slicemask.cli.options import Numbers, as_json_option, given_options
from slicemask.cli.output import print_result, status_line
from slicemask.cli.places import map_option, map_options
from slicemask.cli.run_options import check_model_installed, refine_option, run_options

if TYPE_CHECKING:
    from slicematch.localization.predict_on_map import MapPrediction

# What goes with a map alone.
_MAP_OPTIONS = {
    "aerial_map": "--map",
    "near": "--near",
    "within_m": "--within",
    "heading": "--heading",
    "map_crs": "--map-crs",
    "side_m": "--tile-side",
    "answers": "--answers",
}


@click.command()
@run_options
@click.option("--ground", metavar="IMAGE", help="Panorama or camera image.")
@click.option("--aerial", metavar="IMAGE", help="Square aerial tile, north up; or else a map.")
@click.option("--metres-per-pixel", type=float, help="Of the aerial tile as it is.")
@map_option(required=False)
@map_options
@click.option("--answers", metavar="FILE", help="On a map: .gpkg, .geojson, .csv or .parquet.")
@click.option("--heading-prior", type=Numbers("centre,half_width"), help="In degrees.")
@click.option("--place-prior", type=Numbers("u,v,radius"), help="In shares of the tile's side.")
@click.option("--truth", type=Numbers("u,v,heading_deg"), help="The true pose, to be drawn.")
@click.option(
    "--centre", type=Numbers("lat,lon"), help="Of the tile, degrees: adds latitude and longitude."
)
@click.option("--geojson", metavar="FILE", help="GeoJSON of the pose; needs --centre.")
@click.option("--out", metavar="FILE", help="Picture of the heat map and the pose: PNG, SVG, PDF.")
@click.option(
    "--example", type=int, metavar="N", help="A pair of images that comes with the run, from 1."
)
@refine_option
@as_json_option
def predict(
    run: str,
    ground: str | None,
    aerial: str | None,
    example: int | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Find where a ground image was taken, with a trained RUN."""
    if example is not None:
        if (ground, aerial, options["aerial_map"]) != (None, None, None):
            raise click.UsageError("--example stands for --ground and --aerial; leave them out.")
        ground, aerial = _take_example(run, example, options)
    if ground is None:
        raise click.UsageError("Missing option '--ground', or '--example'.")
    on_map = {name: options.pop(name) for name in _MAP_OPTIONS}
    if aerial is None:
        found = _predict_on_map(run, ground, given_options(on_map), given_options(options))
        print_result(as_json, found.as_dict(), found.report())
        return
    if on_map["aerial_map"] is not None:
        raise click.UsageError("--aerial and --map both say where to look; give one of them.")
    for name, value in on_map.items():
        if value is not None:
            raise click.UsageError(f"{_MAP_OPTIONS[name]} goes with --map, and not with --aerial.")
    if options["centre"] is not None and options["metres_per_pixel"] is None:
        raise click.UsageError("--centre needs --metres-per-pixel.")
    if options["geojson"] is not None and options["centre"] is None:
        raise click.UsageError("--geojson needs --centre and --metres-per-pixel.")
    if options["truth"] is not None and options["out"] is None:
        raise click.UsageError("--truth is drawn in the picture; it needs --out.")
    check_model_installed()
    with status_line("loading torch") as say:
        with without_collection():
            if click.get_current_context().find_root().obj:
                from slicematch._quick_start import start_quickly

                start_quickly()
            from slicematch import predict

        prediction = predict(run, ground, aerial, progress=say, **given_options(options))
    print_result(as_json, prediction.as_dict(), prediction.report())


def _take_example(run: str, number: int, options: dict[str, Any]) -> tuple[str, str]:
    """The images of a pair that comes with a run; what is known of it goes to the options."""
    check_model_installed()
    from slicematch.runs.shipped import shipped_pair

    pair = shipped_pair(run, number)
    known: dict[str, Any] = {"metres_per_pixel": pair.metres_per_pixel}
    if options["out"] is not None:
        known["truth"] = pair.pose
    options.update({name: value for name, value in known.items() if options[name] is None})
    return str(pair.ground), str(pair.aerial)


def _predict_on_map(
    run: str, ground: str, on_map: dict[str, Any], options: dict[str, Any]
) -> "MapPrediction":
    if "aerial_map" not in on_map:
        raise click.UsageError("Missing option '--aerial', or '--map'.")
    for name in ("metres_per_pixel", "centre", "place_prior", "heading_prior", "truth"):
        if name in options:
            raise click.UsageError(
                f"--{name.replace('_', '-')} goes with --aerial; with --map, say --near, --within "
                "and --heading."
            )
    known = on_map.pop("near", None), on_map.pop("within_m", None), *on_map.pop("heading", ())
    check_model_installed()
    with status_line("loading torch") as say:
        with without_collection():
            from slicematch import Priors, predict_on_map

        aerial_map = on_map.pop("aerial_map")
        return predict_on_map(
            run, ground, aerial_map, priors=Priors(*known), progress=say, **on_map, **options
        )
