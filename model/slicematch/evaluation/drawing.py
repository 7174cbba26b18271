"""Pictures of estimates and of errors, as matplotlib figures (`slicemask.plot.save_figure`)."""

import math
import textwrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, ListedColormap
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.patheffects import withStroke
from matplotlib.textpath import TextPath
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from slicemask import Frustum, PoseGrid
from slicemask.plot import arrow_tip, edge_ends
from slicematch.evaluation.metrics import OracleError, PoseErrors
from slicematch.localization.estimate import Estimate
from slicematch.localization.modes import Mode
from slicematch.localization.probabilities import CONFIDENCE, ellipse

_ESTIMATE, _TRUTH, _OTHER, _INK = "#e6007e", "#00b050", "#7ad7f0", "#17212b"
_MARGIN = 0.04  # how far an arrow may reach out of the tile, whose side is 1
# The layout, in inches: the tile's side, what is left beside it, and the bar of colours.
_SIDE, _LEFT, _RIGHT, _BAR_GAP, _BAR_WIDTH = 5.4, 0.3, 1.2, 0.26, 0.16
_LINE, _LEGEND, _BOTTOM = 0.21, 0.5, 0.22
# Ground images higher than this share of their width are shown smaller.
_MOST_HEIGHT = 0.8
_MOST_COLUMNS = 100
_MOST_OPAQUE = 0.75  # of the heat map, through which the photograph is to be seen
# Other modes that are less likely are not drawn.
_LEAST_PROBABILITY = 0.005
_OUTLINE = [withStroke(linewidth=2.2, foreground="#00000090")]


def draw_estimate(
    aerial: NDArray[np.uint8] | Image.Image,
    heat_map: ArrayLike,
    grid: PoseGrid,
    pose: ArrayLike,
    frustum: Frustum,
    truth: ArrayLike | None = None,
    ground: NDArray[np.uint8] | Image.Image | None = None,
    title: str = "",
    estimate: Estimate | None = None,
    tile_metres: float | None = None,
    north_up: bool = True,
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
        The ground image, shown below, as wide as the tile, and cut into the slices; its centre
        column looks where the arrows point.
    title : str
        Lines above the picture; long ones are broken.
    estimate : Estimate, optional
        Adds score and probability, the ellipse that holds 95 % of the answer's probability, and
        the other modes.
    tile_metres : float, optional
        Side of the tile on the ground: adds a scale bar.
    north_up : bool
        Whether the tile's top is north: adds an arrow to the north.

    Returns
    -------
    figure : matplotlib.figure.Figure
        Bound to no window.
    """
    pose = np.asarray(pose, dtype=np.float64)
    rest = title.splitlines()[1:]
    if estimate is not None:
        rest.append(_certainty(estimate, tile_metres, north_up))
    first = title.splitlines()[:1]
    styled = [(part, 11.0, "bold") for line in first for part in _broken(line, 11.0, "bold")]
    styled += [(part, 9.0, "normal") for line in rest for part in _broken(line, 9.0, "normal")]
    pixels = None if ground is None else np.asarray(ground)
    below = 0.0
    if pixels is not None:
        below = 0.12 + _SIDE * min(pixels.shape[0] / pixels.shape[1], _MOST_HEIGHT)
    top = 0.28 + _LINE * len(styled)
    width, height = _LEFT + _SIDE + _RIGHT, top + _SIDE + _LEGEND + below + _BOTTOM
    figure = Figure(figsize=(width, height), facecolor="white")

    def place(left: float, bottom: float, wide: float, high: float) -> Axes:
        return figure.add_axes((left / width, bottom / height, wide / width, high / height))

    foot = _BOTTOM + below + _LEGEND
    axes = place(_LEFT, foot, _SIDE, _SIDE)
    axes.imshow(np.asarray(aerial), extent=(0, 1, 1, 0))
    seen = np.ma.masked_invalid(np.asarray(heat_map, dtype=np.float64))
    colours = axes.imshow(seen, extent=_edges(grid), cmap=_heat(), interpolation="nearest")
    bar = figure.colorbar(
        colours, cax=place(_LEFT + _SIDE + _BAR_GAP, foot + 0.1 * _SIDE, _BAR_WIDTH, 0.8 * _SIDE)
    )
    bar.set_label("score, best heading at each place", fontsize=9, color=_INK)
    bar.ax.tick_params(labelsize=8)
    _draw_slices(axes, pose, frustum)
    if estimate is not None:
        _draw_ellipse(axes, estimate)
        _draw_modes(axes, estimate.modes[1:])
    if truth is not None:
        _draw_camera(axes, np.asarray(truth, dtype=np.float64), _TRUTH, "truth")
    _draw_camera(axes, pose, _ESTIMATE, "estimate")
    # Beside the tile and below it, where they hide nothing.
    if tile_metres is not None:
        _draw_scale(axes, tile_metres)
    if north_up:
        _draw_north(axes)
    axes.set(xlim=(0, 1), ylim=(1, 0), xticks=[], yticks=[])
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(
        handles[::-1], labels[::-1],  # the estimate, which is drawn last, comes first
        loc="upper left", bbox_to_anchor=(0, -0.052), ncols=4, frameon=False, fontsize=9,
        borderaxespad=0.0, borderpad=0.0, handletextpad=0.3, columnspacing=0.9,
    )  # fmt: skip
    for number, (text, size, weight) in enumerate(styled):
        figure.text(
            _LEFT / width, 1.0 - (0.24 + _LINE * number) / height, text, parse_math=False,
            fontsize=size, fontweight=weight, color=_INK, va="center",
        )  # fmt: skip
    if pixels is not None:
        _draw_ground(place(_LEFT, _BOTTOM, _SIDE, below - 0.12), pixels, frustum)
    return figure


def draw_errors(errors: PoseErrors, oracle: OracleError) -> Figure:
    """Curves of the share of samples below each error, with what the candidates alone cost.

    Parameters
    ----------
    errors : PoseErrors
        Of n samples.
    oracle : OracleError
        Of the same samples.

    Returns
    -------
    figure : matplotlib.figure.Figure
        Bound to no window.
    """
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    curves = (
        (panels[0], "metres", (("place", errors.place_m), ("lateral", errors.lateral_m),
                               ("longitudinal", errors.longitudinal_m)), oracle.place_m),
        (panels[1], "degrees", (("heading", errors.heading_deg),), oracle.heading_deg),
    )  # fmt: skip
    for axes, unit, named, least in curves:
        for name, values in named:
            _draw_curve(axes, values, label=name)
        _draw_curve(axes, least, label="oracle among the candidates", color="grey", linestyle="--")
        axes.set(xlabel=f"error, {unit}", xlim=(0, None), ylim=(0, 1))
        axes.grid(alpha=0.3)
        axes.legend(loc="lower right")
    panels[0].set_ylabel("share of samples")
    return figure


def _certainty(estimate: Estimate, tile_metres: float | None, north_up: bool) -> str:
    """Score and probability of the answer, and how far it may be off."""
    text = f"score {estimate.score:.3f}, probability {estimate.modes[0].probability:.1%}"
    east, north, heading = np.sqrt(estimate.covariance().diagonal()).tolist()
    if tile_metres is not None:
        across, along = ("east", "north") if north_up else ("right", "up")
        text += (
            f", deviation {east * tile_metres:.1f} m {across}, {north * tile_metres:.1f} m {along}"
        )
        text += f", {heading:.1f}°"
    return text


def _broken(line: str, size: float, weight: str) -> list[str]:
    """A line of text broken so that each part fits above the tile and the bar of colours."""
    font = FontProperties(size=size, weight=weight)
    room = 72.0 * (_SIDE + _RIGHT - 0.3)
    for columns in range(_MOST_COLUMNS, 0, -4):
        parts = textwrap.wrap(line, columns)
        # A dollar sign would begin a formula.
        widths = [TextPath((0, 0), part.replace("$", "S"), prop=font) for part in parts]
        if all(path.get_extents().x1 <= room for path in widths):
            break
    return parts


def _heat() -> Colormap:
    """Colours that let the photograph through where the score is low."""
    from matplotlib import colormaps

    colours = colormaps["plasma"](np.linspace(0.0, 1.0, 256))
    # The square, so that only the best places cover what they stand for.
    colours[:, 3] = _MOST_OPAQUE * np.linspace(0.0, 1.0, 256) ** 2
    return ListedColormap(colours)


def _draw_curve(axes: Axes, values: NDArray[np.float64], **style: Any) -> None:
    ordered = np.concatenate([[0.0], np.sort(values)])
    axes.step(ordered, np.arange(len(ordered)) / len(values), where="post", **style)


def _draw_ground(axes: Axes, ground: NDArray[np.uint8], frustum: Frustum) -> None:
    """The ground image between the slices' edges, with the column of its heading marked."""
    height, width = ground.shape[:2]
    axes.imshow(ground)
    axes.set_anchor("W")
    for edge in np.arange(1, frustum.slices) * width / frustum.slices - 0.5:
        axes.axvline(edge, color="white", linewidth=0.8, alpha=0.8)
    axis = frustum.principal_point * width - 0.5
    axes.plot(axis, height - 1, "^", color=_ESTIMATE, markeredgecolor="white",
              markersize=9, clip_on=False)  # fmt: skip
    axes.set(xticks=[], yticks=[])


def _draw_slices(axes: Axes, pose: NDArray[np.float64], frustum: Frustum) -> None:
    """The slices' edges, from the camera to the edge of the tile."""
    if frustum.slices == 1 and frustum.hfov_deg == 360.0:
        return  # one slice all around has no edge to show
    for u, v in edge_ends(pose, frustum.edges_deg(pose[2])):
        if math.hypot(u - pose[0], v - pose[1]) > 1e-6:  # or it leaves the tile at once
            axes.plot(
                [pose[0], u], [pose[1], v], color="white", linewidth=0.9, alpha=0.85,
                path_effects=[withStroke(linewidth=1.8, foreground="#00000060")],
            )  # fmt: skip


def _draw_ellipse(axes: Axes, estimate: Estimate) -> None:
    """The ellipse around the answer's place that holds the confidence, cut at the tile's edge."""
    major, minor, azimuth_deg = ellipse(estimate.covariance()[:2, :2])
    angle, azimuth = np.linspace(0.0, 2.0 * np.pi, 181), math.radians(azimuth_deg)
    along, across = major * np.cos(angle), minor * np.sin(angle)
    u = estimate.pose[0] + along * math.sin(azimuth) + across * math.cos(azimuth)
    v = estimate.pose[1] - along * math.cos(azimuth) + across * math.sin(azimuth)
    axes.plot(
        u, v, color=_ESTIMATE, linewidth=1.4, linestyle=(0, (4, 2)),
        label=f"{CONFIDENCE:.0%} ellipse",
    )  # fmt: skip


def _draw_modes(axes: Axes, modes: tuple[Mode, ...]) -> None:
    """The other modes, each with its probability where there is room for it."""
    written: list[NDArray[np.float64]] = []
    label: str | None = "other modes"
    for mode in modes:
        if mode.probability < _LEAST_PROBABILITY:
            continue
        _draw_camera(axes, mode.pose, _OTHER, label, small=True)
        label = None
        place = mode.pose[:2]
        if all(np.abs(place - other).max() > 0.06 for other in written):
            axes.annotate(
                f"{mode.probability:.0%}", (place[0], place[1]), (6, 5), textcoords="offset points",
                fontsize=8, color="white", path_effects=_OUTLINE,
            )  # fmt: skip
            written.append(place)


def _draw_camera(
    axes: Axes, pose: NDArray[np.float64], colour: str, label: str | None, small: bool = False
) -> None:
    u, v, _ = pose
    tip = arrow_tip(pose, _MARGIN)
    axes.annotate(
        "",
        xy=(tip[0], tip[1]),
        xytext=(u, v),
        annotation_clip=False,
        arrowprops={
            "arrowstyle": "-|>", "color": colour, "linewidth": 1.2 if small else 2.2,
            "shrinkA": 0, "shrinkB": 0,
        },
    )  # fmt: skip
    style: dict[str, Any] = {"markersize": 5 if small else 8, "clip_on": False}
    axes.plot(u, v, "o", color=colour, markeredgecolor="white", label=label, **style)


def _draw_scale(axes: Axes, tile_metres: float) -> None:
    """A bar of a round length, at most a sixth of the tile, beside the legend."""
    power = 10.0 ** math.floor(math.log10(tile_metres / 6.0))
    length = max(step * power for step in (1, 2, 5) if step * power <= tile_metres / 6.0)
    u0, v = 1.0 - length / tile_metres, 1.072
    axes.plot([u0, 1.0], [v, v], color=_INK, linewidth=2, solid_capstyle="butt", clip_on=False)
    axes.text(u0 - 0.012, v, f"{length:g} m", color=_INK, ha="right", va="center", fontsize=9)


def _draw_north(axes: Axes) -> None:
    """An arrow to the north, above the bar of colours."""
    u = 1.0 + (_BAR_GAP + _BAR_WIDTH / 2.0) / _SIDE
    axes.annotate(
        "N", xy=(u, 0.0), xytext=(u, 0.075), ha="center", va="center", fontsize=9,
        fontweight="bold", color=_INK, annotation_clip=False,
        arrowprops={"arrowstyle": "-|>", "color": _INK, "linewidth": 1.4, "shrinkA": 1},
    )  # fmt: skip


def _edges(grid: PoseGrid) -> tuple[float, float, float, float]:
    """Left, right, bottom and top of the picture in which each place fills one pixel."""
    u0, v0, u1, v1 = grid.extent
    if grid.places == "endpoints":
        # The outermost places stand on the extent's edges, so their pixels reach beyond it.
        du = (u1 - u0) / (2 * (grid.columns - 1)) if grid.columns > 1 else 0.0
        dv = (v1 - v0) / (2 * (grid.rows - 1)) if grid.rows > 1 else 0.0
        u0, v0, u1, v1 = u0 - du, v0 - dv, u1 + du, v1 + dv
    return u0, u1, v1, v0
