"""What is drawn over a tile: its frame, the camera, and the edges, bands and numbers of slices."""

from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from slicemask.geometry.azimuths import direction
from slicemask.geometry.frustum import Frustum
from slicemask.plot.colours import FRAME, INK, MUTED
from slicemask.plot.outlines import arrow_tip, edge_ends

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

# Room around the tile for slice numbers, as a fraction of its side.
MARGIN = 0.075


def draw_frame(axes: "Axes") -> None:
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


def draw_edges(axes: "Axes", pose: Array, frustum: Frustum) -> None:
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


def draw_bands(axes: "Axes", pose: Array, frustum: Frustum) -> None:
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


def draw_numbers(axes: "Axes", masks: Array, pose: Array, frustum: Frustum, colours: Array) -> None:
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


def draw_camera(axes: "Axes", pose: Array) -> None:
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
