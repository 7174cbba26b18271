"""The command that answers: predict."""

from typing import Any

import click

from slicemask.cli.options import Numbers, as_json_option, given_options
from slicemask.cli.output import print_result
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
def predict(
    run: str,
    ground: str,
    aerial: str,
    metres_per_pixel: float | None,
    heading_prior: tuple[float, float] | None,
    place_prior: tuple[float, float, float] | None,
    truth: tuple[float, float, float] | None,
    centre: tuple[float, float] | None,
    geojson: str | None,
    out: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Find where a ground image was taken, with a trained RUN."""
    if centre is not None and metres_per_pixel is None:
        raise click.UsageError("--centre needs --metres-per-pixel.")
    if geojson is not None and centre is None:
        raise click.UsageError("--geojson needs --centre and --metres-per-pixel.")
    if truth is not None and out is None:
        raise click.UsageError("--truth is drawn in the picture; it needs --out.")
    check_model_installed()
    from slicematch.localization.localizer import Localizer, check_resolution

    from slicemask.geometry.poses import check_poses

    # What can be wrong with the request is found before anything is computed or written.
    if metres_per_pixel is not None:
        check_resolution(metres_per_pixel)
    if truth is not None:
        check_poses([truth], iter(["the truth"]))
    if centre is not None:
        from slicematch.localization.geodesy import check_centre

        check_centre(centre)
    if geojson is not None:
        from slicematch.localization.geodesy import check_geojson_target

        check_geojson_target(geojson)
    if out is not None:
        from slicemask.plot import check_figure_target

        check_figure_target(out)
    localizer = Localizer.load(run, options.pop("bank"), **given_options(options))
    estimate = localizer.localize(
        ground, aerial, heading_prior, place_prior, metres_per_pixel=metres_per_pixel
    )
    content = estimate.as_dict(metres_per_pixel, centre) | {
        "refine": localizer.refine,
        "calibrated": localizer.calibrated,
    }
    if geojson is not None:
        from slicematch.localization.geodesy import feature_collection, save_geojson

        save_geojson(feature_collection(estimate, metres_per_pixel, centre), geojson)
        content["geojson"] = geojson
    if out is not None:
        from slicematch.evaluation.drawing import draw_estimate

        from slicemask.images import read_image
        from slicemask.plot import read_aerial, save_figure

        figure = draw_estimate(
            read_aerial(aerial),
            estimate.heat_map,
            estimate.grid,
            estimate.pose,
            localizer.frustum,
            truth=truth,
            ground=read_image(ground),
        )
        save_figure(figure, out)
        content["picture"] = out
    text = "u {u:.4f}, v {v:.4f}, heading {heading_deg:.2f} degrees, score {score:.4f}"
    if metres_per_pixel is not None:
        east_m, north_m = content["east_m"], content["north_m"]
        text += (
            f"; {abs(east_m):.2f} m {'west' if east_m < 0 else 'east'} and "
            f"{abs(north_m):.2f} m {'south' if north_m < 0 else 'north'} of the centre"
        )
    if centre is not None:
        text += "; latitude {latitude:.7f}, longitude {longitude:.7f}"
    lines = [text.format(**content), _certainty(estimate, metres_per_pixel, localizer.calibrated)]
    print_result(as_json, content, "\n".join([*lines, *filter(None, (geojson, out))]))


def _certainty(estimate: Any, metres_per_pixel: float | None, calibrated: bool) -> str:
    """One line on how sure an estimate is."""
    east, north, heading = (
        value**0.5 for value in estimate.covariance(metres_per_pixel).diagonal().tolist()
    )
    unit = "of the tile" if metres_per_pixel is None else "m"
    others = ", ".join(f"{mode.probability:.1%}" for mode in estimate.modes[1:])
    return (
        f"probability {estimate.modes[0].probability:.1%}"
        + ("" if calibrated else " (uncalibrated)")
        + f", standard deviations {east:.2g} {unit} east, {north:.2g} {unit} north, "
        f"{heading:.1f} degrees" + (f"; other modes {others}" if others else "")
    )
