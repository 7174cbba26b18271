"""What commands print: results as text or JSON, and progress."""

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import click

from slicemask.progress import TimedLines


@contextmanager
def progress_bar(what: str, unit: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar on a terminal; elsewhere a line about every 30 seconds, both on stderr.

    Parameters
    ----------
    what, unit : str
        What is being done, and to what, such as "building" and "poses".

    Yields
    ------
    progress : callable
        To be called with how many are done and how many there are in all.
    """
    if not sys.stderr.isatty():
        yield TimedLines(what, unit, lambda line: click.echo(line, err=True))
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        TextColumn,
        TimeRemainingColumn,
    )
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Any) -> Text:
            return Text(f"{task.speed:,.0f} {unit}/s" if task.speed else "")

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        Rate(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@contextmanager
def status_line(what: str) -> Iterator[Callable[[str], None] | None]:
    """A line that says what is being done, with a spinner, on a terminal; None elsewhere.

    It stands there at once, and is removed at the end.
    """
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.live import Live
    from rich.spinner import Spinner

    def line(text: str) -> Spinner:
        return Spinner("dots", f"{text} ...")

    with Live(line(what), console=Console(stderr=True), transient=True) as live:
        live.refresh()  # now, and not at the end of its first interval
        yield lambda text: live.update(line(text), refresh=True)


def readable_size(count: int) -> str:
    """Bytes as people read them, such as 4.6 MB."""
    from rich.filesize import decimal

    return decimal(count)


def print_result(as_json: bool, content: dict[str, Any], text: str) -> None:
    """Print a result: its content as JSON for programs, or else the text for people."""
    if as_json:
        try:
            text = json.dumps(content, indent=2, allow_nan=False)
        except ValueError as error:
            raise click.ClickException(
                "a figure is not finite, and JSON has no such number; ask again without --json"
            ) from error
    click.echo(text)
