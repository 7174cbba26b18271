"""What a user sets of a frustum, its cells and the camera's pose."""

from collections.abc import Callable
from typing import Any

import panel as pn

from slicemask.app.pixels import PALETTES, Palette
from slicemask.app.style import CHOICE
from slicemask.errors import SpecError
from slicemask.geometry.frustum import Frustum

# The farthest range that the slider of bands sets, in shares of the tile's side; each nearer one
# is half of it.
_FARTHEST = 0.4
# A pinhole camera sees less than 180 degrees.
_WIDEST_PINHOLE_DEG = 170.0


class FrustumControls:
    """Sliders of HFoV, slices, bands, cells and projection.

    Parameters
    ----------
    on_change : callable
        Called without arguments when the frustum or the cells have changed.
    on_error : callable
        Called with a sentence on what is invalid, or with "" once nothing is.
    """

    def __init__(self, on_change: Callable[[], None], on_error: Callable[[str], None]) -> None:
        self._on_change, self._on_error = on_change, on_error
        stretch: dict[str, Any] = {"sizing_mode": "stretch_width"}
        self.projection = pn.widgets.RadioButtonGroup(
            name="Projection", options=["equirectangular", "pinhole"], **CHOICE, **stretch
        )
        self.hfov = pn.widgets.FloatSlider(
            name="HFoV (degrees)", start=5, end=360, step=1, value=360, **stretch
        )
        self.slices = pn.widgets.IntSlider(name="Slices N", start=1, end=64, value=16, **stretch)
        self.band_count = pn.widgets.IntSlider(name="Bands B", start=1, end=6, value=1, **stretch)
        self.bands = pn.widgets.TextInput(
            name="Where bands end (shares of the tile's side)", placeholder="no bands", **stretch
        )
        self.cells = pn.widgets.IntSlider(name="Cells L", start=2, end=64, value=32, **stretch)
        self.palette = pn.widgets.Select(name="Colours", options=list(PALETTES), **stretch)
        self.frustum, self._filling = Frustum(), False
        for widget in (self.projection, self.hfov, self.slices, self.bands, self.cells):
            widget.param.watch(self._changed, "value")
        self.palette.param.watch(self._changed, "value")
        self.band_count.param.watch(self._band_count_changed, "value")

    @property
    def chosen_palette(self) -> Palette:
        """Which colours the slices have."""
        chosen: Palette = self.palette.value
        return chosen

    def panel(self) -> Any:
        """The widgets, below each other."""
        return pn.Column(
            self.projection, self.hfov, self.slices, self.band_count, self.bands, self.cells,
            self.palette, sizing_mode="stretch_width",
        )  # fmt: skip

    def _band_count_changed(self, event: Any) -> None:
        if self._filling:
            return
        ranges = [_FARTHEST / 2**step for step in reversed(range(event.new - 1))]
        self.bands.value = ",".join(f"{range_:g}" for range_ in ranges)

    def _changed(self, event: Any) -> None:
        if event.obj is self.projection and event.new == "pinhole":
            self.hfov.param.update(
                end=_WIDEST_PINHOLE_DEG, value=min(self.hfov.value, 90.0)
            )  # comes back here
        elif event.obj is self.projection:
            self.hfov.end = 360
        try:
            self.frustum = Frustum(
                self.hfov.value, self.slices.value, self.projection.value,
                read_ranges(self.bands.value),
            )  # fmt: skip
        except SpecError as error:
            self._on_error(str(error))
            return
        self._filling = True  # the slider follows the ranges that were typed
        self.band_count.value = min(self.frustum.band_count, self.band_count.end)
        self._filling = False
        self._on_error("")
        self._on_change()


def read_ranges(text: str) -> tuple[float, ...]:
    """Ranges that were typed, such as ``0.08,0.17,0.33``; none of an empty text.

    Raises
    ------
    SpecError
        If they are no numbers separated by commas.
    """
    try:
        return tuple(float(part) for part in text.split(",")) if text.strip() else ()
    except ValueError:
        raise SpecError(
            f"bands are {text[:60]!r}; they must be numbers separated by commas, such as "
            "0.08,0.17,0.33"
        ) from None


class PoseControls:
    """Numbers of a pose, to read and to type.

    Parameters
    ----------
    on_change : callable
        Called with (u, v, heading_deg) that were typed.
    """

    def __init__(self, on_change: Callable[[tuple[float, float, float]], None]) -> None:
        self._on_change, self._showing = on_change, False
        size: dict[str, Any] = {"width": 104}
        self.u = pn.widgets.FloatInput(name="u (east)", start=0, end=1, step=0.01, **size)
        self.v = pn.widgets.FloatInput(name="v (south)", start=0, end=1, step=0.01, **size)
        self.heading = pn.widgets.FloatInput(name="heading (degrees)", step=1.0, **size)
        self._all = (self.u, self.v, self.heading)
        for widget in self._all:
            widget.param.watch(self._typed, "value")

    def panel(self) -> Any:
        """The widgets, beside each other."""
        return pn.FlexBox(*self._all, sizing_mode="stretch_width")

    def show(self, pose: tuple[float, float, float]) -> None:
        """Show a pose."""
        self._showing = True
        try:
            for widget, value in zip(self._all, pose, strict=True):
                widget.value = value
        finally:
            self._showing = False

    def _typed(self, event: Any) -> None:
        if self._showing or any(widget.value is None for widget in self._all):
            return
        u, v, heading_deg = (float(widget.value) for widget in self._all)
        self._on_change((min(max(u, 0.0), 1.0), min(max(v, 0.0), 1.0), heading_deg))
