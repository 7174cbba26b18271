"""One pose to look at, with its masks: any pose, or one of a bank."""

import re
import reprlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slicemask.bank.cache import newest_bank
from slicemask.bank.read import Bank, open_bank
from slicemask.errors import PoseError
from slicemask.geometry.frustum import Frustum
from slicemask.geometry.masks import slice_masks
from slicemask.geometry.poses import check_poses

_INDEX = re.compile(r"\s*[0-9]{1,18}\s*")


@dataclass(frozen=True)
class View:
    """A pose and what it sees.

    Parameters
    ----------
    pose : float64 [3]
        u, v, heading_deg.
    frustum : Frustum
        Field of view and slices.
    cells : int
        L, the cells along each side of the tile.
    masks : float [N, L, L], or [N, B, L, L] with bands
        The slice masks.
    name : str
        A name for files.
    """

    pose: NDArray[np.float64]
    frustum: Frustum
    cells: int
    masks: NDArray[Any]
    name: str


def view_at(pose: tuple[float, float, float], frustum: Frustum, cells: int) -> View:
    """View any pose; its masks are computed now.

    Parameters
    ----------
    pose : (u, v, heading_deg)
        u, v in [0, 1] of the aerial frame and heading_deg, any finite angle clockwise from north.
    frustum : Frustum
        Field of view and slices.
    cells : int
        L, the cells along each side of the tile.

    Returns
    -------
    View
        With the masks, float64 [N, L, L], or [N, B, L, L] with bands.

    Raises
    ------
    PoseError, SpecError
        If the pose or the cells are invalid.
    """
    checked = check_poses([pose])
    u, v, heading_deg = checked[0]
    # As banks are named.
    ranges = "-".join(f"{band_range:g}" for band_range in frustum.bands)
    bands = f"_bands{ranges}" if ranges else ""
    left = "" if frustum.left_deg is None else f"_left{frustum.left_deg:g}"
    name = (
        f"at_{u:g}-{v:g}-{heading_deg:g}_hfov{frustum.hfov_deg:g}{left}_{frustum.projection}"
        f"_n{frustum.slices}{bands}_l{cells}"
    )
    return View(checked[0], frustum, cells, slice_masks(checked, frustum, cells)[0], name)


def view_of_bank(
    path: str | Path | None, pose: str | None, cache: str | Path | None = None
) -> View:
    """View a pose of a bank.

    Parameters
    ----------
    path : path, optional
        The bank; the newest one of the cache by default.
    pose : str, optional
        ``row,column,heading`` in the bank's grid, or a pose index; by default the middle one.
    cache : path, optional
        The cache folder; SLICEMASK_CACHE or ``./masks_cache`` by default.

    Returns
    -------
    View
        With the masks as the bank stores them, float32 [N, L, L], or [N, B, L, L] with bands.

    Raises
    ------
    BankError
        If there is no such bank, or it is unreadable.
    PoseError
        If the bank holds no such pose.
    """
    path = Path(path) if path is not None else newest_bank(cache)
    with open_bank(path) as bank:
        k = len(bank) // 2 if pose is None else _pose_index(bank, pose)
        name = f"{path.stem}_pose-{(pose or str(k)).replace(',', '-')}"
        return View(bank.poses[k], bank.spec.frustum, bank.spec.cells, bank.masks(k), name)


def _pose_index(bank: Bank, text: str) -> int:
    grid = bank.spec.grid
    numbers = text.split(",")
    if len(numbers) not in (1, 3) or not all(_INDEX.fullmatch(part) for part in numbers):
        raise PoseError(
            f"pose is {reprlib.repr(text)}; it must be row,column,heading such as 10,10,8, or a "
            "pose index"
        )
    if len(numbers) == 1:
        k = int(numbers[0])
        if k >= len(bank):
            raise PoseError(f"pose {k} is not in the bank; it holds 0 to {len(bank) - 1}")
        return k
    if grid is None:
        raise PoseError(
            f"pose is {text!r}, but the bank holds a list of poses: give one index, "
            f"0 to {len(bank) - 1}"
        )
    row, column, heading = map(int, numbers)
    return grid.index(row, column, heading)
