"""An answer drawn on its tile: the heat map by place, the modes, and the answer's ellipse."""

from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource
from numpy.typing import NDArray

from slicemask.app.pixels import pack
from slicemask.geometry.azimuths import direction
from slicematch.localization.estimate import Estimate
from slicematch.localization.modes import grid_steps
from slicematch.localization.probabilities import ellipse, ellipse_outline

_HEAT = (0.84, 0.12, 0.45)
_MODE, _TRUTH, _PRIOR = "#d6246e", "#12b886", "#ffd23f"
_ARROW = 0.07
_ARC_RADIUS = 0.25


class Overlays:
    """What is drawn of an answer on a figure in the aerial frame.

    Parameters
    ----------
    plot : bokeh.plotting.figure
        The figure.
    """

    def __init__(self, plot: Any) -> None:
        self._heat = ColumnDataSource({name: [] for name in ("image", "x", "y", "dw", "dh")})
        self._modes = ColumnDataSource({name: [] for name in ("x", "y", "x1", "y1", "text")})
        self._ellipse = ColumnDataSource({"x": [], "y": []})
        self._truth = ColumnDataSource({name: [] for name in ("x", "y", "x1", "y1")})
        self._heat_map = plot.image_rgba("image", "x", "y", "dw", "dh", source=self._heat)
        self._priors = ColumnDataSource({"x": [], "y": []})
        plot.line(
            "x", "y", source=self._priors, line_color=_PRIOR, line_width=3, line_dash="dashed"
        )
        plot.line("x", "y", source=self._ellipse, line_color="white", line_width=5)
        plot.line("x", "y", source=self._ellipse, line_color=_MODE, line_width=2)
        for source, colour in ((self._truth, _TRUTH), (self._modes, _MODE)):
            plot.segment("x", "y", "x1", "y1", source=source, line_color="white", line_width=6)
            plot.segment("x", "y", "x1", "y1", source=source, line_color=colour, line_width=3)
        plot.scatter(
            "x", "y", source=self._truth, marker="star", size=18, fill_color=_TRUTH,
            line_color="white",
        )  # fmt: skip
        plot.text(
            "x", "y", "text", source=self._modes, text_align="center", text_baseline="middle",
            text_color="white", text_font_size="13px", padding=4, border_radius=9,
            background_fill_color=_MODE,
        )  # fmt: skip

    def show(self, estimate: Estimate) -> None:
        """Show an answer."""
        likely = np.sqrt(estimate.place_map / estimate.place_map.max())
        heat = np.dstack([*(np.full_like(likely, part) for part in _HEAT), 0.8 * likely])
        grid = estimate.grid
        step_u, step_v, _ = (step or 1.0 for step in grid_steps(grid))
        self._heat.data = {
            "image": [pack(heat)],
            "x": [grid.u[0] - step_u / 2], "y": [grid.v[0] - step_v / 2],
            "dw": [step_u * len(grid.u)], "dh": [step_v * len(grid.v)],
        }  # fmt: skip
        poses = np.array([mode.pose for mode in estimate.modes])
        numbers = [str(number) for number in range(1, len(poses) + 1)]
        self._modes.data = {**_arrows(poses), "text": numbers}
        outline = _ellipse_points(estimate)
        self._ellipse.data = {"x": outline[:, 0], "y": outline[:, 1]}

    def show_heat(self, visible: bool) -> None:
        """Show the heat map, or hide it."""
        self._heat_map.visible = visible

    def show_priors(
        self,
        place: tuple[float, float, float] | None,
        heading: tuple[float, float] | None,
        camera: tuple[float, float],
    ) -> None:
        """Show priors as they were drawn: a circle, and an arc seen from the camera."""
        lines = [np.full((1, 2), np.nan)]
        if place is not None:
            lines += [_arc_points(place[:2], place[2], 0.0, 180.0), lines[0]]
        if heading is not None:
            middle = np.array([camera])
            lines += [middle, _arc_points(camera, _ARC_RADIUS, *heading), middle]
        drawn = np.concatenate(lines)
        self._priors.data = {"x": drawn[:, 0], "y": drawn[:, 1]}

    def show_truth(self, pose: tuple[float, float, float] | None) -> None:
        """Show the true pose, where it is known."""
        self._truth.data = _arrows(np.reshape([] if pose is None else pose, (-1, 3)))


def _arrows(poses: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    du, dv = direction(poses[:, 2], np)
    u, v = poses[:, 0], poses[:, 1]
    return {"x": u, "y": v, "x1": u + _ARROW * du, "y1": v + _ARROW * dv}


def _arc_points(
    middle: tuple[float, float], radius: float, centre_deg: float, half_width_deg: float
) -> NDArray[np.float64]:
    azimuths_deg = centre_deg + np.linspace(-half_width_deg, half_width_deg, 91)
    return np.asarray(middle + radius * np.stack(direction(azimuths_deg, np), axis=-1))


def _ellipse_points(estimate: Estimate) -> NDArray[np.float64]:
    """The ellipse that holds 95 % of the answer's mode, in the aerial frame, [points, 2]."""
    outline = ellipse_outline(*ellipse(estimate.covariance()[:2, :2]))
    return np.asarray(estimate.pose[:2] + outline * [1.0, -1.0])  # v grows to the south
