"""``python -m benchmarks``: print the tables, and keep their figures in benchmarks/results/."""

import json
import os
import platform
import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Table

from benchmarks.tables import TABLES

RESULTS = Path(__file__).parent / "results"


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("tables", nargs=-1, type=click.Choice(list(TABLES)))
def main(tables: tuple[str, ...]) -> None:
    """Print the TABLES named, or all."""
    console = Console(width=None if sys.stdout.isatty() else 120)
    machine = f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}"
    names = tables or tuple(TABLES)
    for name in _announced(names):
        title = (TABLES[name].__doc__ or name).splitlines()[0].rstrip(".")
        figures = TABLES[name]()
        if not figures:
            console.print(f"{name}: this machine has nothing to measure it on")
            continue
        table = Table("what", "measured", "target", "met", title=f"{title} ({machine})")
        for figure in figures:
            met = "" if figure.met is None else "yes" if figure.met else "NO"
            table.add_row(figure.what, figure.measured, figure.target, met)
        console.print(table)
        RESULTS.mkdir(exist_ok=True)
        content = {"machine": machine, "figures": [asdict(figure) for figure in figures]}
        (RESULTS / f"{name}.json").write_text(json.dumps(content, indent=2) + "\n")


def _announced(names: tuple[str, ...]) -> Iterator[str]:
    """The tables' names, each said on stderr before it is measured: by a bar on a terminal.

    The bar is drawn between tables alone: a thread that redraws it would be measured too.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        for number, name in enumerate(names, start=1):
            click.echo(f"measuring {name}, table {number} of {len(names)}", err=True)
            yield name
        return
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn()
    with Progress(*columns, console=console, transient=True, auto_refresh=False) as bar:
        task = bar.add_task("measuring", total=len(names))
        for name in names:
            bar.update(task, description=f"measuring {name}", refresh=True)
            yield name
            bar.update(task, advance=1, refresh=True)


if __name__ == "__main__":
    main()
