"""Picture files: aerial tiles read, figures and animations written whole or not at all."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image, ImageOps
from PIL.ImageColor import getrgb

from slicemask.errors import PlotError, SpecError
from slicemask.files import atomic_write, check_target
from slicemask.geometry.frustum import Frustum
from slicemask.geometry.masks import Engine, slice_masks
from slicemask.geometry.numbers import is_whole
from slicemask.plot.colours import INK, MUTED, PAPER
from slicemask.plot.figure import Aerial, draw_slices, hfov_text
from slicemask.plot.outlines import Pose, check_pose

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURE_SUFFIXES = (".png", ".svg", ".pdf")
_DOTS_PER_INCH = 160
# Frames of an animation: their size in inches, pixels to the inch, and colours. They keep 72 frames
# below 3 MB on a busy tile; many slices change more with each frame, and get smaller ones.
_FRAME_SIZE = (4.6, 4.9)
_FRAME_DOTS, _MOST_SLICES_AT_FULL_SIZE = 100, 16
_FRAME_COLOURS = 128
_ROUND_SECONDS = 7.2


def check_figure_target(path: str | Path) -> Path:
    """Return the path of a figure to be written, or raise PlotError if it is invalid."""
    return check_target(path, FIGURE_SUFFIXES, PlotError)


def save_figure(figure: "Figure", path: str | Path) -> None:
    """Write a figure as PNG, SVG or PDF, by the path's suffix; a file already there is replaced.

    The same figure gives the same bytes, for the same versions of Matplotlib.

    Raises
    ------
    PlotError
        If the suffix is another, or the file cannot be written; nothing is left behind.
    """
    import matplotlib

    path = check_figure_target(path)
    form = path.suffix.lower()[1:]
    metadata = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(form)
    with (
        atomic_write(path, PlotError) as partial,
        matplotlib.rc_context({"svg.hashsalt": "slicemask"}),
    ):
        figure.savefig(partial, format=form, dpi=_DOTS_PER_INCH, metadata=metadata)


def animate_heading(
    pose: Pose,
    frustum: Frustum,
    cells: int,
    path: str | Path,
    *,
    aerial: Aerial | None = None,
    frames: int = 72,
    engine: Engine = "rays",
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write a GIF in which the camera turns once around, clockwise from the pose's heading.

    Every frame shows the exact masks of its heading, in the colours and on the axes of
    `slicemask.plot.draw_slices`.

    Parameters
    ----------
    pose : array [3]
        u, v in [0, 1] of the aerial frame and heading_deg, clockwise from north.
    frustum : Frustum
        Field of view and its slices.
    cells : int
        L, the cells along each side of the tile.
    path : path
        Where it goes; its suffix must be ``.gif``. A file already there is replaced.
    aerial : array [S, S, 3] or picture, optional
        The aerial tile, as for `slicemask.plot.draw_pose`.
    frames : int
        How many headings, from 2 to 360; one round takes some 7 seconds whatever their number.
    engine : {"rays", "shapely"}
        What computes the masks.
    progress : callable, optional
        Called with (frames done, frames in all) as the work goes on.

    Raises
    ------
    PlotError
        If the suffix is another, or the file cannot be written; nothing is left behind.
    SpecError, PoseError
        If another argument is invalid.
    """
    path = check_target(path, (".gif",), PlotError)
    if not is_whole(frames) or not 2 <= frames <= 360:
        raise SpecError(f"frames is {frames!r}; it must be a whole number from 2 to 360")
    u, v, start_deg = check_pose(pose)
    headings_deg = (start_deg + np.arange(frames) * 360.0 / frames) % 360.0

    def frame(heading_deg: float) -> Image.Image:
        masks = slice_masks([[u, v, heading_deg]], frustum, cells, engine)[0]
        return _frame(masks, np.array([u, v, heading_deg]), frustum, aerial)

    palette = _palette([frame(heading) for heading in headings_deg[:: max(1, frames // 6)]])

    def drawn() -> Iterator[Image.Image]:
        for done, heading_deg in enumerate(headings_deg, start=1):
            # One palette and no dithering: what does not change does not flicker.
            yield frame(heading_deg).quantize(palette=palette, dither=Image.Dither.NONE)
            if progress:
                progress(done, frames)

    with atomic_write(path, PlotError) as partial:
        pictures = drawn()
        next(pictures).save(
            partial,
            format="GIF",
            save_all=True,
            append_images=pictures,
            duration=round(_ROUND_SECONDS * 1000 / frames),
            loop=0,
        )


def _frame(
    masks: np.ndarray, pose: np.ndarray, frustum: Frustum, aerial: Aerial | None
) -> Image.Image:
    """One frame, in RGB. The layout is fixed, so that nothing but the slices moves."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    smaller = max(1.0, frustum.slices / _MOST_SLICES_AT_FULL_SIZE) ** 0.25
    figure = Figure(figsize=_FRAME_SIZE, dpi=_FRAME_DOTS / smaller, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    width, height = _FRAME_SIZE
    axes = figure.add_axes((0.62 / width, 0.5 / height, 3.7 / width, 3.7 / height))
    draw_slices(axes, masks, pose, frustum, aerial)
    left = 0.62 / width
    figure.text(
        left,
        1 - 0.27 / height,
        f"heading {pose[2]:5.1f}°",
        fontsize=12,
        fontweight="bold",
        color=INK,
    )
    figure.text(
        left,
        1 - 0.49 / height,
        f"u = {pose[0]:.4g}, v = {pose[1]:.4g}  ·  {hfov_text(frustum)}  ·  "
        f"N = {frustum.slices}  ·  L = {masks.shape[-1]}",
        fontsize=7.5,
        color=MUTED,
    )
    canvas.draw()  # type: ignore[no-untyped-call]
    pixels = canvas.buffer_rgba()  # type: ignore[no-untyped-call]
    return Image.fromarray(np.asarray(pixels)).convert("RGB")


def _palette(frames: list[Image.Image]) -> Image.Image:
    """The colours that serve all of some frames, as a picture in them; those of the page exact."""
    width, height = frames[0].size
    montage = Image.new("RGB", (width, height * len(frames)))
    for number, picture in enumerate(frames):
        montage.paste(picture, (0, number * height))
    # Spread over the colours rather than the pixels, so that a slice keeps its colour however
    # narrow it is. Six bits a channel are told apart: a busy tile would take seconds otherwise.
    reduced = ImageOps.posterize(montage, 6).quantize(_FRAME_COLOURS, Image.Quantize.MAXCOVERAGE)
    colours = np.reshape(reduced.getpalette() or [], (-1, 3))
    for exact in map(getrgb, ("white", INK, PAPER)):
        colours[np.abs(colours - exact).sum(axis=1).argmin()] = exact
    palette = Image.new("P", (1, 1))
    palette.putpalette(colours.ravel().tolist())
    return palette
