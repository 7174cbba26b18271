"""Commands that fit: train and calibrate."""

import json
import sys
from collections.abc import Callable
from typing import Any

import click

from slicemask.cli.options import (
    Numbers,
    as_json_option,
    cache_option,
)
from slicemask.cli.output import print_result, progress_bar
from slicemask.cli.run_options import (
    PRECISIONS,
    check_model_installed,
    checkpoint_option,
    device_option,
    grid_option,
    root_option,
    run_argument,
    workers_option,
)


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
            PRECISIONS,
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
@run_argument
@root_option
@grid_option
@checkpoint_option
@device_option
@workers_option
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
