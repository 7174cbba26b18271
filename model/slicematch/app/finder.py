"""The page with a run: its answer in a tile, and why any other pose scores as it does."""

import asyncio
import logging
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import panel as pn
from PIL import Image

from slicemask.app.controls import PoseControls
from slicemask.app.locks import AtRest, when_locked
from slicemask.app.page import HELP, asked_for_dark, page
from slicemask.app.pixels import blend
from slicemask.app.style import CHOICE, OUTLINED
from slicemask.app.text import Notice
from slicemask.app.tile_view import Pointer, Pose, TileView
from slicemask.app.uploads import ImageDropper, read_upload
from slicemask.errors import AppError, SlicemaskError
from slicemask.geometry.masks import slice_masks
from slicemask.images import read_aerial
from slicematch.app.examples import DataExamples, Examples, ShippedExamples
from slicematch.app.ground_view import GroundView, contribution_colours
from slicematch.app.map_place import MapPlace
from slicematch.app.match import Match, match
from slicematch.app.overlays import Overlays
from slicematch.app.priors import Priors
from slicematch.data.maps import AerialMap, MapTile
from slicematch.localization.geodesy import offset_position
from slicematch.localization.localizer import Localizer
from slicematch.localization.on_map import tile_side

log = logging.getLogger(__name__)

_OPACITY = 0.75
_CONTRIBUTION, _DIFFERENCE = "what it adds", "difference to the answer"


def finder_pages(
    run: str | Path,
    data: str | None = None,
    aerial_map: str | Path | None = None,
    side_m: float | None = None,
) -> Callable[[], Any]:
    """The function that makes a page on a run for each session.

    Parameters
    ----------
    run : path
        A run folder; sessions share what is loaded of it.
    data : path, optional
        A data tree with examples to click; by default those that come with the run, or else its
        data tree's, if it is there.

    aerial_map : path, optional
        A georeferenced raster, which tiles can be cut from.
    side_m : float, optional
        Side of these tiles on the ground, metres; by default that of the run's.

    Raises
    ------
    RunError, BankError
        If the run or its bank of candidates cannot be loaded.
    ConfigError, MapError
        If tiles of the map are none for this run, or the map cannot be read.
    DatasetError
        If the data that were named cannot be read.
    """
    localizer = Localizer.load(run)
    examples: Examples = ShippedExamples(run)
    try:
        if data is not None or not examples:
            examples = DataExamples(localizer.config, data)
    except SlicemaskError as error:
        if data is not None:
            raise
        log.info("no examples to click: %s", error)
    opened = None
    if aerial_map is not None:
        opened = AerialMap.open(aerial_map), tile_side(localizer.config, side_m)
    return lambda: Finder(localizer, examples, opened).page()


class Finder:
    """One session of the page: nothing of it but the run is shared with another.

    Parameters
    ----------
    localizer : Localizer
        Of the run.
    examples : Examples
        Pairs to click; there may be none.
    aerial_map : (AerialMap, float), optional
        What tiles can be cut from, and their side in metres.
    """

    def __init__(
        self,
        localizer: Localizer,
        examples: Examples,
        aerial_map: tuple[AerialMap, float] | None = None,
    ) -> None:
        self.localizer, self._examples = localizer, examples
        self.centre: tuple[float, float] | None = None  # of the tile, where a map gave it
        self.ground: Image.Image | None = None
        self.tile: Image.Image | None = None
        self.truth: Pose | None = None
        self.match: Match | None = None
        self._busy = self._again = self._choosing = False
        self._show_pose_at_rest = AtRest(lambda: self.pose_controls.show(self.view.pose))
        self.notice = Notice()
        self.map_place: MapPlace | None = None
        if aerial_map is not None:
            self.map_place = MapPlace(*aerial_map, self._cut_tile, self.notice.show)
        self.view = TileView(
            self._moved, "Aerial tile with a candidate pose: arrows move, Q and E turn it",
            self._stroked,
        )  # fmt: skip
        self.overlays = Overlays(self.view.plot)
        self.ground_view = GroundView(localizer.config, asked_for_dark())
        self.priors = Priors(self._find, self._set_mode)
        self.pose_controls = PoseControls(self._go)
        self.said = pn.pane.HTML(sizing_mode="stretch_width")
        self.answer = pn.pane.HTML(
            "Choose an example, or drop a ground image and an aerial tile.",
            sizing_mode="stretch_width",
        )
        self.modes = pn.FlexBox(sizing_mode="stretch_width")
        self.coloured_by = pn.widgets.RadioButtonGroup(
            options=[_CONTRIBUTION, _DIFFERENCE], sizing_mode="stretch_width", **CHOICE
        )
        self.coloured_by.param.watch(lambda event: when_locked(self._show_candidate), "value")
        self.heat = pn.widgets.Checkbox(name="Heat map", value=True)
        self.heat.param.watch(self._heat_changed, "value")
        self.resolution = pn.widgets.FloatInput(
            name="Metres per pixel of the tile", value=None, start=0.0, step=0.01, width=200
        )
        self.resolution.param.watch(self._resolution_changed, "value")
        self.ground_dropper = ImageDropper(name="Ground image")
        self.ground_dropper.param.watch(self._dropped_ground, "value")
        self.tile_dropper = ImageDropper(name="Aerial tile: square, north up")
        self.tile_dropper.param.watch(self._dropped_tile, "value")

    def page(self) -> Any:
        """The page of this session."""
        self.view.connect(pn.state.curdoc)
        stretch: dict[str, Any] = {"sizing_mode": "stretch_width"}
        left = pn.Column(
            self._example_buttons(),
            self.view.plot,
            self.priors.panel(),
            self.heat,
            pn.pane.HTML(HELP, **stretch),
            **stretch,
        )
        right = pn.Column(
            self.notice.panel, self.answer, self.modes, self.said, self.ground_view.picture,
            self.ground_view.bars, self.coloured_by, self.pose_controls.panel(),
            self.ground_dropper, *([] if self.map_place is None else [self.map_place.field]),
            self.tile_dropper, self.resolution, **stretch,
        )  # fmt: skip
        return page(
            left, right, subtitle="Where was the camera, and why there? A run's answers.",
            left_label="Aerial tile", right_label="Ground image and scores",
        )  # fmt: skip

    def _example_buttons(self) -> Any:
        buttons = pn.FlexBox(sizing_mode="stretch_width")
        for number in range(len(self._examples)):
            button = pn.widgets.Button(name=f"Example {number + 1}", width=104, **OUTLINED)
            button.on_click(lambda event, number=number: self._choose_example(number))
            buttons.append(button)
        return buttons

    def _choose_example(self, number: int) -> None:
        try:
            example = self._examples.load(number)
        except SlicemaskError as error:
            self.notice.show(str(error))
            return
        self.ground, self.tile, self.truth = example.ground, example.tile, example.pose
        self.centre = None
        self.priors.clear()
        self._set_resolution(example.metres_per_pixel)
        self._find()

    def _set_resolution(self, metres_per_pixel: float) -> None:
        self._choosing = True
        self.resolution.value = round(metres_per_pixel, 6)
        self._choosing = False

    def _cut_tile(self, tile: MapTile) -> None:
        """Take a tile of the map."""
        self.tile, self.centre = Image.fromarray(tile.image), (tile.lat, tile.lon)
        self._set_resolution(tile.metres_per_pixel)
        self._dropped()

    def _dropped_ground(self, event: Any) -> None:
        self.ground = self._read(self.ground_dropper, self.localizer.read_ground) or self.ground
        self._dropped()

    def _dropped_tile(self, event: Any) -> None:
        dropped = self._read(self.tile_dropper, read_aerial)
        if dropped is not None:
            self.tile, self.centre = dropped, None
        self._dropped()

    def _dropped(self) -> None:
        self.truth = None
        self._find()

    def _read(self, dropper: ImageDropper, check: Callable[[Any], Image.Image]) -> Any:
        """The image that was dropped, or None and a notice."""
        dropped = dropper.last()
        if dropped is None:
            return None
        name, content = dropped
        try:
            image = read_upload(content, name)
            check(image)
        except SlicemaskError as error:
            self.notice.show(str(error).replace("the image:", f"{name}:"))
            return None
        self.notice.show("")
        return image

    def _find(self) -> None:
        """Find the camera, once, with what is given now."""
        ground, tile = self.ground, self.tile
        if ground is None or tile is None:
            return
        if self._busy:
            self._again = True
            return
        self._busy = True
        priors = self.priors
        when_locked(
            lambda: self.overlays.show_priors(priors.place, priors.heading, priors.seen_from)
        )
        self.answer.object = "Searching..."
        document = pn.state.curdoc

        async def search() -> None:
            """Search on a thread, so that other sessions go on."""
            found: Match | SlicemaskError
            try:
                found = await asyncio.to_thread(
                    match, self.localizer, ground, tile,
                    metres_per_pixel=self.resolution.value or None,
                    heading_prior=self.priors.heading, place_prior=self.priors.place,
                )  # fmt: skip
            except SlicemaskError as error:
                found = error
            except Exception as error:  # the page must not wait for ever
                log.exception("the search failed")
                found = AppError(f"the search failed: {error}; the server's log tells more")
            # The figures may be changed while the document is locked for that.
            document.add_next_tick_callback(lambda: self._found(found))

        pn.state.execute(search)

    def _found(self, found: Match | SlicemaskError) -> None:
        self._busy = False
        if isinstance(found, Match):
            self.notice.show("")
            self._show(found)
        else:
            self.answer.object = ""
            self.notice.show(str(found))
        if self._again:
            self._again = False
            self._find()

    def _show(self, found: Match) -> None:
        self.match = found
        estimate = found.estimate
        self._answer_parts = found.contributions(_as_pose(estimate.pose))
        self.view.show_tile(found.tile)
        self.ground_view.show_image(found.ground)
        self.overlays.show(estimate)
        self.overlays.show_truth(self.truth)
        self.answer.object = (
            f"<b>Answer:</b> {estimate}{self._position_text(found)}{self._error_text(found)}"
        )
        self.modes[:] = [self._mode_button(number) for number in range(len(estimate.modes))]
        self.view.move_to(_as_pose(estimate.pose))

    def _position_text(self, found: Match) -> str:
        if self.centre is None or not self.resolution.value:
            return ""
        lat, lon = offset_position(self.centre, *found.estimate.offset_m(self.resolution.value))
        return f"; latitude {lat:.7f}, longitude {lon:.7f}"

    def _error_text(self, found: Match) -> str:
        if self.truth is None:
            return ""
        u, v, heading_deg = found.estimate.pose - np.array(self.truth)
        side = found.tile.width * self.resolution.value if self.resolution.value else 1.0
        unit = "m" if self.resolution.value else "of the tile's side"
        turned = abs((heading_deg + 180.0) % 360.0 - 180.0)
        return (
            f". From the truth (green star): {math.hypot(u, v) * side:.2f} {unit}, "
            f"{turned:.1f} degrees"
        )

    def _mode_button(self, number: int) -> Any:
        assert self.match is not None
        mode = self.match.estimate.modes[number]
        button = pn.widgets.Button(
            name=f"Mode {number + 1}: {mode.probability:.0%}", width=130, **OUTLINED
        )
        button.on_click(lambda event: self._go(_as_pose(mode.pose)))
        return button

    def _go(self, pose: Pose) -> None:
        when_locked(lambda: self.view.move_to(pose))

    def _set_mode(self, mode: str) -> None:
        when_locked(lambda: self.view.set_mode(mode))

    def _moved(self, pose: Pose, pointer: Pointer) -> None:
        if self.match is not None and pose != getattr(self, "_shown", None):
            self._show_candidate()

    def _show_candidate(self) -> None:
        if self.match is None:
            return
        self._shown = pose = self.view.pose
        frustum, cells = self.localizer.frustum, self.localizer.model.cells
        parts, answer = self.match.contributions(pose), self._answer_parts
        shown, largest = parts, float(np.abs(answer).max())
        if self.coloured_by.value == _DIFFERENCE:
            shown = parts - answer
            largest /= 2.0
        masks = slice_masks([pose], frustum, cells, engine="rays")[0].reshape(-1, cells, cells)
        colours = contribution_colours(shown, largest).reshape(-1, 4)
        self.view.show_masks(blend(masks, colours, _OPACITY))
        self.view.show_outline(frustum)
        self.ground_view.show(parts, answer, shown, largest)
        score, best = parts.sum(), answer.sum()
        self.said.object = (
            f"<b>Candidate:</b> score {score:.4f}, {abs(score - best):.4f} "
            f"{'below' if score <= best else 'above'} the answer's {best:.4f}. Blue parts speak "
            "for it, orange ones against it."
        )
        self._show_pose_at_rest()

    def _stroked(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        self.priors.drawn(start, end, self.view.pose)

    def _resolution_changed(self, event: Any) -> None:
        if not self._choosing:
            self._find()

    def _heat_changed(self, event: Any) -> None:
        when_locked(lambda: self.overlays.show_heat(event.new))


def _as_pose(pose: Any) -> Pose:
    u, v, heading_deg = (float(value) for value in pose)
    return u, v, heading_deg % 360.0
