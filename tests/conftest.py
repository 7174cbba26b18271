"""What all tests share: Ctrl-C, and the plain reference.

The reference is what all masks are held against: every cell of every slice, one at a time.
It shares nothing with the package but the meaning of its arguments: angles through `math`, slices
as triangles from the camera, and Shapely's ``polygon.intersection(cell).area``.
"""

import itertools
import math
import signal

import numpy as np
import pytest
from shapely.geometry import Polygon, box

# Jobs that a shell runs in the background ignore Ctrl-C, and so do their children; tests send it.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def plain_masks():
    """The function that computes masks plainly (see `compute_plain_masks`)."""
    return compute_plain_masks


def compute_plain_masks(poses, frustum, cells):
    """Masks of poses, float64 [K, N, L, L], by a Python loop over poses, slices and cells.

    ``poses`` [K, 3] are u, v, heading_deg in the aerial frame; ``frustum`` has hfov_deg, slices,
    projection, left_deg and bands. With bands the masks are [K, N, B, L, L].
    """
    boxes = [
        [box(j / cells, i / cells, (j + 1) / cells, (i + 1) / cells) for j in range(cells)]
        for i in range(cells)
    ]
    masks = np.zeros((len(poses), frustum.slices, len(frustum.bands) + 1, cells, cells))
    for k, (u, v, heading_deg) in enumerate(np.asarray(poses, dtype=float)):
        edges = [heading_deg + offset for offset in _edge_offsets(frustum)]
        for n in range(frustum.slices):
            triangles = _triangles(u, v, edges[n], edges[n + 1])
            for i in range(cells):
                for j in range(cells):
                    cell = boxes[i][j]
                    parts = [triangle.intersection(cell) for triangle in triangles]
                    # What is nearer than each range, and at last everything.
                    nearer = [
                        sum(part.intersection(_nearer(u, v, heading_deg, range_, frustum)).area
                            for part in parts)
                        for range_ in frustum.bands
                    ]  # fmt: skip
                    nearer.append(sum(part.area for part in parts))
                    masks[k, n, :, i, j] = np.diff(nearer, prepend=0.0) / cell.area
    return masks if frustum.bands else masks[:, :, 0]


def _nearer(u, v, heading_deg, range_, frustum):
    """All that is nearer to the camera than a range: a disc of 65,536 corners, or a half-plane."""
    if frustum.projection == "equirectangular":
        angles = np.arange(1 << 16) * (2 * math.pi / (1 << 16))
        return Polygon(np.stack([u + range_ * np.cos(angles), v + range_ * np.sin(angles)], axis=1))
    heading = math.radians(heading_deg)
    along, across = (math.sin(heading), -math.cos(heading)), (math.cos(heading), math.sin(heading))
    corners = [(-8.0, -8.0), (-8.0, 8.0), (range_, 8.0), (range_, -8.0)]
    return Polygon(
        [(u + d * along[0] + s * across[0], v + d * along[1] + s * across[1]) for d, s in corners]
    )


def _edge_offsets(frustum):
    hfov, count = frustum.hfov_deg, frustum.slices
    if frustum.projection == "pinhole":
        left_deg = -hfov / 2 if frustum.left_deg is None else frustum.left_deg
        left, right = (math.tan(math.radians(angle)) for angle in (left_deg, left_deg + hfov))
        columns = [left + (right - left) * n / count for n in range(count + 1)]
        return [math.degrees(math.atan(column)) for column in columns]
    return [-hfov / 2 + n * hfov / count for n in range(count + 1)]


def _triangles(u, v, left_deg, right_deg):
    """A slice as triangles of at most 90 degrees each, that reach past the tile's far corner."""
    parts = max(1, math.ceil((right_deg - left_deg) / 90 - 1e-9))
    azimuths = [
        math.radians(left_deg + (right_deg - left_deg) * part / parts) for part in range(parts + 1)
    ]
    rim = [(u + 4 * math.sin(azimuth), v - 4 * math.cos(azimuth)) for azimuth in azimuths]
    return [Polygon([(u, v), *ends]) for ends in itertools.pairwise(rim)]
