"""Types of option values, and the options that several commands share."""

from collections.abc import Callable
from typing import Any

import click


class Numbers(click.ParamType):
    """Numbers separated by commas, such as ``0.5,0.5,90``."""

    def __init__(self, names: str, kind: type = float):
        self.name = names
        self.kind = kind

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Read a value that was typed, or fail with what was expected."""
        if not isinstance(value, str):
            return value
        parts = value.split(",")
        try:
            numbers = tuple(self.kind(part) for part in parts)
        except ValueError:
            numbers = ()
        if len(numbers) != len(self.name.split(",")):
            self.fail(f"{value!r} is not {self.name}", param, ctx)
        return numbers


class ImageSize(click.ParamType):
    """Columns and rows of an image, such as 1024x512."""

    name = "COLUMNSxROWS"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Read a value that was typed, or fail with what was expected."""
        if not isinstance(value, str):
            return value
        try:
            columns, rows = map(int, value.split("x"))
        except ValueError:
            self.fail(f"{value!r} is not COLUMNSxROWS, such as 1024x512", param, ctx)
        return columns, rows


as_json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON, for programs.")
cache_option = click.option(
    "--cache",
    metavar="DIR",
    help="Folder of banks.  [default: $SLICEMASK_CACHE, else masks_cache]",
)


def frustum_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --hfov, --slices and --projection."""
    for option in reversed(
        (
            click.option(
                "--hfov",
                type=float,
                default=360.0,
                show_default=True,
                metavar="DEGREES",
                help="Horizontal field of view, in (0, 360].",
            ),
            click.option(
                "--slices", type=int, default=16, show_default=True, help="Slices N of the HFoV."
            ),
            click.option(
                "--projection",
                type=click.Choice(["equirectangular", "pinhole"]),
                default="equirectangular",
                show_default=True,
                help="Equal azimuth ranges, or equal widths in a pinhole image.",
            ),
        )
    ):
        command = option(command)
    return command


cells_option = click.option(
    "--cells", type=int, default=32, show_default=True, help="Cells L along each side."
)


def given_options(options: dict[str, Any]) -> dict[str, Any]:
    """The options without those that were not given, for the library's own defaults to hold."""
    return {name: value for name, value in options.items() if value is not None}
