"""Drawing the slices of one pose: on the tile, and mask by mask."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from slicemask.errors import SpecError
from slicemask.geometry.azimuths import direction
from slicemask.geometry.frustum import Frustum
from slicemask.geometry.poses import check_poses
from slicemask.images import read_aerial

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Pose = Sequence[float] | Array
Aerial = NDArray[Any] | Image.Image

INK, MUTED, FRAME, PAPER = "#17212b", "#5b6874", "#c9d0d6", "#f1f3f5"
# A wheel of hues, so that the last slice of a panorama goes over into the first.
_WHEEL = (
    "#3f74d1", "#7d5fd3", "#b954b6", "#e0527c", "#e9683f", "#f0932b",
    "#ecc02f", "#a3bf3f", "#4fae62", "#22a3a0", "#3596d3",
)  # fmt: skip
# Room around the tile for slice numbers, as a fraction of its side.
MARGIN = 0.075
_ARROW = 0.13  # length of the heading's arrow, as a fraction of the tile's side
_TILE_OPACITY = 0.47  # of the slices on an aerial tile, which is to be seen through them
_MOST_LINES = 65  # more cells than this along a side are drawn without lines between them
_MOST_PIXELS = 2048  # of an aerial tile along a side; no picture shows more

# The layout of `draw_pose`, in inches.
_LEFT, _BETWEEN, _RIGHT, _TOP, _BOTTOM = 0.8, 0.6, 0.85, 1.02, 0.72
_SMALLEST_TILE, _LARGEST_TILE, _PITCH = 4.4, 9.6, 0.8
_BAR_GAP, _BAR_WIDTH = 0.2, 0.13
# How far the farthest band is lighter than the nearest, towards white.
_LIGHTEST = 0.6


def slice_colours(slices: int) -> Array:
    """Colours of slices 0..N-1, of which neighbours differ.

    Hues run once around a wheel, since slices run around the camera; where there are many, every
    other one is lighter.

    Parameters
    ----------
    slices : int
        N, at least 1.

    Returns
    -------
    float64 [N, 3]
        Red, green, blue in [0, 1].
    """
    from matplotlib.colors import LinearSegmentedColormap

    wheel = LinearSegmentedColormap.from_list("slices", [*_WHEEL, _WHEEL[0]])
    number = np.arange(slices)
    colours = wheel(number / slices)[:, :3]
    if slices <= 8:
        return np.asarray(colours)
    lighter = np.where(number % 2 == 1, 0.36, 0.0)
    if slices % 2 == 1:  # slice 0 is a neighbour of the last one
        lighter[-1] = 0.18
    return np.asarray(colours + lighter[:, None] * (1.0 - colours))


def band_colours(colours: Array, bands: int) -> Array:
    """Shades of slices' colours for their bands: the nearest full, farther ones lighter.

    Parameters
    ----------
    colours : float64 [N, 3]
        Of the slices.
    bands : int
        B, at least 1.

    Returns
    -------
    float64 [N, B, 3]
        Red, green, blue in [0, 1].
    """
    lighter = _LIGHTEST * np.arange(bands) / max(bands - 1, 1)
    shades = colours[:, None] + lighter[:, None] * (1.0 - colours[:, None])
    return np.asarray(shades)


def edge_ends(pose: Pose, azimuth_deg: ArrayLike) -> Array:
    """Where rays from the camera leave the tile.

    Parameters
    ----------
    pose : array [3]
        u, v, heading_deg; the heading is not used.
    azimuth_deg : array [E]
        Azimuths of the rays, degrees clockwise from north.

    Returns
    -------
    ends : float64 [E, 2]
        u, v of the tile's border, in the aerial frame; the camera itself for a ray that leaves
        the tile at once.

    Raises
    ------
    PoseError
        If the pose lies outside the tile or is not finite.

    Examples
    --------
    >>> edge_ends((0.5, 0.75, 0.0), [0.0, 45.0, 90.0]).tolist()
    [[0.5, 0.0], [1.0, 0.25], [1.0, 0.75]]
    """
    camera = check_pose(pose)[:2]
    rays = np.stack(direction(np.asarray(azimuth_deg, dtype=np.float64), np), axis=-1)
    room = np.where(rays > 0.0, 1.0 - camera, camera)
    steps = np.where(rays == 0.0, np.inf, room / np.where(rays == 0.0, 1.0, np.abs(rays)))
    ends = camera + rays * steps.min(axis=-1, keepdims=True)
    return np.asarray(np.clip(ends, 0.0, 1.0))


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
    _draw_frame(axes)

    extent = (0.0, 1.0, 1.0, 0.0)
    if aerial is None:
        axes.fill((0, 1, 1, 0), (0, 0, 1, 1), color=PAPER, linewidth=0, zorder=0)
    else:
        axes.imshow(_square_picture(aerial), extent=extent, zorder=0)
    opacity = 1.0 if aerial is None else _TILE_OPACITY
    parts = masks.reshape(-1, cells, cells)
    axes.imshow(_blend(parts, shades.reshape(-1, 3), opacity), extent=extent, zorder=1)
    if cells < _MOST_LINES:
        borders = np.arange(1, cells) / cells
        style: dict[str, Any] = {"colors": "white", "linewidth": 0.4, "zorder": 2}
        style["alpha"] = 0.8 if aerial is None else 0.3
        axes.hlines(borders, 0.0, 1.0, **style)
        axes.vlines(borders, 0.0, 1.0, **style)
    axes.plot((0, 1, 1, 0, 0), (0, 0, 1, 1, 0), color=FRAME, linewidth=0.8, zorder=3)

    _draw_edges(axes, camera, frustum)
    _draw_bands(axes, camera, frustum)
    _draw_numbers(axes, masks.sum(axis=1), camera, frustum, colours)
    _draw_camera(axes, camera)


def check_pose(pose: Pose) -> Array:
    """Check one pose.

    Parameters
    ----------
    pose : array [3]
        u, v in [0, 1] of the aerial frame and heading_deg, any finite angle.

    Returns
    -------
    float64 [3]
        With the heading in [0, 360).

    Raises
    ------
    PoseError
        If it lies outside the tile, is not finite or is no pose.
    """
    poses: Any = [pose]
    return np.asarray(check_poses(poses)[0])


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


def _blend(masks: Array, colours: Array, opacity: float) -> Array:
    """Cells in their slices' colours: float64 [L, L, 4], colours weighted by the fractions."""
    covered = masks.sum(axis=0)
    colour = np.einsum("nij,nc->ijc", masks, colours) / np.maximum(covered, 1e-12)[..., None]
    return np.dstack([np.clip(colour, 0.0, 1.0), opacity * np.clip(covered, 0.0, 1.0)])


def _draw_frame(axes: "Axes") -> None:
    """Axes in the aerial frame, set off from the tile, and an arrow to the north."""
    for name, spine in axes.spines.items():
        spine.set(visible=name in ("left", "bottom"), color=FRAME)
        spine.set_bounds(0.0, 1.0)
    ticks = (0.0, 0.25, 0.5, 0.75, 1.0)
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.tick_params(labelsize=8, color=FRAME, labelcolor=MUTED, length=3)
    axes.set_xlabel("u (east)", fontsize=9, color=INK)
    axes.set_ylabel("v (south)", fontsize=9, color=INK)
    axes.annotate(
        "N",
        xy=(1.0 + 1.3 * MARGIN, 0.09),
        xytext=(1.0 + 1.3 * MARGIN, -0.6 * MARGIN),
        ha="center",
        va="center",
        fontsize=8.5,
        fontweight="bold",
        color=INK,
        annotation_clip=False,
        arrowprops={"arrowstyle": "<|-", "color": INK, "linewidth": 1.1, "shrinkA": 2},
    )


def _draw_edges(axes: "Axes", pose: Array, frustum: Frustum) -> None:
    """The N + 1 exact edges; those that bound the field of view are heavier."""
    from matplotlib.patheffects import withStroke

    ends = edge_ends(pose, frustum.edges_deg(pose[2]))
    inner_width = 0.8 if frustum.slices <= 24 else 0.5
    for number, (u, v) in enumerate(ends):
        outer = frustum.hfov_deg < 360.0 and number in (0, frustum.slices)
        width = 1.7 if outer else inner_width
        axes.plot(
            (pose[0], u),
            (pose[1], v),
            color=INK,
            linewidth=width,
            solid_capstyle="round",
            path_effects=[
                withStroke(linewidth=3.2 if outer else 1.0 + inner_width, foreground="#ffffffb0")
            ],
            zorder=4,
            clip_on=False,
        )


def _draw_bands(axes: "Axes", pose: Array, frustum: Frustum) -> None:
    """Where one band of range ends and the next begins: circles, or lines across the heading."""
    from matplotlib.patches import Rectangle

    edges_deg = frustum.edges_deg(pose[2])
    azimuths_deg = np.linspace(edges_deg[0], edges_deg[-1], 361)
    ahead = np.stack(direction(azimuths_deg, np), axis=-1)
    # A pinhole camera's bands are bands of depth along its axis.
    depth = np.cos(np.radians(azimuths_deg - pose[2])) if frustum.projection == "pinhole" else 1.0
    for band_range in frustum.bands:
        border = pose[:2] + ahead * (band_range / np.broadcast_to(depth, len(ahead)))[:, None]
        (line,) = axes.plot(
            border[:, 0], border[:, 1], color=INK, linewidth=0.8, linestyle=(0, (4, 2)), zorder=4
        )
        line.set_clip_path(Rectangle((0.0, 0.0), 1.0, 1.0, transform=axes.transData))


def _draw_numbers(
    axes: "Axes", masks: Array, pose: Array, frustum: Frustum, colours: Array
) -> None:
    """Number the slices beside the part of the tile's border that they reach."""
    edges_deg = frustum.edges_deg(pose[2])
    figure = cast("Figure", axes.get_figure(root=True))
    inches = axes.get_position().width * figure.get_figwidth()
    tile_points = 72.0 * inches / (1.0 + 2.0 * MARGIN)
    room = (4.0 + 5.5 * len(str(frustum.slices - 1))) / tile_points
    placed: list[Array] = []
    for n in np.argsort(-masks.sum(axis=(1, 2)), kind="stable"):
        across = edge_ends(pose, np.linspace(edges_deg[n], edges_deg[n + 1], 65)[1:-1])
        seen = np.flatnonzero(np.linalg.norm(across - pose[:2], axis=1) > 1e-3)
        if len(seen) == 0:
            continue  # it looks out of the tile
        centre = 0.5 + (across[seen[len(seen) // 2]] - 0.5) * (1.0 + MARGIN)
        if any(np.linalg.norm(centre - other) < room for other in placed):
            continue
        placed.append(centre)
        axes.text(
            centre[0],
            centre[1],
            str(n),
            ha="center",
            va="center_baseline",
            fontsize=8.5,
            fontweight="bold",
            color=tuple(0.72 * colours[n]),
            zorder=5,
        )


def arrow_tip(pose: Pose, margin: float) -> Array:
    """Where the arrow along a camera's heading ends.

    Parameters
    ----------
    pose : array [3]
        u, v in [0, 1] of the aerial frame and heading_deg, clockwise from north.
    margin : float
        How far out of the tile, whose side is 1, the arrow may reach; it is cut short there.

    Returns
    -------
    tip : float64 [2]
        u, v in the aerial frame.

    Examples
    --------
    >>> arrow_tip((0.5, 0.5, 90.0), 0.05).tolist()
    [0.63, 0.5]
    >>> arrow_tip((1.0, 0.5, 90.0), 0.05).tolist()
    [1.05, 0.5]
    """
    camera = np.asarray(pose[:2], dtype=np.float64)
    framed = (camera + margin) / (1.0 + 2.0 * margin)
    ahead = (edge_ends((*framed, 0.0), pose[2]) - framed) * (1.0 + 2.0 * margin)
    return np.asarray(camera + ahead * min(1.0, _ARROW / math.hypot(*ahead)))


def _draw_camera(axes: "Axes", pose: Array) -> None:
    """The camera, and an arrow along its heading."""
    from matplotlib.patheffects import withStroke

    tip = arrow_tip(pose, MARGIN)  # clear of the axes
    arrow = axes.annotate(
        "",
        xy=(tip[0], tip[1]),
        xytext=(pose[0], pose[1]),
        annotation_clip=False,
        arrowprops={
            "arrowstyle": "-|>,head_width=0.32,head_length=0.6",
            "color": INK,
            "linewidth": 2.4,
            "shrinkA": 0,
            "shrinkB": 0,
        },
        zorder=6,
    )
    if arrow.arrow_patch is not None:
        arrow.arrow_patch.set_path_effects([withStroke(linewidth=4.6, foreground="white")])
    axes.plot(
        pose[0],
        pose[1],
        "o",
        markersize=8,
        markerfacecolor="white",
        markeredgecolor=INK,
        markeredgewidth=2.0,
        clip_on=False,
        zorder=7,
    )


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
