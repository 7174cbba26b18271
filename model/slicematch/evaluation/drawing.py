"""Pictures of estimates and of errors, as matplotlib figures (`slicemask.plot.save_figure`)."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from slicemask import Frustum, PoseGrid
from slicemask.plot import arrow_tip, edge_ends
from slicematch.evaluation.metrics import Floor, PoseErrors

_ESTIMATE, _TRUTH = "#e6007e", "#00b050"
_MARGIN = 0.04  # how far an arrow may reach out of the tile, whose side is 1


def draw_estimate(
    aerial: NDArray[np.uint8] | Image.Image,
    heat_map: ArrayLike,
    grid: PoseGrid,
    pose: ArrayLike,
    frustum: Frustum,
    truth: ArrayLike | None = None,
    ground: NDArray[np.uint8] | Image.Image | None = None,
    title: str = "",
) -> Figure:
    """The heat map over the tile, with the estimated pose, its slices and the truth.

    Parameters
    ----------
    aerial : uint8 [A, A, 3] or picture
        The tile.
    heat_map : float [rows, columns]
        Best score at each place; places that are not finite are left clear.
    grid : PoseGrid
        Where those places stand.
    pose : float [3]
        u, v, heading_deg of the estimate.
    frustum : Frustum
        Its slices.
    truth : float [3], optional
        The true pose.
    ground : uint8 [H, W, 3] or picture, optional
        The ground image, shown below and cut into the slices; its centre column looks where the
        arrows point.
    title : str
        A line above the picture.
    """
    if ground is None:
        figure = Figure(figsize=(6.4, 5.6), layout="constrained")
        axes = figure.add_subplot()
    else:
        pixels = np.asarray(ground)
        share = pixels.shape[0] / pixels.shape[1]
        figure = Figure(figsize=(6.4, 5.6 + 5.6 * share), layout="constrained")
        axes, below = figure.subplots(2, 1, height_ratios=(1, share))
        _draw_ground(below, pixels, frustum.slices)
    # In grey, so that all colour is the heat map's.
    axes.imshow(np.asarray(aerial).mean(axis=2), cmap="gray", extent=(0, 1, 1, 0))
    seen = np.ma.masked_invalid(np.asarray(heat_map, dtype=np.float64))
    colours = axes.imshow(
        seen, extent=_edges(grid), cmap="viridis", alpha=0.5, interpolation="nearest"
    )
    figure.colorbar(colours, ax=axes, label="score, best heading at each place", shrink=0.85)
    _draw_slices(axes, np.asarray(pose, dtype=np.float64), frustum)
    if truth is not None:
        _draw_camera(axes, np.asarray(truth, dtype=np.float64), _TRUTH, "truth")
    _draw_camera(axes, np.asarray(pose, dtype=np.float64), _ESTIMATE, "estimate")
    axes.set(xlim=(0, 1), ylim=(1, 0), xticks=[], yticks=[])
    # Below, where it hides no arrow.
    axes.legend(loc="upper left", bbox_to_anchor=(0, 0), ncols=2, frameon=False, borderaxespad=0.2)
    axes.set_title(title, fontsize="medium", wrap=True, pad=12)
    return figure


def draw_errors(errors: PoseErrors, floor: Floor) -> Figure:
    """Curves of the share of samples below each error, with what the candidates alone cost.

    Parameters
    ----------
    errors : PoseErrors
        Of n samples.
    floor : Floor
        Of the same samples.
    """
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    curves = (
        (panels[0], "metres", (("place", errors.place_m), ("lateral", errors.lateral_m),
                               ("longitudinal", errors.longitudinal_m)), floor.place_m),
        (panels[1], "degrees", (("heading", errors.heading_deg),), floor.heading_deg),
    )  # fmt: skip
    for axes, unit, named, least in curves:
        for name, values in named:
            _draw_curve(axes, values, label=name)
        _draw_curve(axes, least, label="floor of the grid", color="grey", linestyle="--")
        axes.set(xlabel=f"error, {unit}", xlim=(0, None), ylim=(0, 1))
        axes.grid(alpha=0.3)
        axes.legend(loc="lower right")
    panels[0].set_ylabel("share of samples")
    return figure


def _draw_curve(axes: Axes, values: NDArray[np.float64], **style: str) -> None:
    ordered = np.concatenate([[0.0], np.sort(values)])
    axes.step(ordered, np.arange(len(ordered)) / len(values), where="post", **style)


def _draw_ground(axes: Axes, ground: NDArray[np.uint8], slices: int) -> None:
    """The ground image between the slices' edges, with its centre column marked."""
    height, width = ground.shape[:2]
    axes.imshow(ground)
    for edge in np.arange(1, slices) * width / slices - 0.5:
        axes.axvline(edge, color="white", linewidth=0.8, alpha=0.8)
    axes.plot(width / 2 - 0.5, height - 1, "^", color=_ESTIMATE, markeredgecolor="white",
              markersize=9, clip_on=False)  # fmt: skip
    axes.set(xticks=[], yticks=[])


def _draw_slices(axes: Axes, pose: NDArray[np.float64], frustum: Frustum) -> None:
    """The slices' edges, from the camera to the edge of the tile."""
    for u, v in edge_ends(pose, frustum.edges_deg(pose[2])):
        axes.plot([pose[0], u], [pose[1], v], color="white", linewidth=0.8, alpha=0.8)


def _draw_camera(axes: Axes, pose: NDArray[np.float64], colour: str, label: str) -> None:
    u, v, _ = pose
    axes.annotate(
        "",
        xy=arrow_tip(pose, _MARGIN),
        xytext=(u, v),
        annotation_clip=False,
        arrowprops={
            "arrowstyle": "-|>", "color": colour, "linewidth": 2.2, "shrinkA": 0, "shrinkB": 0
        },
    )  # fmt: skip
    axes.plot(
        u, v, "o", color=colour, markeredgecolor="white", markersize=8, label=label, clip_on=False
    )


def _edges(grid: PoseGrid) -> tuple[float, float, float, float]:
    """Left, right, bottom and top of the picture in which each place fills one pixel."""
    u0, v0, u1, v1 = grid.extent
    if grid.places == "endpoints":
        # The outermost places stand on the extent's edges, so their pixels reach beyond it.
        du = (u1 - u0) / (2 * (grid.columns - 1)) if grid.columns > 1 else 0.0
        dv = (v1 - v0) / (2 * (grid.rows - 1)) if grid.rows > 1 else 0.0
        u0, v0, u1, v1 = u0 - du, v0 - dv, u1 + du, v1 + dv
    return u0, u1, v1, v0
