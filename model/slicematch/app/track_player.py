"""The page that plays a track back on its map, frame by frame with the belief."""

from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import panel as pn
from bokeh.events import DocumentReady
from bokeh.models import ColumnDataSource, CustomJS, Range1d, Span
from bokeh.plotting import figure
from numpy.typing import NDArray
from PIL import Image

from slicemask.app.locks import when_locked
from slicemask.app.page import page
from slicemask.app.pixels import picture_pixels
from slicematch.data.errors import PlaceError
from slicematch.data.maps import AerialMap
from slicematch.localization.geodesy import offset_m
from slicematch.localization.probabilities import ellipse_outline
from slicematch.tracking.recorded import RecordedTrack
from slicematch.tracking.track_estimate import SURE

Floats = NDArray[np.float64]

_TRACK, _BELIEF, _DOUBT = "#ff3fd0", "#ffffff", "#ffd23f"
_PIXELS, _MARGIN_M = 1400, 30.0
_NEAR_M = 40.0  # to each side of the camera, where the view follows it
_ARROW_M = 8.0
_LEAST_MS = 40  # browsers do not keep up with more frames
_LABEL = """
function find() {
  const el = Bokeh.index.find_one(plot)?.el
  if (!el?.isConnected) return setTimeout(find, 50)
  el.setAttribute("role", "img")
  el.setAttribute("aria-label", label)
  el.dataset.ready = "true"
}
find()
"""


def player_pages(track: str | Path, aerial_map: str | Path) -> Callable[[], Any]:
    """The function that makes a page on a track for each session.

    Parameters
    ----------
    track : path
        A ``.csv`` that `slicematch.tracking.track.track` wrote.
    aerial_map : path
        A georeferenced raster.

    Raises
    ------
    DatasetError, MapError, PlaceError
        If the track or the map cannot be read, or the map does not show where the track is.
    """
    recorded = RecordedTrack.read(track)
    opened = AerialMap.open(aerial_map)
    low, high = (
        (end(recorded.lat), end(recorded.lon)) for end in (lambda x: x.min(), lambda x: x.max())
    )
    centre = float((low[0] + high[0]) / 2), float((low[1] + high[1]) / 2)
    points = zip(recorded.lat.tolist(), recorded.lon.tolist(), strict=True)
    places = np.array([offset_m(centre, point) for point in points])
    half_m = float(np.abs(places).max()) + _MARGIN_M
    try:
        tile = opened.cut(*centre, 2 * half_m, _PIXELS, max_padded=0.999)
    except PlaceError as error:
        raise PlaceError(
            f"{track}: lies off the map {aerial_map} ({error}); name its own"
        ) from None
    ground = Image.fromarray(tile.image)
    return lambda: TrackPlayer(recorded, places, ground, half_m).page()


class TrackPlayer:
    """One session of the page.

    Parameters
    ----------
    track : RecordedTrack
    places : float64 [T, 2]
        Metres east and north of the middle of the map's picture.
    ground : image
        The map, north up.
    half_m : float
        Half of its side.
    """

    def __init__(
        self, track: RecordedTrack, places: Floats, ground: Image.Image, half_m: float
    ) -> None:
        self.track, self.places, self._half_m = track, places, half_m
        self._way = ColumnDataSource({"x": [], "y": []})
        self._ellipse = ColumnDataSource({"x": [], "y": []})
        self._camera = ColumnDataSource({name: [] for name in ("x", "y", "x1", "y1", "colour")})
        self.plot = self._map(ground)
        self._now = Span(location=0.0, dimension="height", line_color="#d9480f", line_width=2)
        self.chart = self._chart()
        self.said = pn.pane.HTML(sizing_mode="stretch_width", min_height=120)
        self.player = pn.widgets.Player(
            name="Frame", start=0, end=len(places) - 1, value=0, step=1, loop_policy="once",
            interval=self._pause_ms(), sizing_mode="stretch_width", show_value=False,
            show_loop_controls=False,
        )  # fmt: skip
        self.follows = pn.widgets.Checkbox(name="Follow the camera", value=False)
        self.player.param.watch(lambda event: when_locked(self._show), "value")
        self.follows.param.watch(lambda event: when_locked(self._show), "value")
        self._show()

    def page(self) -> Any:
        """The page of this session."""
        names = {"plot": self.plot, "label": "Map with the track, the camera and its ellipse"}
        pn.state.curdoc.js_on_event(DocumentReady, CustomJS(args=names, code=_LABEL))
        stretch: dict[str, Any] = {"sizing_mode": "stretch_width"}
        return page(
            pn.Column(self.plot, **stretch),
            pn.Column(self.player, self.follows, self.said, self.chart, **stretch),
            subtitle="Where the camera went: a track on its map, with what was believed.",
            left_label="Map with the track", right_label="Playback",
        )  # fmt: skip

    def _pause_ms(self) -> int:
        """As long as between frames."""
        steps = np.diff(self.track.time_s)
        usual_s = float(np.median(steps)) if len(steps) else 1.0
        return max(_LEAST_MS, round(1e3 * usual_s)) if usual_s > 0 else 100

    def _map(self, ground: Image.Image) -> Any:
        half = self._half_m
        plot = figure(
            x_range=Range1d(-half, half), y_range=Range1d(-half, half),
            tools="pan,wheel_zoom,reset", sizing_mode="scale_width", aspect_ratio=1, min_border=0,
            outline_line_color=None,
        )  # fmt: skip
        plot.toolbar.logo = None
        plot.axis.visible = False
        plot.grid.visible = False
        pixels = np.flipud(picture_pixels(ground, _PIXELS))  # Bokeh's rows go up
        plot.image_rgba([pixels], -half, -half, 2 * half, 2 * half)
        whole = dict(zip("xy", self.places.T, strict=True))
        plot.line(**whole, line_color=_TRACK, line_width=2, line_alpha=0.45)
        for colour, width in (("#00000080", 5), (_TRACK, 2.5)):
            plot.line("x", "y", source=self._way, line_color=colour, line_width=width)
        plot.patch(
            "x", "y", source=self._ellipse, fill_color=_BELIEF, fill_alpha=0.25,
            line_color=_BELIEF, line_width=2,
        )  # fmt: skip
        plot.segment("x", "y", "x1", "y1", source=self._camera, line_color="#17212b", line_width=6)
        plot.segment("x", "y", "x1", "y1", source=self._camera, line_color="colour", line_width=3)
        plot.scatter(
            "x", "y", source=self._camera, size=12, fill_color="colour", line_color="#17212b"
        )
        return plot

    def _chart(self) -> Any:
        chart = figure(
            height=170, sizing_mode="stretch_width", tools="", toolbar_location=None,
            x_axis_label="time (s)", y_axis_label="ellipse (m)", background_fill_color="white",
        )  # fmt: skip
        times = self.track.time_s - self.track.time_s[0]
        chart.line(times, self.track.ellipse_major_m, line_color="#1c6ea4", line_width=2)
        chart.add_layout(self._now)
        return chart

    def _show(self) -> None:
        """Show the frame that the player is at."""
        track, number = self.track, int(self.player.value)
        east, north = (float(value) for value in self.places[number])
        self._way.data = dict(zip("xy", self.places[: number + 1].T, strict=True))
        angle = np.radians(track.heading_deg[number])
        self._camera.data = {
            "x": [east], "x1": [east + _ARROW_M * np.sin(angle)],
            "y": [north], "y1": [north + _ARROW_M * np.cos(angle)],
            "colour": [_TRACK if track.probability[number] > SURE else _DOUBT],
        }  # fmt: skip
        outline = self.places[number] + ellipse_outline(
            track.ellipse_major_m[number],
            track.ellipse_minor_m[number],
            track.ellipse_azimuth_deg[number],
        )
        self._ellipse.data = dict(zip("xy", outline.T, strict=True))
        near = self._half_m if not self.follows.value else min(_NEAR_M, self._half_m)
        middle = (east, north) if self.follows.value else (0.0, 0.0)
        for span, value in zip((self.plot.x_range, self.plot.y_range), middle, strict=True):
            if not self.follows.value and span.end - span.start == 2 * near:
                continue  # a view that was moved by hand stays
            span.update(start=value - near, end=value + near)
        self._now.location = time_s = float(track.time_s[number] - track.time_s[0])
        notes = f"<br>{escape(track.notes[number])}" if track.notes[number] else ""
        self.said.object = (
            f"<b>Frame {number + 1} of {len(self.places)}, {time_s:.2f} s:</b> latitude "
            f"{track.lat[number]:.7f}, longitude {track.lon[number]:.7f}, heading "
            f"{track.heading_deg[number]:.1f} degrees; 95 % within "
            f"{track.ellipse_major_m[number]:.1f} m by {track.ellipse_minor_m[number]:.1f} m, if "
            f"this is the right place, which it is with {track.probability[number]:.0%}.{notes}"
        )
