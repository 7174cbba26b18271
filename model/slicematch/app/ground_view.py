"""A ground image cut as the run cuts it, with what each part adds to a score."""

import math
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, HoverTool, Range1d
from bokeh.plotting import figure
from numpy.typing import NDArray
from PIL import Image

from slicemask.app.pixels import picture_pixels
from slicematch.data.elevations import image_elevations
from slicematch.runs.config import TrainConfig

_INK, _ANSWER = "#17212b", "#d6246e"
_MOST_PIXELS = 1024
_OPACITY = 0.6
# Blue for what speaks for a pose, orange for what speaks against it; told apart by colour-blind
# eyes, too (ColorBrewer's PuOr and RdBu).
FOR, AGAINST = np.array([33, 102, 172]) / 255.0, np.array([217, 95, 2]) / 255.0


def contribution_colours(values: NDArray[Any], largest: float) -> NDArray[np.float64]:
    """Colours of contributions, float64 [N, B, 4]; the opacity tells how large they are."""
    shares = np.clip(values / max(largest, 1e-9), -1.0, 1.0)
    colours = np.where((shares >= 0)[..., None], FOR, AGAINST)
    return np.concatenate([colours, np.abs(shares)[..., None]], axis=-1)


class GroundView:
    """A ground image, its slices side by side and its bands above each other, and bars below.

    Parameters
    ----------
    config : TrainConfig
        Of the run.
    dark : bool
        Whether the page is.
    """

    def __init__(self, config: TrainConfig, dark: bool = False) -> None:
        self._slices, self._heights = config.slices, band_heights(config)
        ink = "#e8ecef" if dark else _INK
        across = Range1d(0, self._slices)
        common: dict[str, Any] = {
            "x_range": across, "toolbar_location": None, "sizing_mode": "stretch_width",
            "background_fill_color": None, "border_fill_color": None, "min_border_left": 46,
            "min_border_right": 8, "outline_line_color": None,
        }  # fmt: skip
        self.picture = figure(height=230, y_range=Range1d(0, 1), tools="", **common)
        self.picture.axis.visible = False
        self.picture.grid.visible = False
        self._image = ColumnDataSource({"image": []})
        self.picture.image_rgba(
            "image", 0, 0, self._slices, 1, source=self._image, origin="top_left"
        )
        self._parts = ColumnDataSource({name: [] for name in _PART_COLUMNS})
        parts = self.picture.quad(
            "left", "right", "top", "bottom", source=self._parts, fill_color="colour",
            fill_alpha="alpha", line_color="white", line_alpha=0.5,
        )  # fmt: skip
        self.picture.add_tools(
            HoverTool(
                renderers=[parts],
                tooltips=[("slice", "@n"), ("band", "@b"), ("adds", "@value{0.0000}")],
            )
        )
        self.bars = figure(
            height=170, y_range=Range1d(0, 0.1), tools="", x_axis_label="slice n", **common
        )
        self.bars.xgrid.visible = False
        self.bars.yaxis.axis_label = "added to the score"
        for axis in self.bars.axis:
            axis.update(
                axis_label_text_color=ink, major_label_text_color=ink, axis_line_color=ink,
                major_tick_line_color=ink, minor_tick_line_color=None,
            )  # fmt: skip
        self.bars.ygrid.grid_line_alpha = 0.3
        self._sums = ColumnDataSource({name: [] for name in ("x", "value", "answer", "colour")})
        shown = self.bars.vbar("x", 0.8, "value", source=self._sums, fill_color="colour",
                               line_color=None)  # fmt: skip
        self.bars.scatter(
            "x", "answer", source=self._sums, marker="dash", size=16, line_width=3,
            line_color=_ANSWER,
        )  # fmt: skip
        self.bars.add_tools(
            HoverTool(
                renderers=[shown],
                tooltips=[("candidate", "@value{0.0000}"), ("answer", "@answer{0.0000}")],
            )
        )

    def show_image(self, ground: Image.Image) -> None:
        """Show a ground image, cut to the elevations that the run looks at."""
        self._image.data = {"image": [picture_pixels(ground, _MOST_PIXELS)]}

    def show(
        self, candidate: NDArray[Any], answer: NDArray[Any], shown: NDArray[Any], largest: float
    ) -> None:
        """Show contributions.

        Parameters
        ----------
        candidate, answer : float [N, B]
            Of the candidate's score and the answer's, for the bars.
        shown : float [N, B]
            What the parts of the image are coloured by.
        largest : float
            What is shown in full colour.
        """
        n, b = (axis.ravel() for axis in np.indices(shown.shape))
        colours = contribution_colours(shown, largest).reshape(-1, 4)
        self._parts.data = {
            "left": n, "right": n + 1, "top": self._heights[b + 1], "bottom": self._heights[b],
            "colour": _hex(colours), "alpha": _OPACITY * colours[:, 3],
            "n": n, "b": b, "value": shown.ravel(),
        }  # fmt: skip
        sums = candidate.sum(axis=1)
        ends = np.concatenate([sums, answer.sum(axis=1), [0.0]])
        self.bars.y_range.update(start=1.1 * ends.min(), end=1.1 * ends.max())
        bars = contribution_colours(sums[:, None], 1.0).reshape(-1, 4)
        self._sums.data = {
            "x": np.arange(self._slices) + 0.5, "value": sums, "answer": answer.sum(axis=1),
            "colour": _hex(bars),
        }  # fmt: skip


_PART_COLUMNS = ("left", "right", "top", "bottom", "colour", "alpha", "n", "b", "value")


def _hex(colours: NDArray[np.float64]) -> list[str]:
    return ["#{:02x}{:02x}{:02x}".format(*row) for row in np.rint(colours[:, :3] * 255).astype(int)]


def band_heights(config: TrainConfig) -> NDArray[np.float64]:
    """Where the bands of a run's ground images meet, float64 [B + 1], 0 the bottom and 1 the top.

    On flat ground; where the run learnt which rows a band looks at, they are where it began.
    """
    frustum = config.frustum()
    low, high = config.elevations or image_elevations(
        frustum.projection, frustum.hfov_deg, config.ground_aspect or 2.0
    )
    ranges_m = config.band_ranges_m() if config.bands else ()
    height_m = config.camera_height_m or 0.0  # known where there are bands
    ends_deg = [-math.degrees(math.atan2(height_m, far)) for far in ranges_m]
    if frustum.projection == "pinhole":
        low, high = (math.tan(math.radians(angle)) for angle in (low, high))
        ends_deg = [math.tan(math.radians(angle)) for angle in ends_deg]
    inner = [(end - low) / (high - low) for end in ends_deg]
    return np.clip(np.array([0.0, *inner, 1.0]), 0.0, 1.0)
