"""Commands that fit: train and calibrate."""

import sys
from typing import Any, get_args

import click
from slicematch.runs.recipes import RecipeName

from slicemask.cli.messages import messages_on_stderr
from slicemask.cli.options import as_json_option, cache_option
from slicemask.cli.output import print_result, progress_bar
from slicemask.cli.run_options import (
    check_model_installed,
    checkpoint_option,
    device_option,
    grid_option,
    root_option,
    run_argument,
    workers_option,
)
from slicemask.cli.setting_options import (
    data_options,
    given_settings,
    setting_options,
    take_data_settings,
)


@click.command()
@click.option("--config", "config_file", metavar="FILE", help="YAML of settings, named as below.")
@click.option(
    "--recipe",
    type=click.Choice(get_args(RecipeName)),
    help="Settings to start from, before those of --config and of the options below: the paper's, "
    "which are the defaults, or what answers soonest on a processor (ours: a small pretrained "
    "encoder, bands of range, 64 channels).  [default: paper]",
)
@click.option("--out", metavar="DIR", help="The run folder.  [default: runs/<data>]")
@click.option("--resume", is_flag=True, help="Go on with the run that is in the folder, if any.")
@setting_options
@cache_option
@as_json_option
def train(
    config_file: str | None,
    recipe: str | None,
    out: str | None,
    resume: bool,
    cache: str | None,
    as_json: bool,
    **settings: Any,
) -> None:
    """Train SliceMatch; the paper's settings are the defaults."""
    check_model_installed()
    from slicematch.runs.folder import RunFolder, plan_run
    from slicematch.training.train import train
    from slicematch.training.trainer import is_first_process

    asked = given_settings(settings) | ({} if recipe is None else {"recipe": recipe})
    config, folder = plan_run(asked, config_file, out, resume)
    with messages_on_stderr("slicematch"):
        run = train(config, folder, resume=resume, cache=cache, progress=sys.stderr.isatty())
    if not is_first_process(config):
        return
    epochs = RunFolder(run).load_metrics()
    last = epochs[-1] if epochs else {}
    count = last.get("epoch", -1) + 1
    content = {"run": str(run), "epochs": count, "last_epoch": last}
    figures = ", ".join(f"{name} {value:.4g}" for name, value in last.items() if "/" in name)
    text = f"{run}: {count} epoch{'s' * (count != 1)} trained; the last one: {figures}"
    print_result(as_json, content, text if epochs else f"{run}: holds no metrics of its epochs")


@click.command()
@run_argument
@root_option
@data_options
@grid_option
@checkpoint_option
@device_option
@workers_option
@cache_option
@as_json_option
def calibrate(run: str, as_json: bool, **options: Any) -> None:
    """Fit the temperature that makes scores of a RUN probabilities.

    It is fitted on the validation part; training does so at its end.
    """
    check_model_installed()
    from slicematch.evaluation.calibration import calibrate

    own = take_data_settings(options)
    with progress_bar("calibrating", "samples") as progress:
        content = calibrate(run, progress=progress, data_settings=own, **options)
    text = (
        "temperature {temperature:.4g}: mean negative log-likelihood {nll:.3f} on {samples} "
        "samples, {nll_of_tau:.3f} with the loss's tau; for answers among {grid} by the "
        "{checkpoint} weights, others count as uncalibrated"
    )
    if "caution" in content:
        text += "\ncaution: {caution}"
    print_result(as_json, content, text.format(**content))
