"""Answers of several runs to the same samples, in one picture.

``python -m benchmarks.same_cases OUT SAMPLE... --run RUN --run RUN --root DATA`` draws a row for
each run and a column for each sample of its test part, by the start of its name.
"""

from io import BytesIO
from pathlib import Path

import click
import numpy as np
from PIL import Image
from slicematch import Localizer
from slicematch.data.images import denormalise
from slicematch.evaluation.drawing import draw_estimate
from slicematch.evaluation.evaluate import estimates_of
from slicematch.evaluation.metrics import pose_errors

WIDTH = 512  # pixels of a picture


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("out", type=click.Path(path_type=Path))
@click.argument("samples", nargs=-1, required=True)
@click.option("--run", "runs", multiple=True, required=True)
@click.option("--root", required=True, help="Of the data.")
@click.option("--grid", default="21x21x64", show_default=True)
@click.option("--refine", default="mean", show_default=True)
def main(
    out: Path, samples: tuple[str, ...], runs: tuple[str, ...], root: str, grid: str, refine: str
) -> None:
    """Draw answers of RUNS to SAMPLES."""
    rows = [
        [_picture(run, root, name, grid, refine) for name in samples]
        for run in runs
    ]  # fmt: skip
    heights = [max(picture.height for picture in row) for row in rows]
    sheet = Image.new("RGB", (WIDTH * len(samples), sum(heights)), "white")
    for row, top in zip(rows, np.cumsum([0, *heights[:-1]]), strict=True):
        for column, picture in enumerate(row):
            sheet.paste(picture, (WIDTH * column, int(top)))
    sheet.save(out)


def _picture(run: str, root: str, name: str, grid: str, refine: str) -> Image.Image:
    localizer = Localizer.load(run, grid=grid, checkpoint="last", refine=refine)  # type: ignore[arg-type]
    dataset = localizer.config.dataset("test", root)
    found = [
        index for index, known in enumerate(dataset.names) if Path(known).name.startswith(name)
    ]
    if not found:
        raise click.UsageError(f"no sample's name begins with {name!r}.")
    sample = dataset[found[0]]
    if sample is None:
        raise click.ClickException(f"{name}: is unreadable")
    metres = np.array([dataset.tile_metres[found[0]]])
    (estimate,) = estimates_of(localizer, sample["ground"][None], sample["aerial"][None], metres)
    truth = np.asarray(sample["pose"])
    errors = pose_errors(estimate.pose[None], truth[None], metres)
    normalisation = localizer.config.normalisation()
    figure = draw_estimate(
        denormalise(sample["aerial"], *normalisation),
        estimate.heat_map,
        localizer.grid,
        estimate.pose,
        localizer.frustum,
        truth=truth,
        ground=denormalise(sample["ground"], *normalisation),
        title=f"{errors.place_m[0]:.2f} m and {errors.heading_deg[0]:.1f}° off",
        estimate=estimate,
        tile_metres=float(metres[0]),
    )
    file = BytesIO()
    figure.savefig(file, format="png", dpi=WIDTH / figure.get_figwidth())
    return (
        Image.open(file)
        .convert("RGB")
        .resize((WIDTH, round(WIDTH * figure.get_figheight() / figure.get_figwidth())))
    )


if __name__ == "__main__":
    main()
