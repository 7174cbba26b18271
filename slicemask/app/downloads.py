"""What a page gives away: pictures of a pose, and the bank of a grid."""

import threading
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from panel.widgets import FileDownload
from PIL import Image

from slicemask.bank.build import build_bank
from slicemask.errors import SpecError
from slicemask.geometry.frustum import Frustum
from slicemask.geometry.poses import PoseGrid
from slicemask.plot import draw_pose, save_figure

# Masks of a bank that a page builds: some seconds of work. Larger ones are the command's.
MOST_MASKS = 4_000_000
# Matplotlib's caches of fonts and texts are no place for two threads at once.
_drawing = threading.Lock()


class Download(FileDownload):  # type: ignore[misc]
    """A button that downloads what its coroutine gives, or nothing where that is None."""

    async def _async_sync_data(self) -> None:
        made = await self.callback()
        if made is not None:
            self._sync_data(made)


def picture_of_pose(
    suffix: str,
    masks: NDArray[np.float64],
    pose: NDArray[np.float64],
    frustum: Frustum,
    aerial: Image.Image,
) -> BytesIO:
    """A picture file, ".png" or ".svg", as `slicemask visualize` draws it."""
    with TemporaryDirectory(prefix="slicemask-") as folder, _drawing:
        path = Path(folder, f"pose{suffix}")
        save_figure(draw_pose(masks, pose, frustum, aerial=aerial), path)
        return BytesIO(path.read_bytes())


def bank_of_grid(grid: str, frustum: Frustum, cells: int) -> BytesIO:
    """The bank of a grid, as a file.

    Raises
    ------
    SpecError
        If the grid is invalid, or the bank is larger than a page should build.
    """
    poses = PoseGrid.parse(grid)
    masks = len(poses) * frustum.slices * frustum.band_count
    if masks > MOST_MASKS:
        raise SpecError(
            f"the bank of {grid} has {masks:,} masks; the page builds {MOST_MASKS:,} at most: use "
            "the command, or a smaller grid"
        )
    with TemporaryDirectory(prefix="slicemask-") as folder:
        path = build_bank(poses, frustum, cells, out=Path(folder, "bank.h5")).path
        return BytesIO(path.read_bytes())
