"""Priors that are drawn on a tile: a circle for the place, an arc for the heading."""

import math
from collections.abc import Callable
from typing import Any

import panel as pn

from slicemask.app.style import CHOICE, OUTLINED

_MODES = {"move the candidate": "camera", "draw a circle": "circle", "draw an arc": "arc"}
# A stroke shorter than this, in shares of the tile's side, was a click.
_SHORTEST = 0.01

Point = tuple[float, float]


class Priors:
    """What is known of the pose, as it was drawn.

    Parameters
    ----------
    on_change : callable
        Called without arguments when a prior has changed.
    set_mode : callable
        Called with what dragging is to do: "camera", "circle" or "arc".

    Attributes
    ----------
    place : (u, v, radius) or None
        Only places in the circle.
    heading : (centre, half_width) or None
        Only headings in the arc, degrees.
    seen_from : (u, v)
        Where the camera was when the arc was drawn.
    """

    def __init__(self, on_change: Callable[[], None], set_mode: Callable[[str], None]) -> None:
        self._on_change = on_change
        self.place: tuple[float, float, float] | None = None
        self.heading: tuple[float, float] | None = None
        self.seen_from: Point = (0.5, 0.5)
        self._mode = pn.widgets.RadioButtonGroup(
            options=list(_MODES), sizing_mode="stretch_width", **CHOICE
        )
        self._mode.param.watch(lambda event: set_mode(_MODES[event.new]), "value")
        self._clear = pn.widgets.Button(name="Clear priors", width=120, **OUTLINED)
        self._clear.on_click(self._cleared)
        self._said = pn.pane.HTML("", sizing_mode="stretch_width")
        self._show()

    def panel(self) -> Any:
        """What dragging does, the priors that were drawn, and a button that clears them."""
        return pn.Column(self._mode, self._said, self._clear, sizing_mode="stretch_width")

    def clear(self) -> None:
        """Forget the priors."""
        self.place = self.heading = None
        self._show()

    def drawn(self, start: Point, end: Point, camera: tuple[float, float, float]) -> None:
        """Take a stroke: of a circle the middle and a point of it, of an arc its two ends.

        An arc is seen from the camera, and goes the short way round.
        """
        mode = _MODES[self._mode.value]
        if math.dist(start, end) < _SHORTEST:
            return
        if mode == "circle":
            self.place = (*start, math.dist(start, end))
        elif mode == "arc":
            self.seen_from = camera[:2]
            self.heading = arc(start, end, self.seen_from)
        self._show()
        self._on_change()

    def _cleared(self, event: Any) -> None:
        self.clear()
        self._on_change()

    def _show(self) -> None:
        said = []
        if self.place is not None:
            u, v, radius = self.place
            said.append(f"place within {radius:.3f} of u {u:.3f}, v {v:.3f}")
        if self.heading is not None:
            centre, half_width = self.heading
            said.append(f"heading within {half_width:.0f} degrees of {centre:.0f}")
        self._said.object = f"Priors: {' and '.join(said) or 'none'}"


def arc(start: Point, end: Point, camera: Point) -> tuple[float, float]:
    """Centre and half width, in degrees, of the arc between two points as the camera sees them.

    Examples
    --------
    >>> arc((0.5, 0.0), (1.0, 0.5), (0.5, 0.5))
    (45.0, 45.0)
    >>> arc((0.4, 0.0), (0.6, 0.0), (0.5, 0.5))[0]
    0.0
    """
    first, last = (math.degrees(math.atan2(u - camera[0], camera[1] - v)) for u, v in (start, end))
    swept = (last - first + 180.0) % 360.0 - 180.0
    return round((first + swept / 2.0) % 360.0, 6) % 360.0, round(abs(swept) / 2.0, 6)
