"""Commands on the model: train, evaluate, calibrate, predict and benchmark."""

import importlib.util
import json
import sys
from collections.abc import Callable
from typing import Any

import click

from slicemask.cli.options import (
    Numbers,
    as_json_option,
    cache_option,
    frustum_options,
    given_options,
)
from slicemask.cli.output import print_result, progress_bar


def check_model_installed() -> None:
    """Refuse the command, with what to install, where packages of the model are missing."""
    missing = [
        name
        for name in ("torch", "timm", "lightning", "pyproj", "safetensors", "tensorboard", "yaml")
        if importlib.util.find_spec(name) is None
    ]
    if missing:
        raise click.ClickException(
            f"this command needs {', '.join(missing)}; install: pip install 'slicemask[model]'"
        )


# As in `slicematch.devices.Precision`, which takes torch's time to import.
_PRECISIONS = click.Choice(["32-true", "16-mixed", "bf16-mixed"])


class _Alpha(click.ParamType):
    """A number, or K."""

    name = "number|K"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        try:
            return value if str(value).upper() == "K" else float(value)
        except ValueError:
            self.fail(f"{value!r} is neither a number nor K", param, ctx)


def _settings(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add an option for each setting of a run, named as in `slicematch.runs.config.TrainConfig`.

    None has a default here: what is not given comes from --config, the run, or the paper.
    """
    same_or_cross = click.Choice(["same-area", "cross-area"])
    by_data = "[default: {} for VIGOR, {} for KITTI]".format
    options: tuple[tuple[str, Any, str], ...] = (
        ("data", click.Choice(["vigor", "kitti"]), "Format of the data."),
        ("root", str, "Folder of the data tree."),
        ("split", same_or_cross, "Where the test part lies.  [default: same-area]"),
        ("labels", click.Choice(["corrected", "original"]), "Of VIGOR.  [default: corrected]"),
        ("cities", str, "Only these of VIGOR's cities, parted by commas."),
        ("splits", str, "Folder of KITTI's split files.  [default: the root]"),
        ("heading-prior", float, "Known to +- this many degrees; 0 aligned.  [default: any]"),
        ("place-prior", Numbers("u,v,radius"), "Only candidates within the radius of (u, v)."),
        ("extent", Numbers("u0,v0,u1,v1"), "Part of the tile that the grids fill."),
        ("train-grid", str, f"Candidates in training.  {by_data('7x7x16', '5x5x16')}"),
        ("test-grid", str, f"Candidates in testing.  {by_data('21x21x64', '15x15x64')}"),
        ("encoder", str, "timm backbone.  [default: vgg16]"),
        ("weights", str, "imagenet, none or a file.  [default: imagenet]"),
        ("stride", int, "Of the feature maps.  [default: 16]"),
        (
            "ground-size",
            Numbers("height,width", int),
            f"Pixels.  {by_data('320,640', '256,1024')}",
        ),
        ("aerial-size", int, "Pixels along each side.  [default: 512]"),
        ("slices", int, "N.  [default: 16]"),
        ("alpha", _Alpha(), "Weight of the candidates; K is plain infoNCE.  [default: 4]"),
        ("tau", float, "Temperature of the loss.  [default: 0.1]"),
        ("near-negatives", int, "Negatives around each true pose.  [default: 0]"),
        ("learning-rate", float, "Of Adam.  [default: 1e-5]"),
        (
            "schedule",
            click.Choice(["constant", "one-cycle"]),
            "Of the learning rate.  [default: constant]",
        ),
        ("batch-size", int, "Pairs in a step, on each device.  [default: 4]"),
        ("epochs", int, "Rounds through the training part.  [default: 30]"),
        ("validation-fraction", float, "Share that chooses the best checkpoint.  [default: 0.1]"),
        ("heat-map-every", int, "Epochs between example heat maps.  [default: 1]"),
        ("bad-samples", int, "Unreadable samples to bear.  [default: 10]"),
        ("seed", int, "Of all that is random.  [default: 0]"),
        ("workers", int, "Processes that load images.  [default: 4]"),
        (
            "precision",
            _PRECISIONS,
            "Of the encoders.  [default: 32-true]",
        ),
        ("accelerator", str, "auto, cpu, cuda, ...  [default: auto]"),
        ("devices", int, "How many.  [default: 1]"),
    )
    command = click.option(
        "--cross-view-attention/--no-cross-view-attention",
        default=None,
        help="Whether aerial attention sees the ground.  [default: it does]",
    )(command)
    command = click.option(
        "--grid-jitter/--no-grid-jitter",
        default=None,
        help="Whether the training grid moves at random.  [default: it does not]",
    )(command)
    command = click.option(
        "--augment/--no-augment",
        default=None,
        help="Turn, mirror and recolour training samples.  [default: not]",
    )(command)
    for name, kind, text in reversed(options):
        command = click.option(f"--{name}", type=kind, help=text)(command)
    return command


_run = click.argument("run")
_grid = click.option("--grid", metavar="RxCxH", help="Candidates.  [default: the run's test grid]")
_checkpoint = click.option(
    "--checkpoint", type=click.Choice(["best", "last"]), default="best", show_default=True
)
_device = click.option("--device", default="auto", show_default=True, help="auto, cpu, cuda[:N].")
_precision = click.option(
    "--precision",
    type=_PRECISIONS,
    default="32-true",
    show_default=True,
    help="Of the encoders; what follows them is float32. 16-mixed: GPUs only.",
)
_root = click.option("--root", metavar="DIR", help="Folder of the data tree.  [default: the run's]")
_workers = click.option(
    "--workers", type=int, help="Processes that load images.  [default: the run's]"
)
_run_options = (
    _run,
    _grid,
    click.option("--bank", metavar="FILE", help="A bank of candidates instead."),
    _checkpoint,
    _device,
    _precision,
    cache_option,
)


_refine = click.option(
    "--refine",
    type=click.Choice(["none", "mean", "fine", "continuous"]),
    help="The best candidate, the mean of those around it, coarse to fine around the best ones, "
    "or that and then gradients.  [default: mean]",
)


def _of_a_run(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add RUN and the options of commands that use one."""
    for option in reversed(_run_options):
        command = option(command)
    return command


@click.command()
@click.option("--config", "config_file", metavar="FILE", help="YAML of settings, named as below.")
@click.option("--out", metavar="DIR", help="The run folder.  [default: runs/<data>]")
@click.option("--resume", is_flag=True, help="Go on with the run that is in the folder, if any.")
@_settings
@cache_option
@as_json_option
def train(
    config_file: str | None,
    out: str | None,
    resume: bool,
    cache: str | None,
    as_json: bool,
    **settings: Any,
) -> None:
    """Train SliceMatch; the paper's settings are the defaults."""
    check_model_installed()
    from slicematch.runs.folder import plan_run
    from slicematch.training.train import is_first_process, train

    asked = {name: value for name, value in settings.items() if value is not None}
    if "heading_prior" in asked:
        asked["heading_prior_deg"] = asked.pop("heading_prior")
    if "cities" in asked:
        asked["cities"] = asked["cities"].split(",")
    if str(asked.get("alpha")).upper() == "K":
        asked["alpha"] = None
    config, folder = plan_run(asked, config_file, out, resume)
    run = train(config, folder, resume=resume, cache=cache, progress=sys.stderr.isatty())
    if not is_first_process():
        return
    epochs = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    content = {"run": str(run), "epochs": len(epochs), "last_epoch": epochs[-1]}
    figures = ", ".join(f"{name} {value:.4g}" for name, value in epochs[-1].items() if "/" in name)
    count = "1 epoch" if len(epochs) == 1 else f"{len(epochs)} epochs"
    print_result(as_json, content, f"{run}: {count} trained; the last one: {figures}")


@click.command()
@_of_a_run
@click.option(
    "--split",
    type=click.Choice(["same-area", "cross-area"]),
    help="Where the part lies.  [default: the run's]",
)
@click.option(
    "--part",
    type=click.Choice(["test", "validation", "train"]),
    default="test",
    show_default=True,
    help="Part of the data set.",
)
@_root
@click.option("--limit", type=int, help="Only so many samples, spread evenly.  [default: all]")
@click.option("--out", metavar="DIR", help="Where the results go.  [default: in the run folder]")
@click.option("--overwrite", is_flag=True, help="Replace results that are there.")
@_workers
@_refine
@as_json_option
def evaluate(run: str, as_json: bool, **options: Any) -> None:
    """Measure the errors of a trained RUN, and what the candidate grid alone costs."""
    check_model_installed()
    from slicematch.evaluation.evaluate import evaluate

    with progress_bar("evaluating", "samples") as progress:
        evaluation, folder = evaluate(run, progress=progress, **given_options(options))
    text = f"{evaluation.report()}\nresults in {folder}"
    print_result(as_json, {**evaluation.summary(), "folder": str(folder)}, text)


@click.command()
@_run
@_root
@_grid
@_checkpoint
@_device
@_workers
@cache_option
@as_json_option
def calibrate(run: str, as_json: bool, **options: Any) -> None:
    """Fit what makes scores of RUN probabilities, on its validation part; training does so too."""
    check_model_installed()
    from slicematch.evaluation.calibration import calibrate

    with progress_bar("calibrating", "samples") as progress:
        content = calibrate(run, progress=progress, **options)
    text = (
        "temperature {temperature:.4g}: mean negative log-likelihood {nll:.3f} on {samples} "
        "samples, {nll_of_tau:.3f} with the loss's tau; for answers among {grid} by the "
        "{checkpoint} weights, others count as uncalibrated"
    )
    print_result(as_json, content, text.format(**content))


@click.command()
@_of_a_run
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
@_refine
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
        from slicematch.data import read_image
        from slicematch.evaluation.drawing import draw_estimate

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


@click.command()
@click.argument("run", required=False)
@click.option("--grid", metavar="RxCxH", help="Candidates.  [default: 21x21x64, or the run's]")
@frustum_options
@click.option("--encoder", default="vgg16", show_default=True, help="timm backbone.")
@click.option("--weights", default="none", show_default=True, help="imagenet, none or a file.")
@click.option("--stride", type=int, default=16, show_default=True, help="Of the feature maps.")
@click.option(
    "--ground-size",
    type=Numbers("height,width", int),
    default="320,640",
    show_default=True,
    help="Pixels.",
)
@click.option(
    "--aerial-size", type=int, default=512, show_default=True, help="Pixels along each side."
)
@click.option("--batch-size", type=int, default=1, show_default=True, help="Pairs at once.")
@click.option(
    "--runs", type=int, default=5, show_default=True, help="Repetitions; their median counts."
)
@_device
@_precision
@cache_option
@as_json_option
@click.pass_context
def benchmark(
    ctx: click.Context,
    run: str | None,
    grid: str | None,
    device: str,
    precision: str,
    cache: str | None,
    batch_size: int,
    runs: int,
    as_json: bool,
    **settings: Any,
) -> None:
    """Time encoding, aggregation and scoring: of a trained RUN, or of the settings given."""
    check_model_installed()
    from slicematch.evaluation.timing import time_run, time_settings

    shared = {
        "device": device,
        "precision": precision,
        "cache": cache,
        "batch_size": batch_size,
        "runs": runs,
    }
    if run is not None:
        for name in settings:
            if ctx.get_parameter_source(name) is not click.core.ParameterSource.DEFAULT:
                raise click.UsageError(f"--{name.replace('_', '-')} cannot be changed in a run.")
        timings = time_run(run, grid=grid, **shared)
    else:
        settings["hfov_deg"] = settings.pop("hfov")
        with progress_bar("building", "poses") as progress:
            timings = time_settings(
                grid=grid or "21x21x64", **settings, **shared, progress=progress
            )
    print_result(as_json, timings.as_dict(), timings.report())
