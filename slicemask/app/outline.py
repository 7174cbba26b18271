"""What is drawn over a tile: the edges of slices, the ends of bands, and the slices' numbers."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slicemask.geometry.azimuths import direction
from slicemask.geometry.frustum import Frustum
from slicemask.plot.outlines import edge_ends

_ARC_STEP_DEG = 3.0
# More numbers than this are not legible around a camera.
_MOST_NUMBERS = 32
# How far from the camera to the tile's border a slice's number stands.
_NUMBER_AT = 0.72


@dataclass(frozen=True)
class Outline:
    """Lines and numbers in the aerial frame.

    Attributes
    ----------
    lines : float64 [points, 2]
        The edges of the slices, from the camera to the tile's border, and the ends of the bands:
        one line after the other, with NaN between them.
    numbers : list of str
        Of the slices that are numbered.
    places : float64 [numbers, 2]
        Where the numbers stand.
    """

    lines: NDArray[np.float64]
    numbers: list[str]
    places: NDArray[np.float64]


def outline(pose: NDArray[np.float64], frustum: Frustum) -> Outline:
    """The outline of a pose, float64 [3] u, v, heading_deg, inside the tile."""
    camera = pose[:2]
    edges_deg = frustum.edges_deg(pose[2])
    middles_deg = (edges_deg[:-1] + edges_deg[1:]) / 2.0
    every = -(-frustum.slices // _MOST_NUMBERS)
    chosen = np.arange(0, frustum.slices, every)
    return Outline(
        lines=np.concatenate([_edges(pose, edges_deg), _band_ends(pose, edges_deg, frustum)]),
        numbers=[str(n) for n in chosen],
        places=camera + _NUMBER_AT * (edge_ends(pose, middles_deg[chosen]) - camera),
    )


def _edges(pose: NDArray[np.float64], edges_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    ends = edge_ends(pose, edges_deg)
    lines = np.full((len(ends), 3, 2), np.nan)
    lines[:, 0], lines[:, 1] = pose[:2], ends
    return lines.reshape(-1, 2)


def _band_ends(
    pose: NDArray[np.float64], edges_deg: NDArray[np.float64], frustum: Frustum
) -> NDArray[np.float64]:
    """Circles around the camera, or, of a pinhole camera, lines across its heading."""
    steps = 2 + int((edges_deg[-1] - edges_deg[0]) / _ARC_STEP_DEG)
    azimuths_deg = np.linspace(edges_deg[0], edges_deg[-1], steps)
    rays = np.stack(direction(azimuths_deg, np), axis=-1)
    if frustum.projection == "pinhole":
        rays /= np.cos(np.radians(azimuths_deg - pose[2]))[:, None]
    gap = np.full((1, 2), np.nan)
    lines = [part for range_ in frustum.bands for part in (pose[:2] + range_ * rays, gap)]
    return np.concatenate(lines) if lines else np.empty((0, 2))
