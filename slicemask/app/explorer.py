"""The page without a run: a tile, a camera that is dragged over it, and its masks."""

import asyncio
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import panel as pn
from numpy.typing import NDArray
from PIL import Image

from slicemask.app.controls import FrustumControls, PoseControls
from slicemask.app.downloads import Download, bank_of_grid, picture_of_pose
from slicemask.app.locks import AtRest, when_locked
from slicemask.app.page import HELP, page
from slicemask.app.pixels import blend, shades
from slicemask.app.snippets import bank_command_line, command_line, python_line
from slicemask.app.style import DOWNLOAD
from slicemask.app.text import CodeBox, Notice
from slicemask.app.tile_view import Pointer, Pose, TileView
from slicemask.app.uploads import ImageDropper, read_upload
from slicemask.errors import SlicemaskError
from slicemask.geometry.masks import slice_masks
from slicemask.images import read_aerial

SHIPPED_TILE = Path(__file__).with_name("tile.jpg")
_START: Pose = (0.66, 0.64, 315.0)
_OPACITY = 0.5


class Explorer:
    """One session of the page: nothing of it is shared with another."""

    def __init__(self) -> None:
        self.tile = read_aerial(SHIPPED_TILE)
        self.masks: NDArray[np.float64] = np.empty(0)
        # Numbers and code follow the camera once it rests.
        self._show_texts_at_rest = AtRest(self._show_texts)
        self.notice = Notice()
        self.controls = FrustumControls(self._recompute, self.notice.show)
        self.pose_controls = PoseControls(self._typed)
        self.view = TileView(self._moved, "Aerial tile with a camera: arrows move, Q and E turn it")
        self.pointed = pn.pane.HTML(sizing_mode="stretch_width", min_height=24)
        self.python, self.command = CodeBox("Python"), CodeBox("Command")
        self.dropper = ImageDropper(name="Your own aerial tile: square, north up")
        self.dropper.param.watch(self._dropped, "value")
        self.grid = pn.widgets.TextInput(name="Grid of the bank", value="21x21x64", width=140)
        self.grid.param.watch(lambda event: when_locked(self._show_texts), "value")
        self.bank_command = CodeBox("Command of the bank")
        self.view.show_tile(self.tile)
        self.view.move_to(_START)

    def page(self) -> Any:
        """The page of this session."""
        self.view.connect(pn.state.curdoc)
        downloads = pn.FlexBox(
            *(
                Download(callback=callback, filename=name, label=label, width=120, **DOWNLOAD)
                for label, name, callback in (
                    ("PNG", "slices.png", self._png),
                    ("SVG", "slices.svg", self._svg),
                    ("Bank", "bank.h5", self._bank),
                )
            ),
            self.grid,
            align_items="end",
        )
        left = pn.Column(
            self.view.plot,
            self.pointed,
            pn.pane.HTML(HELP, sizing_mode="stretch_width"),
            sizing_mode="stretch_width",
        )
        right = pn.Column(
            self.notice.panel,
            self.pose_controls.panel(),
            self.controls.panel(),
            self.python.panel,
            self.command.panel,
            downloads,
            self.bank_command.panel,
            self.dropper,
            sizing_mode="stretch_width",
        )
        return page(
            left,
            right,
            subtitle="Slices, bands and exact masks of a camera on an aerial tile.",
            left_label="Aerial tile",
            right_label="Settings",
        )

    def _moved(self, pose: Pose, pointer: Pointer) -> None:
        key = (pose, self.controls.frustum, self.controls.cells.value, self.controls.palette.value)
        if key != getattr(self, "_shown", None):
            self._shown = key
            self._compute()
        under = self._under(pointer)
        if under != self.pointed.object:
            self.pointed.object = under

    def _recompute(self) -> None:
        when_locked(lambda: self.view.move_to(self.view.pose))

    def _typed(self, pose: Pose) -> None:
        when_locked(lambda: self.view.move_to(pose))

    def _compute(self) -> None:
        frustum, cells = self.controls.frustum, self.controls.cells.value
        self.masks = slice_masks([self.view.pose], frustum, cells, engine="rays")[0]
        colours = shades(frustum.slices, frustum.band_count, self.controls.chosen_palette)
        parts = self.masks.reshape(-1, cells, cells)
        self.view.show_masks(blend(parts, colours.reshape(-1, 3), _OPACITY))
        self.view.show_outline(frustum)
        self._show_texts_at_rest()

    def _show_texts(self) -> None:
        pose, frustum, cells = self.view.pose, self.controls.frustum, self.controls.cells.value
        self.pose_controls.show(pose)
        self.python.show(python_line(pose, frustum, cells))
        self.command.show(command_line(pose, frustum, cells))
        self.bank_command.show(bank_command_line(self.grid.value.strip(), frustum, cells))

    def _under(self, pointer: Pointer) -> str:
        """What covers the cell under the pointer."""
        if pointer is None:
            return "Point at a cell to read its fractions."
        cells = self.masks.shape[-1]
        row, column = (min(int(place * cells), cells - 1) for place in pointer[::-1])
        at_cell = self.masks[..., row, column]
        found = [
            f"slice {place[0]}{f' band {place[1]}' if len(place) > 1 else ''}: {at_cell[place]:.4f}"
            for place in sorted(zip(*np.nonzero(at_cell), strict=True), key=lambda p: -at_cell[p])
        ]
        more = f" and {len(found) - 6} more" if len(found) > 6 else ""
        seen = ", ".join(found[:6]) + more if found else "not seen"
        return f"Cell (row {row}, column {column}): <b>{seen}</b>"

    def _dropped(self, event: Any) -> None:
        dropped = self.dropper.last()
        if dropped is None:
            return
        name, content = dropped
        try:
            self.tile = read_tile(content, name)
        except SlicemaskError as error:
            self.notice.show(str(error))
            return
        self.notice.show("")
        when_locked(lambda: self.view.show_tile(self.tile))

    async def _png(self) -> BytesIO | None:
        return await self._made(picture_of_pose, ".png", *self._what_is_shown())

    async def _svg(self) -> BytesIO | None:
        return await self._made(picture_of_pose, ".svg", *self._what_is_shown())

    async def _bank(self) -> BytesIO | None:
        grid = self.grid.value.strip()
        return await self._made(
            bank_of_grid, grid, self.controls.frustum, self.controls.cells.value
        )

    def _what_is_shown(self) -> tuple[Any, ...]:
        return self.masks, np.array(self.view.pose), self.controls.frustum, self.tile

    async def _made(self, make: Any, *arguments: Any) -> BytesIO | None:
        """A file made on its own thread, so that other sessions go on; None where it failed."""
        try:
            made: BytesIO = await asyncio.to_thread(make, *arguments)
        except SlicemaskError as error:
            self.notice.show(str(error))
            return None
        self.notice.show("")
        return made


def read_tile(content: bytes | str, name: str) -> Image.Image:
    """Read an aerial tile that was uploaded.

    Raises
    ------
    ImageError
        If it is too large, unreadable or not square.
    """
    return read_aerial(read_upload(content, name))
