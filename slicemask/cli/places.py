"""Types of option values that say where and which way: 52.0,4.36, 30m, 90+-15."""

import re
from collections.abc import Callable
from typing import Any

import click

from slicemask.cli.options import Numbers, ParamType

_METRES = {"": 1.0, "m": 1.0, "km": 1000.0, "ft": 0.3048}


class Length(ParamType):
    """A length on the ground, such as 30m, 0.5km, 100ft or 30, which is in metres."""

    name = "length"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Read a length as metres, or fail with what was expected."""
        if not isinstance(value, str):
            return value
        found = re.fullmatch(r"\s*([\d.]+(?:e[+-]?\d+)?)\s*(m|km|ft|)\s*", value, re.IGNORECASE)
        try:
            return float(found[1]) * _METRES[found[2].lower()]  # type: ignore[index]
        except (TypeError, ValueError):
            self.fail(f"{value!r} is no length, such as 30m, 0.5km or 100ft", param, ctx)


class Heading(ParamType):
    """A heading and how far it may be off, such as 90+-15; +-15 of one's own; any."""

    name = "degrees+-degrees"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """Read (centre or None, half width or None) in degrees, or fail with what was expected."""
        if not isinstance(value, str):
            return value
        if value.strip().lower() == "any":
            return None, 180.0
        centre, _, width = value.replace("±", "+-").partition("+-")
        try:
            return (
                float(centre) if centre.strip() else None,
                float(width) if width.strip() else None,
            )
        except ValueError:
            self.fail(
                f"{value!r} is no heading, such as 90+-15, +-15 around the photograph's own, or "
                "any",
                param,
                ctx,
            )


def map_option(required: bool = True) -> Callable[..., Any]:
    """The option --map."""
    return click.option(
        "--map",
        "aerial_map",
        required=required,
        metavar="FILE",
        help="A georeferenced raster that GDAL reads: GeoTIFF, COG, JPEG 2000, VRT, service file.",
    )


map_crs_option = click.option(
    "--map-crs", metavar="CRS", help="Of a map that does not say, as EPSG:25832."
)
_MAP_OPTIONS = (
    click.option("--near", type=Numbers("lat,lon"), help="Where they were taken, about."),
    click.option(
        "--within",
        "within_m",
        type=Length(),
        help="How far from there at most, such as 30m.  [default: 3 times the accuracy that a "
        "photograph says, else anywhere in the tile]",
    ),
    click.option(
        "--heading",
        type=Heading(),
        help="Which way the centre column looks, such as 90+-15; +-15 around what a photograph's "
        "compass says; any.  [default: +-30 around the compass, if there is one]",
    ),
    map_crs_option,
    click.option(
        "--tile-side",
        "side_m",
        type=Length(),
        help="Of the tiles that are cut.  [default: the run's]",
    ),
)


def map_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of commands that look for photographs on a map."""
    for option in reversed(_MAP_OPTIONS):
        command = option(command)
    return command
