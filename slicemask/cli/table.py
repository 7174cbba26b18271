"""The commands that write tables of photographs: table from-vigor, from-kitti and from-exif."""

from collections.abc import Callable
from typing import Any

import click

from slicemask.cli.options import as_json_option, given_options
from slicemask.cli.output import print_result, progress_bar
from slicemask.cli.run_options import check_model_installed

# Reasons that are printed; all are in the JSON.
_SHOWN = 5

_out_option = click.option(
    "--out", metavar="FILE", required=True, help="The table: .csv, .parquet or .geojson."
)
_overwrite_option = click.option("--overwrite", is_flag=True, help="Replace a table that is there.")
_split_option = click.option(
    "--split",
    type=click.Choice(["same-area", "cross-area"]),
    default="same-area",
    show_default=True,
    help="What the column split follows.",
)


@click.group()
def table() -> None:
    """List photographs in a table: of VIGOR, KITTI, or a folder.

    A table is what `slicemask train --data table --root FILE` reads.
    """


def _shared(command: Callable[..., Any]) -> Callable[..., Any]:
    for option in (as_json_option, _overwrite_option, _out_option):
        command = option(command)
    return command


@click.command()
@click.argument("root")
@_split_option
@click.option("--cities", metavar="CITY,...", help="Only these.  [default: all of the split]")
@click.option(
    "--labels",
    default="corrected",
    show_default=True,
    help="corrected, original, or a folder of either.",
)
@_shared
def from_vigor(root: str, out: str, as_json: bool, cities: str | None, **options: Any) -> None:
    """Write the pairs of a VIGOR tree."""
    check_model_installed()
    from slicematch.data.to_table import table_from_vigor

    named = None if cities is None else tuple(cities.split(","))
    _print(as_json, table_from_vigor(root, out, cities=named, **options))


@click.command()
@click.argument("root")
@_split_option
@click.option("--split-dir", metavar="DIR", help="Of the split files.  [default: the root]")
@_shared
def from_kitti(root: str, out: str, as_json: bool, **options: Any) -> None:
    """Write the frames of a KITTI tree as cut by LM, and its cameras."""
    check_model_installed()
    from slicematch.data.to_table import table_from_kitti

    _print(as_json, table_from_kitti(root, out, **given_options(options)))


@click.command()
@click.argument("folder")
@click.option(
    "--hfov",
    "hfov_deg",
    type=float,
    metavar="DEGREES",
    help="Horizontal field of view of photographs that say none.",
)
@_shared
def from_exif(folder: str, out: str, as_json: bool, **options: Any) -> None:
    """Write the photographs of a folder, by their EXIF and GPano data, and their cameras."""
    check_model_installed()
    from slicematch.data.to_table import table_from_exif

    with progress_bar("reading", "photographs") as progress:
        written = table_from_exif(folder, out, progress=progress, **given_options(options))
    _print(as_json, written)


for _command in (from_vigor, from_kitti, from_exif):
    table.add_command(_command)


def _print(as_json: bool, written: Any) -> None:
    content = {
        "table": str(written.path),
        "rows": written.rows,
        "cameras": None if written.cameras is None else str(written.cameras),
        "left_out": dict(written.left_out),
    }
    lines = [f"{written.path}: {written.rows} photographs"]
    if written.cameras is not None:
        lines.append(f"{written.cameras}: their cameras")
    reasons = list(written.left_out.values())
    if reasons:
        lines.append(f"{len(reasons)} left out:")
        lines += [f"  {reason}" for reason in reasons[:_SHOWN]]
    if len(reasons) > _SHOWN:
        lines.append(f"  and {len(reasons) - _SHOWN} more (--json lists all)")
    print_result(as_json, content, "\n".join(lines))
