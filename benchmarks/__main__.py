"""``python -m benchmarks``: print the tables, and keep their figures in benchmarks/results/."""

import json
import os
import platform
import sys
from dataclasses import asdict
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from benchmarks.tables import TABLES

RESULTS = Path(__file__).parent / "results"


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("tables", nargs=-1, type=click.Choice(list(TABLES)))
def main(tables: tuple[str, ...]) -> None:
    """Print the TABLES named, or all."""
    console = Console(width=None if sys.stdout.isatty() else 120)
    machine = f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}"
    for name in tables or TABLES:
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


if __name__ == "__main__":
    main()
