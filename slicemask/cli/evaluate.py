"""Commands that measure: evaluate and benchmark."""

from typing import Any

import click

from slicemask import Frustum
from slicemask.cli.imports import without_collection
from slicemask.cli.options import (
    FRUSTUM_OPTIONS,
    NumberList,
    Numbers,
    as_json_option,
    cache_option,
    frustum_options,
    given_options,
)
from slicemask.cli.output import print_result, progress_bar, status_line
from slicemask.cli.run_options import (
    check_model_installed,
    dask_option,
    device_option,
    precision_option,
    refine_option,
    root_option,
    run_options,
    workers_option,
)
from slicemask.cli.setting_options import data_options, take_data_settings


@click.command(short_help="Measure the errors of a trained RUN.")
@run_options
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
@root_option
@data_options
@click.option("--limit", type=int, help="Only so many samples, evenly spaced.  [default: all]")
@click.option(
    "--heading-prior",
    "heading_half_width_deg",
    type=float,
    metavar="HALF_WIDTH",
    help="Degrees around the data set's heading; 180 for any.  [default: the run's]",
)
@click.option(
    "--headings",
    metavar="FILE",
    help="True headings in the order of the label files: one a line, or .npy.  "
    "[default: drawn from the run's seed]",
)
@click.option(
    "--headings-unit",
    type=click.Choice(["degrees", "radians", "turns"]),
    help="Of that file; clockwise from north.  [default: degrees]",
)
@click.option(
    "--recalls",
    type=NumberList("1,3,5"),
    help="Metres and degrees below which recalls count.  [default: 1,3,5]",
)
@click.option("--out", metavar="DIR", help="Where the results go.  [default: in the run folder]")
@click.option("--overwrite", is_flag=True, help="Replace results that are there.")
@workers_option
@refine_option
@dask_option
@as_json_option
def evaluate(run: str, as_json: bool, **options: Any) -> None:
    """Measure the errors of a trained RUN, and what the candidate grid alone costs."""
    if options["headings_unit"] is not None and options["headings"] is None:
        raise click.UsageError("--headings-unit belongs to --headings.")
    check_model_installed()
    with status_line("loading torch"), without_collection():
        from slicematch import evaluate

    own = take_data_settings(options)
    with progress_bar("evaluating", "samples") as progress:
        evaluation, folder = evaluate(
            run, progress=progress, data_settings=own, **given_options(options)
        )
    text = f"{evaluation.report()}\nresults in {folder}"
    print_result(as_json, {**evaluation.summary(), "folder": str(folder)}, text)


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
@device_option
@precision_option
@cache_option
@as_json_option
@click.pass_context
def benchmark(
    ctx: click.Context,
    /,
    run: str | None,
    grid: str | None,
    device: str,
    precision: str,
    cache: str | None,
    batch_size: int,
    runs: int,
    as_json: bool,
    frustum: Frustum,
    **settings: Any,
) -> None:
    """Time encoding, aggregation and scoring.

    Of a trained RUN, of an ensemble its first network, or of an untrained model with the settings
    given.
    """
    check_model_installed()
    from slicematch.evaluation.timing import time_run, time_settings

    shared: dict[str, Any] = {
        "device": device,
        "precision": precision,
        "cache": cache,
        "batch_size": batch_size,
        "runs": runs,
    }
    if run is not None:
        for name in (*FRUSTUM_OPTIONS, *settings):
            if ctx.get_parameter_source(name) is not click.core.ParameterSource.DEFAULT:
                raise click.UsageError(f"--{name.replace('_', '-')} cannot be changed in a run.")
        with status_line("timing"):
            timings = time_run(run, grid=grid, **shared)
    else:
        with progress_bar("building", "poses") as progress:
            timings = time_settings(
                grid=grid or "21x21x64", frustum=frustum, **settings, **shared, progress=progress
            )
    print_result(as_json, timings.as_dict(), timings.report())
