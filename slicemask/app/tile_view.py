"""A tile with a camera on it that is dragged and turned, as a Bokeh figure."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.events import DocumentReady
from bokeh.models import ColumnDataSource, CustomJS, Div, Range1d
from bokeh.plotting import figure
from numpy.typing import NDArray
from PIL import Image

from slicemask.app.outline import outline
from slicemask.app.pixels import picture_pixels
from slicemask.geometry.azimuths import direction
from slicemask.geometry.frustum import Frustum

_SCRIPT = Path(__file__).with_name("camera.js")
# The heading's arrow, as a fraction of the tile's side; its tip is the grip that turns.
_REACH = 0.13
_MOST_PIXELS = 768
_INK, _GRIP = "#17212b", "#ffd23f"
_FOCUS = ":host(:focus-visible) { outline: 3px solid #e8590c; outline-offset: 2px; }"
# Poses are rounded to what the page shows, so that what is copied is what was seen.
_PLACE_DIGITS, _HEADING_DIGITS = 4, 2

Pose = tuple[float, float, float]
Pointer = tuple[float, float] | None


class TileView:
    """A tile with a camera that the user moves.

    Parameters
    ----------
    on_move : callable
        Called with the pose (u, v, heading_deg) and the pointer's place (u, v) or None, whenever
        either has changed; shows what belongs to them (`show_masks`, `show_outline`).
    label : str
        What the view is, for screen readers.
    on_stroke : callable, optional
        Called with (u, v) of where a stroke began and ended, in the modes that draw.

    Attributes
    ----------
    plot : bokeh.plotting.figure
        In the aerial frame; more may be drawn on it.
    pose : (u, v, heading_deg)
        Where the camera is.
    """

    def __init__(
        self,
        on_move: Callable[[Pose, Pointer], None],
        label: str,
        on_stroke: Callable[[tuple[float, float], tuple[float, float]], None] | None = None,
    ) -> None:
        self.pose: Pose = (0.5, 0.5, 0.0)
        self._on_move, self._on_stroke = on_move, on_stroke
        self.plot = figure(
            x_range=Range1d(0, 1), y_range=Range1d(1, 0), tools="", toolbar_location=None,
            sizing_mode="scale_width", aspect_ratio=1, min_border=0, outline_line_color=None,
            background_fill_color=None, border_fill_color=None, stylesheets=[_FOCUS],
        )  # fmt: skip
        self.plot.axis.visible = False
        self.plot.grid.visible = False
        self._tile, self._masks = self._image(np.zeros((1, 1), "<u4")), self._image(None)
        self._lines = ColumnDataSource(dict.fromkeys("xy", ()))
        self._numbers = ColumnDataSource({"x": (), "y": (), "text": ()})
        self._camera = ColumnDataSource(self._camera_data())
        self._stroke = ColumnDataSource(_no_stroke(0))
        self._request, self._reply = ColumnDataSource({}), ColumnDataSource({"number": [0]})
        self._mode = Div(text="camera", visible=False)
        # The document knows what its roots refer to; what only the script refers to it does not.
        self.plot.tags = [self._request, self._reply, self._mode]
        self._draw()
        self._request.on_change("data", self._asked)
        self._stroke.on_change("data", self._stroked)
        self._label = label

    def connect(self, document: Any) -> None:
        """Install what moves the camera in the browser, once the document is there."""
        names = {
            "plot": self.plot, "camera": self._camera, "request": self._request,
            "reply": self._reply, "stroke": self._stroke, "mode": self._mode,
            "reach": _REACH, "label": self._label,
        }  # fmt: skip
        script = CustomJS(args=names, code=_SCRIPT.read_text(encoding="utf-8"))
        document.js_on_event(DocumentReady, script)

    def show_tile(self, tile: Image.Image) -> None:
        """Show another tile, square, north up."""
        self._tile.data = self._image_data(picture_pixels(tile, _MOST_PIXELS))

    def show_masks(self, pixels: NDArray[np.uint32]) -> None:
        """Show cells, uint32 [L, L], over the tile."""
        self._masks.data = self._image_data(pixels)

    def show_outline(self, frustum: Frustum) -> None:
        """Show the edges of the slices and bands of the camera where it is."""
        found = outline(np.array(self.pose), frustum)
        self._lines.data = {"x": found.lines[:, 0], "y": found.lines[:, 1]}
        self._numbers.data = {
            "x": found.places[:, 0], "y": found.places[:, 1], "text": found.numbers
        }  # fmt: skip

    def move_to(self, pose: Pose) -> None:
        """Put the camera somewhere, and show what it sees from there."""
        self.pose = _rounded(pose)
        self._camera.data = self._camera_data()
        self._on_move(self.pose, None)

    def set_mode(self, mode: str) -> None:
        """What dragging does: "camera" moves it; "circle" and "arc" draw."""
        self._mode.text = mode

    def image_source(self) -> ColumnDataSource:
        """Another image on the tile, above what is drawn so far; see `set_image`."""
        return self._image(None)

    def set_image(self, source: ColumnDataSource, pixels: NDArray[np.uint32]) -> None:
        """Show pixels, uint32, all over the tile."""
        source.data = self._image_data(pixels)

    def _asked(self, attribute: str, old: Any, new: dict[str, list[Any]]) -> None:
        values = [new[name][0] for name in ("u", "v", "heading")]
        if all(isinstance(value, int | float) and math.isfinite(value) for value in values):
            u, v, heading_deg = values
            self.pose = _rounded((min(max(u, 0.0), 1.0), min(max(v, 0.0), 1.0), heading_deg))
            pointed = (new["pointer_u"][0], new["pointer_v"][0])
            try:
                self._on_move(self.pose, None if None in pointed else pointed)
            finally:  # the browser waits for it, whatever became of the rest
                self._reply.data = {"number": new["number"]}

    def _stroked(self, attribute: str, old: Any, new: dict[str, list[Any]]) -> None:
        ends = [new[name][0] for name in ("x0", "y0", "x1", "y1")]
        if not all(isinstance(value, int | float) and math.isfinite(value) for value in ends):
            return
        self._stroke.data = _no_stroke(new["number"][0])
        if self._on_stroke is not None:
            self._on_stroke((ends[0], ends[1]), (ends[2], ends[3]))

    def _camera_data(self) -> dict[str, list[float]]:
        u, v, heading_deg = self.pose
        du, dv = (float(part) for part in direction(np.float64(heading_deg), np))
        # The browser moves the camera without telling this side's copy. The counter makes each
        # answer another one, which is sent even if it equals the last one of this side.
        self._moves = getattr(self, "_moves", 0) + 1
        return {
            "x": [u], "y": [v], "heading": [heading_deg],
            "tip_x": [u + _REACH * du], "tip_y": [v + _REACH * dv], "moves": [self._moves],
        }  # fmt: skip

    def _image(self, pixels: NDArray[np.uint32] | None) -> ColumnDataSource:
        empty = np.zeros((1, 1), "<u4") if pixels is None else pixels
        source = ColumnDataSource(self._image_data(empty))
        self.plot.image_rgba("image", "x", "y", 1, 1, source=source)
        return source

    @staticmethod
    def _image_data(pixels: NDArray[np.uint32]) -> dict[str, list[Any]]:
        return {"image": [pixels], "x": [0.0], "y": [0.0]}

    def _draw(self) -> None:
        for colour, width, alpha in (("white", 3.0, 0.55), (_INK, 1.2, 1.0)):
            self.plot.line(
                "x",
                "y",
                source=self._lines,
                line_color=colour,
                line_width=width,
                line_alpha=alpha,
                level="annotation",
            )
        self.plot.text(
            "x", "y", "text", source=self._numbers, text_align="center", text_baseline="middle",
            text_color=_INK, text_font_size="13px", padding=3, border_radius=4,
            background_fill_color="white", background_fill_alpha=0.75, level="annotation",
        )  # fmt: skip
        tip = {"x0": "x", "y0": "y", "x1": "tip_x", "y1": "tip_y", "source": self._camera}
        tip |= {"level": "overlay"}  # above whatever else is drawn
        self.plot.segment(**tip, line_color="white", line_width=6)
        self.plot.segment(**tip, line_color=_INK, line_width=3)
        style = {"source": self._camera, "line_color": _INK, "line_width": 2, "level": "overlay"}
        self.plot.scatter("tip_x", "tip_y", size=15, fill_color=_GRIP, **style)
        self.plot.scatter("x", "y", size=18, fill_color="white", **style)
        drawn = {"source": self._stroke, "line_color": _GRIP, "line_width": 3, "level": "overlay"}
        self.plot.circle("x0", "y0", radius="radius", fill_alpha=0.15, fill_color=_GRIP, **drawn)
        self.plot.segment("x0", "y0", "x1", "y1", line_dash="dashed", **drawn)


def _no_stroke(number: int) -> dict[str, list[Any]]:
    ends: dict[str, list[Any]] = {name: [None] for name in ("x0", "y0", "x1", "y1")}
    return ends | {"radius": [0.0], "number": [number]}


def _rounded(pose: Pose) -> Pose:
    u, v, heading_deg = pose
    heading_deg = round(heading_deg % 360.0, _HEADING_DIGITS) % 360.0
    return round(u, _PLACE_DIGITS), round(v, _PLACE_DIGITS), heading_deg
