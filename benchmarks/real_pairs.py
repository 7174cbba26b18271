"""A run on real photographs: how often it is right, and how sure it is of that.

``python -m benchmarks.real_pairs RUN PAIRS`` reads ``PAIRS/pairs.csv``: columns id, ground, aerial,
u, v, heading_deg, metres_per_pixel, and top_deg and bottom_deg, the elevations that a panorama
covers. From each pair it makes several draws: a tile of the run's size on the ground is cut around
the camera, off its centre by as much as the picture allows, and the panorama is turned by a random
angle, so that neither place nor heading can be guessed. Headings are unknown, or, with ``--prior``,
known to so many degrees. Standard errors are over pairs: draws of one pair are not independent.
"""

import csv
import json
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from PIL import Image
from rich.console import Console
from rich.table import Table
from slicematch import Estimate, Localizer
from slicematch.evaluation.drawing import draw_estimate
from slicematch.evaluation.metrics import heading_error_deg

from benchmarks.answer_sheet import SheetAnswer, save_sheet
from slicemask.images import read_image

# What counts as right.
RIGHT_M, RIGHT_DEG = 5.0, 20.0
# A tile is cut off centre by at most this share of its side.
FURTHEST = 0.25
BINS = 5
# Scores that most users' tiles would be searched with.
GRID = "21x21x64"


@dataclass(frozen=True)
class Draw:
    """A panorama turned and a tile cut: what the run sees, and the true pose [3] in that tile."""

    panorama: Image.Image
    tile: Image.Image
    metres_per_pixel: float
    truth: np.ndarray


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("run")
@click.argument("pairs", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--draws", default=8, show_default=True, help="Of each pair.")
@click.option("--prior", type=float, help="Headings are known to so many degrees.")
@click.option("--refine", default="mean", show_default=True)
@click.option("--grid", default=GRID, show_default=True)
@click.option("--checkpoint", default="best", show_default=True)
@click.option("--side", type=float, help="Of the tiles, metres.  [default: the run's]")
@click.option("--pictures", type=click.Path(path_type=Path), help="A picture of each first draw.")
@click.option("--sheet", type=click.Path(path_type=Path), help="All first draws, no photographs.")
@click.option("--seed", default=0, show_default=True)
@click.option("--out", type=click.Path(path_type=Path), help="Figures as JSON.")
def main(run: str, pairs: Path, draws: int, prior: float | None, refine: Any, grid: str,
         checkpoint: Any, side: float | None, pictures: Path | None, sheet: Path | None,
         seed: int, out: Path | None) -> None:  # fmt: skip
    """Localize the real PAIRS with RUN."""
    localizer = Localizer.load(run, grid=grid, checkpoint=checkpoint, refine=refine)
    side = side or localizer.tile_side_m or 70.0
    found, first = defaultdict(list), []
    for number, row in enumerate(read_pairs(pairs)):
        random = np.random.default_rng([seed, number])
        answered = answer_draws(localizer, row, pairs, side, draws, random, prior)
        for k, (draw, estimate) in enumerate(answered):
            judged = judge(estimate, draw)
            found[row["id"]].append(judged)
            if k == 0:
                side_m = draw.tile.width * draw.metres_per_pixel
                first.append(SheetAnswer(row["id"], estimate, draw.truth, side_m, _caption(judged)))
                if pictures is not None:
                    _save_picture(pictures / f"{row['id']}.png", localizer, estimate, draw)
    if sheet is not None:
        save_sheet(sheet, first)
    figures = summarise(found)
    Console(width=None if out is None else 120).print(table_of(found, figures))
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(json.dumps({"figures": figures, "pairs": found}, indent=2) + "\n")


def read_pairs(folder: Path) -> list[dict[str, str]]:
    """The rows of a folder's table of pairs."""
    with (folder / "pairs.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def answer_draws(
    localizer: Localizer, row: dict[str, str], folder: Path, side_m: float, draws: int,
    random: np.random.Generator, prior: float | None = None,
) -> Iterator[tuple[Draw, Estimate]]:  # fmt: skip
    """Draws of a pair, each with its answer."""
    for _ in range(draws):
        draw = make_draw(row, folder, side_m, random)
        heading_prior = (0.0, 180.0) if prior is None else (_off(draw, prior, random), prior)
        yield (
            draw,
            localizer.localize(
                draw.panorama, draw.tile, heading_prior, metres_per_pixel=draw.metres_per_pixel
            ),
        )


def make_draw(
    row: dict[str, str], folder: Path, side_m: float, random: np.random.Generator
) -> Draw:
    """Turn a pair's panorama at random, and cut a tile at random around its camera."""
    panorama = whole_sphere(
        read_image(folder / row["ground"]), float(row["top_deg"]), float(row["bottom_deg"])
    )
    turn = int(random.integers(panorama.width))
    turned = Image.fromarray(np.roll(np.asarray(panorama), -turn, axis=1))
    heading_deg = (float(row["heading_deg"]) + 360.0 * turn / panorama.width) % 360.0

    image = read_image(folder / row["aerial"])
    side = min(round(side_m / float(row["metres_per_pixel"])), image.width, image.height)
    camera = np.array([float(row["u"]) * image.width, float(row["v"]) * image.height])
    centre = camera + random.uniform(-FURTHEST, FURTHEST, 2) * side
    corner = np.clip(np.round(centre - side / 2), 0, np.array(image.size) - side).astype(int)
    tile = image.crop((*corner, *(corner + side)))
    return Draw(
        turned,
        tile,
        float(row["metres_per_pixel"]),
        np.array([*((camera - corner) / side), heading_deg]),
    )


def whole_sphere(image: Image.Image, top_deg: float, bottom_deg: float) -> Image.Image:
    """A panorama of all elevations, black where this one shows none."""
    height = image.width // 2
    first, last = (round((90.0 - angle) / 180.0 * height) for angle in (top_deg, bottom_deg))
    sphere = Image.new("RGB", (2 * height, height))
    sphere.paste(image.resize((2 * height, last - first), Image.Resampling.LANCZOS), (0, first))
    return sphere


def _off(draw: Draw, prior: float, random: np.random.Generator) -> float:
    """The centre of a heading prior: off the truth by anything within it."""
    return float((draw.truth[2] + random.uniform(-prior, prior)) % 360.0)


def judge(estimate: Estimate, draw: Draw) -> dict[str, float]:
    """The errors of an answer, and the probability that it gave to being right."""
    side_m = draw.tile.width * draw.metres_per_pixel
    pose = estimate.pose
    poses = estimate.grid.poses().reshape(-1, 3)
    near = np.linalg.norm(poses[:, :2] - pose[:2], axis=1) * side_m <= RIGHT_M
    near &= heading_error_deg(poses[:, 2], np.full(len(poses), pose[2])) <= RIGHT_DEG
    place_m = float(np.linalg.norm(pose[:2] - draw.truth[:2]) * side_m)
    heading_deg = float(heading_error_deg(pose[2:], draw.truth[2:])[0])
    return {
        "place_m": place_m,
        "heading_deg": heading_deg,
        "probability": float(estimate.probabilities.ravel()[near].sum()),
        "right": float(place_m <= RIGHT_M and heading_deg <= RIGHT_DEG),
    }


def summarise(found: dict[str, list[dict[str, float]]]) -> dict[str, float]:
    """Figures over all draws; standard errors from bootstrapped pairs."""
    keys = ("place_m", "heading_deg", "probability", "right")
    values = np.array([[[draw[key] for key in keys] for draw in draws] for draws in found.values()])

    def of(chosen: np.ndarray) -> dict[str, float]:
        place_m, heading_deg, probability, right = chosen.reshape(-1, len(keys)).T
        return {
            "heading_within_20deg": float(np.mean(heading_deg <= RIGHT_DEG)),
            "heading_median_deg": float(np.median(heading_deg)),
            "place_median_m": float(np.median(place_m)),
            "place_mean_m": float(np.mean(place_m)),
            "right": float(np.mean(right)),
            "calibration_error": calibration_error(probability, right),
        }

    drawn = np.random.default_rng(0).integers(len(values), size=(1000, len(values)))
    spread = [of(values[chosen]) for chosen in drawn]
    figures = of(values)
    errors = {f"{key}_se": float(np.std([some[key] for some in spread], ddof=1)) for key in figures}
    return figures | errors


def calibration_error(probability: np.ndarray, right: np.ndarray) -> float:
    """Expected calibration error over bins of equally many answers.

    Guo, Pleiss, Sun, Weinberger, ICML 2017, eq. 3.
    """
    bins = np.array_split(np.argsort(probability), BINS)
    gaps = [len(b) * abs(probability[b].mean() - right[b].mean()) for b in bins if len(b)]
    return float(np.sum(gaps) / len(probability))


def table_of(found: dict[str, list[dict[str, float]]], figures: dict[str, float]) -> Table:
    table = Table("pair", "within 20 deg", "median deg", "median m", "right", "probability")
    for name, draws in found.items():
        column = {key: np.array([draw[key] for draw in draws]) for key in draws[0]}
        table.add_row(
            name,
            f"{np.mean(column['heading_deg'] <= RIGHT_DEG):.0%}",
            f"{np.median(column['heading_deg']):.1f}",
            f"{np.median(column['place_m']):.1f}",
            f"{column['right'].mean():.0%}",
            f"{column['probability'].mean():.0%}",
        )
    table.add_section()
    table.add_row(
        "all ± se over pairs",
        f"{figures['heading_within_20deg']:.0%} ± {figures['heading_within_20deg_se']:.0%}",
        f"{figures['heading_median_deg']:.1f} ± {figures['heading_median_deg_se']:.1f}",
        f"{figures['place_median_m']:.1f} ± {figures['place_median_m_se']:.1f}",
        f"{figures['right']:.0%} ± {figures['right_se']:.0%}",
        f"error {figures['calibration_error']:.2f}",
    )
    return table


def _caption(judged: dict[str, float]) -> str:
    return f"off by {judged['place_m']:.1f} m and {judged['heading_deg']:.0f} degrees"


def _save_picture(path: Path, localizer: Localizer, estimate: Estimate, draw: Draw) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure = draw_estimate(
        draw.tile,
        estimate.heat_map,
        estimate.grid,
        estimate.pose,
        localizer.frustum,
        draw.truth,
        draw.panorama,
        f"{path.stem}: {_caption(judge(estimate, draw))}",
        estimate,
        draw.tile.width * draw.metres_per_pixel,
    )
    figure.savefig(path)


if __name__ == "__main__":
    main()
