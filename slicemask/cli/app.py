"""The command that serves a page: app."""

import importlib.util
from collections.abc import Callable
from typing import Any

import click

from slicemask.cli.places import Length


@click.command()
@click.argument("run", required=False)
@click.option("--data", metavar="DIR", help="RUN: data tree of the examples.  [default: the run's]")
@click.option(
    "--map",
    "aerial_map",
    metavar="FILE",
    help="RUN: cut tiles from this raster; of a --track, its map.",
)
@click.option(
    "--tile-side", "side_m", type=Length(), help="Of these tiles, as 72m.  [default: the run's]"
)
@click.option("--track", metavar="FILE", help="Play a track (.csv) back on the --map.")
@click.option("--address", default="127.0.0.1", show_default=True, help="Where to listen.")
@click.option(
    "--port", type=click.IntRange(0, 65535), default=5006, show_default=True, help="0: any free."
)
@click.option(
    "--origin",
    "origins",
    multiple=True,
    metavar="HOST:PORT",
    help="Another name under which browsers reach the page.",
)
@click.option("--browser/--no-browser", "show", default=True, help="Open the page.  [default: yes]")
def app(
    run: str | None,
    data: str | None,
    aerial_map: str | None,
    side_m: float | None,
    track: str | None,
    **options: Any,
) -> None:
    """Serve a page: slices, answers of a trained RUN, or a track."""
    if importlib.util.find_spec("panel") is None:
        raise click.ClickException(
            "this command needs panel; install: pip install 'slicemask[app]'"
        )
    if track is not None and (run is not None or data is not None or side_m is not None):
        raise click.UsageError("--track plays what was tracked; leave out RUN and its options.")
    if track is not None and aerial_map is None:
        raise click.UsageError("--track is played on a map; name it (--map ortho.tif).")
    if run is None and data is not None:
        raise click.UsageError("--data names examples for a RUN; give one.")
    if run is None and aerial_map is not None and track is None:
        raise click.UsageError("--map is what a RUN's tiles are cut from; give one.")
    if aerial_map is None and side_m is not None:
        raise click.UsageError("--tile-side is of the tiles that are cut from a --map; give one.")
    from slicemask.app.serve import serve

    if track is not None:
        make_page = _player(track, str(aerial_map))
    else:
        make_page = _explorer() if run is None else _finder(run, data, aerial_map, side_m)
    serve(make_page, ready=lambda url: click.echo(f"{url} (Ctrl-C ends it)"), **options)


def _explorer() -> Callable[[], Any]:
    from slicemask.app.explorer import Explorer

    return lambda: Explorer().page()


def _player(track: str, aerial_map: str) -> Callable[[], Any]:
    from slicemask.cli.run_options import check_model_installed

    check_model_installed()
    from slicematch.app.track_player import player_pages

    return player_pages(track, aerial_map)


def _finder(
    run: str, data: str | None, aerial_map: str | None, side_m: float | None
) -> Callable[[], Any]:
    from slicemask.cli.output import status_line
    from slicemask.cli.run_options import check_model_installed

    check_model_installed()
    with status_line("loading the run"):
        from slicematch.app.finder import finder_pages

        return finder_pages(run, data, aerial_map, side_m)
