"""The command that makes a run small enough to hand on: pack."""

import click

from slicemask.cli.options import as_json_option
from slicemask.cli.output import print_result
from slicemask.cli.run_options import (
    check_model_installed,
    checkpoint_option,
    grid_option,
    run_argument,
)


@click.command()
@run_argument
@click.option("--out", required=True, metavar="DIR", help="The folder to write, new or empty.")
@click.option(
    "--with",
    "members",
    multiple=True,
    metavar="RUN",
    help="Another run, that answers with RUN: an ensemble. May be given several times.",
)
@checkpoint_option
@grid_option
@as_json_option
def pack(
    run: str, out: str, members: tuple[str, ...], checkpoint: str, grid: str | None, as_json: bool
) -> None:
    """Pack what predicting with a trained RUN takes into a folder.

    Settings, temperature, and weights in half precision. All commands that only read a run take it.
    """
    check_model_installed()
    from slicematch.runs.packed import pack as pack_run

    path = pack_run(run, out, checkpoint, grid, members)  # type: ignore[arg-type]  # click has checked it
    size = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    print_result(as_json, {"path": str(path), "bytes": size}, f"{path}: {size / 1e6:.1f} MB")
