"""Drawing the slices of one pose: on the tile, and mask by mask."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from slicemask.errors import SpecError
from slicemask.geometry.frustum import Frustum
from slicemask.images import read_aerial
from slicemask.plot.colours import FRAME, INK, MUTED, PAPER, band_colours, blend, slice_colours
from slicemask.plot.marks import (
    MARGIN,
    draw_bands,
    draw_camera,
    draw_edges,
    draw_frame,
    draw_numbers,
)
from slicemask.plot.outlines import Pose, check_pose

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Aerial = NDArray[Any] | Image.Image

_TILE_OPACITY = 0.47  # of the slices on an aerial tile, which is to be seen through them
_MOST_LINES = 65  # more cells than this along a side are drawn without lines between them
_MOST_PIXELS = 2048  # of an aerial tile along a side; no picture shows more

# The layout of `draw_pose`, in inches.
_LEFT, _BETWEEN, _RIGHT, _TOP, _BOTTOM = 0.8, 0.6, 0.85, 1.02, 0.72
_SMALLEST_TILE, _LARGEST_TILE, _PITCH = 4.4, 9.6, 0.8
_BAR_GAP, _BAR_WIDTH = 0.2, 0.13


def draw_pose(
    masks: ArrayLike,
    pose: Pose,
    frustum: Frustum,
    *,
    aerial: Aerial | None = None,
    title: str | None = None,
) -> "Figure":
    """Draw the slices of a pose on the tile, and beside it the mask of each.

    With bands, the masks are a sheet of N rows and B columns, the nearest band first.

    Parameters
    ----------
    masks : array [N, L, L]
        The pose's slice masks, from a bank or from `slicemask.slice_masks`; [N, B, L, L] where the
        frustum has bands, which are drawn in shades of their slice's colour.
    pose : array [3]
        u, v in [0, 1] of the aerial frame and heading_deg, clockwise from north.
    frustum : Frustum
        Field of view and its N slices.
    aerial : array [S, S, 3] or picture, optional
        The aerial tile, north up: bytes, or floating point in [0, 1]. Without it, the cells are
        drawn on a plain ground.
    title : str, optional
        Replaces the first line.

    Returns
    -------
    figure : matplotlib.figure.Figure
        Bound to no window. It grows with N beyond 25 slices.

    Raises
    ------
    SpecError
        If the masks' shape does not fit the frustum.
    ImageError
        If the tile is unreadable or not square.
    PoseError
        If the pose lies outside the tile or is not finite.
    """
    from matplotlib.figure import Figure

    masks = _check_masks(masks, frustum)
    u, v, heading_deg = (float(value) for value in check_pose(pose))
    cells = masks.shape[-1]
    rows = math.ceil(math.sqrt(frustum.slices))
    columns = math.ceil(frustum.slices / rows)
    if frustum.bands:
        rows, columns = frustum.slices, frustum.band_count
    tile = min(max(_SMALLEST_TILE, rows * _PITCH), _LARGEST_TILE)
    gap = min(0.19, 0.25 * tile / rows)  # above each mask, for its number
    side = (tile + gap) / rows - gap
    block = columns * side + (columns - 1) * gap * 0.7
    whole = tile * (1.0 + 2.0 * MARGIN)
    width = _LEFT + whole + _BETWEEN + block + _BAR_GAP + _BAR_WIDTH + _RIGHT
    height = _BOTTOM + whole + _TOP
    figure = Figure(figsize=(width, height), facecolor="white")

    def add_axes(left: float, bottom: float, wide: float, high: float) -> "Axes":
        return figure.add_axes((left / width, bottom / height, wide / width, high / height))

    def write(left: float, bottom: float, text: str, **style: Any) -> None:
        figure.text(left / width, bottom / height, text, parse_math=False, **style)

    pose_axes = add_axes(_LEFT, _BOTTOM, whole, whole)
    _draw_on_tile(pose_axes, masks, np.array([u, v, heading_deg]), frustum, aerial)

    start, foot = _LEFT + whole + _BETWEEN, _BOTTOM + tile * MARGIN
    image = None
    shades = band_colours(slice_colours(frustum.slices), frustum.band_count)
    for number, (n, b) in enumerate(np.ndindex(shades.shape[:2])):
        colour = shades[n, b]
        row, column = divmod(number, columns)
        axes = add_axes(
            start + column * (side + gap * 0.7),
            foot + tile + gap - (row + 1) * (side + gap),
            side,
            side,
        )
        label = str(n) if gap > 0.12 and b == 0 else ""
        image = _draw_mask(axes, masks[n, b], colour, label)
        axes.plot(u, v, "o", markersize=3.2, color=colour, markeredgecolor="white", mew=0.5)
    if image is not None:
        bar_axes = add_axes(start + block + _BAR_GAP, foot, _BAR_WIDTH, tile)
        bar = figure.colorbar(image, cax=bar_axes)
        bar.set_label("fraction of the cell covered", fontsize=9, color=INK)
        bar.ax.tick_params(labelsize=8, color=FRAME, labelcolor=MUTED, length=3)
        bar.outline.set_edgecolor(FRAME)

    write(
        _LEFT,
        height - 0.38,
        title or "Slice masks of a camera pose",
        fontsize=14,
        fontweight="bold",
        color=INK,
    )
    write(_LEFT, height - 0.63, _subtitle(u, v, heading_deg, frustum, cells), fontsize=9, color=INK)
    caption = _BOTTOM + whole + 0.02
    ground = "aerial tile" if aerial is not None else "cells of the tile"
    write(_LEFT, caption, f"The slices on the {ground}", fontsize=9.5, color=MUTED)
    sheet = "The mask of each slice n" if frustum.slices > 1 else "The mask of the slice, n = 0"
    if frustum.bands:
        sheet = "Slices down, bands across"  # a sheet may be narrow
    write(start, caption, sheet, fontsize=9.5, color=MUTED)
    return figure


def draw_slices(
    axes: "Axes",
    masks: ArrayLike,
    pose: Pose,
    frustum: Frustum,
    aerial: Aerial | None = None,
) -> None:
    """Draw the slices of a pose on axes of one's own.

    Each cell shows the slices' colours, weighted by their fractions, as opaque as the fractions'
    sum. The rays are the exact edges of the slices, from the camera to the tile's border. Slices
    are numbered around the border, larger ones first where there is no room for all.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        What to draw on. Their limits and labels are set.
    masks : array [N, L, L]
        The pose's slice masks, from a bank or from `slicemask.slice_masks`; [N, B, L, L] where the
        frustum has bands, which are drawn in shades of their slice's colour.
    pose : array [3]
        u, v in [0, 1] of the aerial frame and heading_deg, clockwise from north.
    frustum : Frustum
        Field of view and its N slices.
    aerial : array [S, S, 3] or picture, optional
        The aerial tile, north up. Without it, the cells are drawn on a plain ground.

    Raises
    ------
    SpecError
        If the masks' shape does not fit the frustum.
    ImageError
        If the tile is unreadable or not square.
    PoseError
        If the pose lies outside the tile or is not finite.
    """
    _draw_on_tile(axes, _check_masks(masks, frustum), check_pose(pose), frustum, aerial)


def _draw_on_tile(
    axes: "Axes", masks: Array, camera: Array, frustum: Frustum, aerial: Aerial | None
) -> None:
    """Draw checked masks, float64 [N, B, L, L]; see `draw_slices`."""
    cells = masks.shape[-1]
    colours = slice_colours(frustum.slices)
    shades = band_colours(colours, frustum.band_count)
    axes.set(xlim=(-MARGIN, 1.0 + MARGIN), ylim=(1.0 + MARGIN, -MARGIN), aspect="equal")
    draw_frame(axes)

    extent = (0.0, 1.0, 1.0, 0.0)
    if aerial is None:
        axes.fill((0, 1, 1, 0), (0, 0, 1, 1), color=PAPER, linewidth=0, zorder=0)
    else:
        axes.imshow(_square_picture(aerial), extent=extent, zorder=0)
    opacity = 1.0 if aerial is None else _TILE_OPACITY
    parts = masks.reshape(-1, cells, cells)
    axes.imshow(blend(parts, shades.reshape(-1, 3), opacity), extent=extent, zorder=1)
    if cells < _MOST_LINES:
        borders = np.arange(1, cells) / cells
        style: dict[str, Any] = {"colors": "white", "linewidth": 0.4, "zorder": 2}
        style["alpha"] = 0.8 if aerial is None else 0.3
        axes.hlines(borders, 0.0, 1.0, **style)
        axes.vlines(borders, 0.0, 1.0, **style)
    axes.plot((0, 1, 1, 0, 0), (0, 0, 1, 1, 0), color=FRAME, linewidth=0.8, zorder=3)

    draw_edges(axes, camera, frustum)
    draw_bands(axes, camera, frustum)
    draw_numbers(axes, masks.sum(axis=1), camera, frustum, colours)
    draw_camera(axes, camera)


def _check_masks(masks: ArrayLike, frustum: Frustum) -> Array:
    """The masks as float64 [N, B, L, L]; B is 1 without bands."""
    array = np.asarray(masks, dtype=np.float64)
    counts: tuple[int, ...] = (frustum.slices,)
    form, what = "[N, L, L]", f"N = {frustum.slices} slices"
    if frustum.bands:
        counts = (frustum.slices, frustum.band_count)
        form, what = "[N, B, L, L]", f"{what} and B = {frustum.band_count} bands"
    ends = array.shape[-2:]
    if array.ndim != len(counts) + 2 or array.shape[:-2] != counts or ends[0] != ends[1]:
        raise SpecError(
            f"masks have shape {list(array.shape)}; they must be {form} with the frustum's {what}"
        )
    return array if frustum.bands else array[:, None]


def _square_picture(aerial: Aerial) -> Image.Image:
    """The tile as an RGB picture, no larger than can be seen."""
    picture = read_aerial(aerial)
    picture.thumbnail((_MOST_PIXELS, _MOST_PIXELS))
    return picture


def _draw_mask(axes: "Axes", mask: Array, colour: Array, number: str) -> Any:
    """One mask, framed with its slice's colour; the image, for the colour bar."""
    from matplotlib.colors import LinearSegmentedColormap

    shades = LinearSegmentedColormap.from_list("fraction", [PAPER, "#8c98a4", INK])
    image = axes.imshow(mask, cmap=shades, vmin=0.0, vmax=1.0, extent=(0.0, 1.0, 1.0, 0.0))
    axes.set(xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set(color=tuple(colour), linewidth=1.6)
    axes.set_title(
        number, loc="left", fontsize=8, fontweight="bold", color=tuple(0.72 * colour), pad=2.5
    )
    if not mask.any():
        axes.text(0.5, 0.5, "empty", ha="center", va="center", fontsize=7, color=MUTED)
    return image


def hfov_text(frustum: Frustum) -> str:
    """What a picture says of a field of view."""
    angles = f"{frustum.hfov_deg:.5g}°"
    if frustum.left_deg is not None:
        angles = f"{frustum.left_deg:.4g}° to {frustum.right_deg:.4g}°"
    return f"HFoV {angles}, {frustum.projection}"


def _subtitle(u: float, v: float, heading_deg: float, frustum: Frustum, cells: int) -> str:
    return "   ·   ".join(
        [
            f"camera at u = {u:.4g}, v = {v:.4g}, heading {heading_deg:.5g}°",
            hfov_text(frustum),
            f"N = {frustum.slices} {'slice' if frustum.slices == 1 else 'slices'}"
            + (f" of B = {frustum.band_count} bands" if frustum.bands else ""),
            f"{cells} x {cells} cells",
        ]
    )
