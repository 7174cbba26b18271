"""Fine-tuning on a few real pairs, and what it does for one that was left out.

``python -m benchmarks.leave_one_out PAIRS`` takes the pairs of `benchmarks.real_pairs`, leaves out
one in turn, trains the run that ships on the others (`slicemask train --init`), and asks for the
one left out, in the same draws as before. Nothing that ships is trained on them.
"""

import csv
import json
from pathlib import Path

import click
import numpy as np
from rich.console import Console
from slicematch import Localizer

from benchmarks.commands import slicemask
from benchmarks.real_pairs import (
    GRID,
    answer_draws,
    judge,
    read_pairs,
    summarise,
    table_of,
    whole_sphere,
)
from slicemask.images import read_image

TRAINING = (
    "--data", "table", "--learning-rate", "1e-4", "--batch-size", "4", "--augment",
    "--heat-map-every", "0", "--workers", "0", "--accelerator", "cpu", "--test-grid", "14x14x32",
)  # fmt: skip


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("pairs", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--init", default="generated-city", show_default=True, help="The run to start from.")
@click.option("--epochs", default=20, show_default=True, help="Of eight pairs.")
@click.option("--freeze/--no-freeze", default=True, show_default=True, help="The encoders.")
@click.option("--draws", default=8, show_default=True, help="Of each pair.")
@click.option("--work", default="runs/leave-one-out", show_default=True, help="Where runs go.")
def main(pairs: Path, init: str, epochs: int, freeze: bool, draws: int, work: str) -> None:
    """Fine-tune on all PAIRS but one, in turn, and localize that one."""
    rows = read_pairs(pairs)
    start = Localizer.load(init, grid=GRID, refine="mean")
    folder = Path(work)
    photos = [_write_photo(row, pairs, folder) for row in rows]
    before, after = {}, {}
    for number, row in enumerate(rows):
        run = folder / f"without_{row['id']}"
        table = folder / f"without_{row['id']}.csv"
        with table.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, photos[0].keys())
            writer.writeheader()
            writer.writerows(photo for photo in photos if photo["id"] != row["id"])
        if not (run / "calibration.json").exists():
            frozen = ("--freeze-encoders",) if freeze else ()
            slicemask(
                "train", *TRAINING, *frozen, "--epochs", str(epochs), "--init", init,
                "--root", str(table), "--side-m", "72", "--out", str(run), "--resume", threads=1,
            )  # fmt: skip
        tuned = Localizer.load(run, grid=GRID, refine="mean")
        for found, localizer in ((before, start), (after, tuned)):
            side_m = localizer.tile_side_m or 72.0
            random = np.random.default_rng([0, number])
            answered = answer_draws(localizer, row, pairs, side_m, draws, random)
            found[row["id"]] = [judge(answer, draw) for draw, answer in answered]
    console = Console(width=120)
    for title, found in (("before", before), ("after", after)):
        console.print(title)
        console.print(table_of(found, summarise(found)))
    results = {"before": summarise(before), "after": summarise(after)}
    (folder / "result.json").write_text(json.dumps(results, indent=2) + "\n")


def _write_photo(row: dict[str, str], pairs: Path, folder: Path) -> dict[str, str]:
    """A pair as a row of a table; its panorama as a whole sphere."""
    ground = (folder / row["ground"]).absolute()
    ground.parent.mkdir(parents=True, exist_ok=True)
    sphere = whole_sphere(
        read_image(pairs / row["ground"]), float(row["top_deg"]), float(row["bottom_deg"])
    )
    sphere.save(ground, quality=95)
    columns = ("id", "u", "v", "heading_deg", "metres_per_pixel")
    return {name: row[name] for name in columns} | {
        "ground": str(ground), "tile": str((pairs / row["aerial"]).absolute()),
    }  # fmt: skip


if __name__ == "__main__":
    main()
