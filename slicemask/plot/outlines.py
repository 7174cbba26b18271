"""Where lines of a picture end: slices' edges at the tile's border, the arrow of a heading."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slicemask.geometry.azimuths import direction
from slicemask.geometry.poses import check_poses

Array = NDArray[np.float64]
Pose = Sequence[float] | Array

_ARROW = 0.13  # length of the heading's arrow, as a fraction of the tile's side


def edge_ends(pose: Pose, azimuth_deg: ArrayLike) -> Array:
    """Where rays from the camera leave the tile.

    Parameters
    ----------
    pose : array [3]
        u, v, heading_deg; the heading is not used.
    azimuth_deg : array [E]
        Azimuths of the rays, degrees clockwise from north.

    Returns
    -------
    ends : float64 [E, 2]
        u, v of the tile's border, in the aerial frame; the camera itself for a ray that leaves
        the tile at once.

    Raises
    ------
    PoseError
        If the pose lies outside the tile or is not finite.

    Examples
    --------
    >>> edge_ends((0.5, 0.75, 0.0), [0.0, 45.0, 90.0]).tolist()
    [[0.5, 0.0], [1.0, 0.25], [1.0, 0.75]]
    """
    camera = check_pose(pose)[:2]
    rays = np.stack(direction(np.asarray(azimuth_deg, dtype=np.float64), np), axis=-1)
    room = np.where(rays > 0.0, 1.0 - camera, camera)
    steps = np.where(rays == 0.0, np.inf, room / np.where(rays == 0.0, 1.0, np.abs(rays)))
    ends = camera + rays * steps.min(axis=-1, keepdims=True)
    return np.asarray(np.clip(ends, 0.0, 1.0))


def arrow_tip(pose: Pose, margin: float) -> Array:
    """Where the arrow along a camera's heading ends.

    Parameters
    ----------
    pose : array [3]
        u, v in [0, 1] of the aerial frame and heading_deg, clockwise from north.
    margin : float
        How far out of the tile, whose side is 1, the arrow may reach; it is cut short there.

    Returns
    -------
    tip : float64 [2]
        u, v in the aerial frame.

    Examples
    --------
    >>> arrow_tip((0.5, 0.5, 90.0), 0.05).tolist()
    [0.63, 0.5]
    >>> arrow_tip((1.0, 0.5, 90.0), 0.05).tolist()
    [1.05, 0.5]
    """
    camera = np.asarray(pose[:2], dtype=np.float64)
    framed = (camera + margin) / (1.0 + 2.0 * margin)
    ahead = (edge_ends((*framed, 0.0), pose[2]) - framed) * (1.0 + 2.0 * margin)
    return np.asarray(camera + ahead * min(1.0, _ARROW / math.hypot(*ahead)))


def check_pose(pose: Pose) -> Array:
    """Check one pose.

    Parameters
    ----------
    pose : array [3]
        u, v in [0, 1] of the aerial frame and heading_deg, any finite angle.

    Returns
    -------
    float64 [3]
        With the heading in [0, 360).

    Raises
    ------
    PoseError
        If it lies outside the tile, is not finite or is no pose.
    """
    poses: Any = [pose]
    return np.asarray(check_poses(poses)[0])
