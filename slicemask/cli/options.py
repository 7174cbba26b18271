"""Types of option values, and the options that several commands share."""

import functools
import logging
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from slicemask import Frustum

log = logging.getLogger(__name__)

if TYPE_CHECKING:  # generic in the newest click alone
    ParamType = click.ParamType[Any]
else:
    ParamType = click.ParamType


class Numbers(ParamType):
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


class NumberList(ParamType):
    """Any count of numbers separated by commas, such as the example."""

    name = "number,..."

    def __init__(self, example: str):
        self.example = example

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Read a value that was typed, or fail with what was expected."""
        if not isinstance(value, str):
            return value
        try:
            return tuple(float(part) for part in value.split(",")) if value else ()
        except ValueError:
            self.fail(
                f"{value!r} is not numbers separated by commas, such as {self.example}", param, ctx
            )


class NameList(ParamType):
    """Names separated by commas."""

    name = "name,..."

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Read a value that was typed."""
        return tuple(value.split(",")) if isinstance(value, str) else value


class ImageSize(ParamType):
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


FRUSTUM_OPTIONS = ("hfov", "slices", "projection", "intrinsics", "bands")


def frustum_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options `FRUSTUM_OPTIONS`, which the command gets as one argument ``frustum``.

    Values that look like slips are logged.
    """

    @functools.wraps(command)
    def with_frustum(*arguments: Any, **options: Any) -> Any:
        given = {name: options.pop(name) for name in FRUSTUM_OPTIONS}
        return command(*arguments, frustum=_frustum(**given), **options)

    decorated: Callable[..., Any] = with_frustum
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
            click.option(
                "--intrinsics",
                type=Numbers("fx,cx,width"),
                help="Focal length, column of the principal point and image width of a pinhole "
                "camera, in pixels, in place of --hfov.",
            ),
            click.option(
                "--bands",
                type=NumberList("0.08,0.17,0.33"),
                default="",
                help="Cut each slice into bands of range at these distances (pinhole: depths), in "
                "shares of the tile's side, such as 0.08,0.17,0.33.  [default: no bands]",
            ),
        )
    ):
        decorated = option(decorated)
    return decorated


def _frustum(
    hfov: float, slices: int, projection: Any, intrinsics: Any, bands: tuple[float, ...]
) -> Frustum:
    ctx = click.get_current_context()
    if intrinsics is None:
        _warn_of_hfov(ctx, hfov)
        return Frustum(hfov, slices, projection, bands)
    if _is_given(ctx, "hfov"):
        raise click.UsageError("Give only one of --hfov and --intrinsics, which tells the HFoV.")
    if _is_given(ctx, "projection") and projection != "pinhole":
        raise click.UsageError("--intrinsics are those of a pinhole camera: --projection pinhole.")
    fx, cx, width = intrinsics
    return Frustum.from_intrinsics(fx, cx, width, slices, bands)


def _is_given(ctx: click.Context, name: str) -> bool:
    return ctx.get_parameter_source(name) is not click.core.ParameterSource.DEFAULT


def _warn_of_hfov(ctx: click.Context, hfov_deg: float) -> None:
    """Warn of a field of view that is valid and almost surely not what was meant."""
    if not _is_given(ctx, "hfov") or not 0.0 < hfov_deg < 180.0:
        return
    if hfov_deg <= 2.0 * math.pi + 1e-3 and hfov_deg % 1.0 != 0.0:
        log.warning(
            "--hfov is %g degrees, as if it were in radians; in degrees that is %.4g",
            hfov_deg,
            math.degrees(hfov_deg),
        )
    elif not _is_given(ctx, "projection") and 360.0 % hfov_deg != 0.0:
        # Parts of a panorama are whole fractions of it; cameras have odd fields of view.
        log.warning(
            "--hfov is %g degrees, as of a camera, and slices are taken as of a panorama, of equal "
            "azimuth ranges; a camera's have equal widths: --projection pinhole "
            "(--projection equirectangular silences this)",
            hfov_deg,
        )


cells_option = click.option(
    "--cells", type=int, default=32, show_default=True, help="Cells L along each side."
)


def given_options(options: dict[str, Any]) -> dict[str, Any]:
    """The options without those that were not given, for the library's own defaults to hold."""
    return {name: value for name, value in options.items() if value is not None}
