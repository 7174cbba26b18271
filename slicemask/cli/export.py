"""The command that hands a run to other runtimes: export."""

from typing import Any

import click

from slicemask.cli.options import as_json_option, cache_option
from slicemask.cli.output import print_result, progress_bar
from slicemask.cli.run_options import (
    check_model_installed,
    checkpoint_option,
    grid_option,
    root_option,
    run_argument,
)


@click.command()
@run_argument
@click.option("--out", required=True, metavar="DIR", help="The folder to write, new or empty.")
@click.option(
    "--format", type=click.Choice(["onnx", "torch-export"]), default="onnx", show_default=True
)
@click.option("--baked", is_flag=True, help="Keep the candidates' masks in the file of scores.")
@click.option(
    "--variant",
    "variants",
    type=click.Choice(["fp16", "int8"]),
    multiple=True,
    help="Write the encoders in fewer bits, too, and measure what it costs; may be repeated.",
)
@grid_option
@click.option("--bank", metavar="FILE", help="A bank of candidates instead.")
@checkpoint_option
@root_option
@click.option(
    "--samples", default=100, show_default=True, help="Test samples that variants are measured on."
)
@cache_option
@as_json_option
def export(run: str, out: str, as_json: bool, **options: Any) -> None:
    """Export a RUN as files of ONNX or torch.export.

    Encoders, aggregation and scoring, checked against PyTorch. Masks are inputs, unless --baked.
    """
    check_model_installed()
    from slicematch.export.export import export

    with progress_bar("exporting", "steps") as progress:
        content = export(run, out, progress=progress, **options)
    worst = max(content["largest_difference"].values())
    lines = [f"{out}: {len(content['files'])} files, at most {worst:.1g} off PyTorch's results"]
    accuracy = content.get("accuracy", {})
    lines += [
        f"{name}, {accuracy['samples']} samples: median {errors['place_median_m']:g} m, "
        f"{errors['heading_median_deg']:g} deg"
        for name, errors in accuracy.items()
        if name != "samples"
    ]
    print_result(as_json, content, "\n".join(lines))
