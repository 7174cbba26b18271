"""Draw an answer beside the slices that it was found with, from a trained run and its test part.

For instance, with a run whose settings are those of docs/results.md, "Bands of range"::

    python examples/answer_picture.py runs/bands --sample 50 docs/images/answer.jpg
"""

from dataclasses import replace
from pathlib import Path

import click
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image
from slicematch import Estimate, Localizer
from slicematch.data.images import denormalise
from slicematch.evaluation.drawing import draw_estimate
from slicematch.evaluation.metrics import pose_errors

from slicemask import Frustum, slice_masks
from slicemask.plot import draw_slices, slice_colours

_INK = "#17212b"


def draw_cut(
    tile: Image.Image, ground: Image.Image, estimate: Estimate, frustum: Frustum, like: Figure
) -> Figure:
    """The tile and the ground image in the slices of an answer, laid out like its picture."""
    figure = Figure(figsize=like.get_size_inches(), facecolor="white")
    # A little to the right, where the picture of an answer has its bar of colours.
    first, last = (like.axes[n].get_position().translated(0.06, 0.0) for n in (0, -1))
    above = figure.add_axes(first)
    masks = slice_masks([estimate.pose], frustum, cells=32)[0]
    draw_slices(above, masks, estimate.pose, frustum, tile)
    below = figure.add_axes(last)
    below.imshow(np.asarray(ground), extent=(0, frustum.slices, 0, 1), aspect="auto")
    for n, colour in enumerate(slice_colours(frustum.slices)):
        below.fill((n, n + 1, n + 1, n), (0, 0, 1, 1), color=colour, alpha=0.3, linewidth=0)
    below.vlines(np.arange(frustum.slices + 1), 0, 1, color="white", linewidth=0.9)
    below.set_axis_off()
    figure.text(
        first.x0,
        first.y1 + 0.035,
        "One candidate: its slices, from above and from the street",
        fontsize=11,
        fontweight="bold",
        color=_INK,
    )
    return figure


def _pixels(figure: Figure) -> Image.Image:
    figure.set_dpi(110)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")


@click.command()
@click.argument("run", type=click.Path(path_type=Path, exists=True))
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--sample", default=0, show_default=True, help="Place in the test part's list.")
@click.option("--root", help="Folder of the data tree.  [default: the run's]")
@click.option("--grid", default="21x21x64", show_default=True, help="Candidates.")
def main(run: Path, out: Path, sample: int, root: str | None, grid: str) -> None:
    """Draw the answer of a RUN for a sample of its test part into OUT."""
    localizer = Localizer.load(run, grid=grid, checkpoint="last", device="cpu")
    config = localizer.config
    dataset = config.dataset("test", root)
    truth, side_m = dataset.poses()[sample], float(dataset.tile_metres[sample])
    ground = localizer.encode_ground_pixels(dataset[sample]["ground"][None])
    aerial = localizer.encode_aerial_pixels(dataset[sample]["aerial"][None])
    (estimate,) = localizer.estimate(ground, aerial, [config.aerial_size], [side_m])
    # The same sample, larger than the network takes it.
    shown = replace(config, ground_size=(256, 512), aerial_size=512).dataset("test", root)[sample]
    street, tile = (
        Image.fromarray(denormalise(shown[kind], *config.normalisation()))
        for kind in ("ground", "aerial")
    )
    errors = pose_errors([estimate.pose], [truth], side_m)
    answer = draw_estimate(
        tile,
        estimate.heat_map,
        estimate.grid,
        estimate.pose,
        localizer.frustum,
        truth=truth,
        ground=street,
        title=f"The answer, among {len(estimate.grid):,} candidates: "
        f"{errors.place_m[0]:.1f} m and {errors.heading_deg[0]:.0f}° off",
        estimate=estimate,
        tile_metres=side_m,
    )
    parts = [
        _pixels(draw_cut(tile, street, estimate, localizer.frustum, answer)),
        _pixels(answer),
    ]
    whole = Image.new("RGB", (sum(part.width for part in parts), parts[0].height), "white")
    whole.paste(parts[0], (0, 0))
    whole.paste(parts[1], (parts[0].width, 0))
    whole.save(out, quality=85)
    click.echo(f"{out}: sample {sample}, {dataset.names[sample]}")


if __name__ == "__main__":
    main()
