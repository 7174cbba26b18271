"""Poses in batches that can be computed independently.

Slices can only be equal, or mirror images of each other, if their places are; so places that are
images of each other under the tile's symmetries go into one batch, and no mask is shared between
batches. (Half-planes, which have no place of their own, are the exception.)
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from slicemask.geometry.poses import PoseGrid
from slicemask.geometry.symmetry import offset_codes


@dataclass(frozen=True)
class Batch:
    """All poses of some places and of those places' images under the tile's symmetries.

    Parameters
    ----------
    u, v : float64 [P]
        The places, in the aerial frame.
    pose : int64 [n]
        Pose indices in the bank.
    place : int64 [n]
        Index of each pose's place.
    heading_deg : float64 [n]
        Each pose's heading, clockwise from north.
    """

    u: NDArray[np.float64]
    v: NDArray[np.float64]
    pose: NDArray[np.int64]
    place: NDArray[np.int64]
    heading_deg: NDArray[np.float64]


class PoseSource(Protocol):
    """Poses, in batches for computing masks and in the bank's order for storing them."""

    def batches(self, most_poses: int) -> Iterator[Batch]:
        """Split the poses into batches of at most ``most_poses``, or of one orbit if it has more.

        The batches depend on the poses and that number alone, so that a bank's rows always come
        in the same order.
        """

    def pieces(self) -> Iterator[NDArray[np.float64]]:
        """Yield all poses in the bank's order, in pieces [k, 3]."""


class GridSource:
    """The poses of a grid, made as they are needed: memory does not grow with their number."""

    def __init__(self, grid: PoseGrid):
        self._grid = grid

    def batches(self, most_poses: int) -> Iterator[Batch]:
        """Split the poses into batches; see `PoseSource`."""
        places: list[NDArray[np.int64]] = []
        count = 0
        for orbit in self._orbits():
            if places and (count + len(orbit)) * self._grid.headings > most_poses:
                yield self._batch(np.concatenate(places))
                places, count = [], 0
            places.append(orbit)
            count += len(orbit)
        yield self._batch(np.concatenate(places))

    def _orbits(self) -> Iterator[NDArray[np.int64]]:
        """Yield the places (row * columns + column) of each orbit of the symmetries."""
        columns = self._grid.columns
        p, q, _ = offset_codes(self._grid.u, self._grid.v)
        # A place's images have the same two distances from the centre's lines, in either order.
        column_at: dict[int, list[int]] = {}
        row_at: dict[int, list[int]] = {}
        for at, codes in ((column_at, p), (row_at, q)):
            for number, code in enumerate(np.abs(codes).tolist()):
                at.setdefault(code, []).append(number)
        distances = sorted({*column_at, *row_at})
        for larger in distances:
            for smaller in distances:
                if smaller > larger:
                    break
                orbit = [
                    row * columns + column
                    for p_distance, q_distance in {(smaller, larger), (larger, smaller)}
                    for row in row_at.get(q_distance, ())
                    for column in column_at.get(p_distance, ())
                ]
                if orbit:
                    yield np.array(sorted(orbit))

    def _batch(self, places: NDArray[np.int64]) -> Batch:
        headings = self._grid.headings
        row, column = np.divmod(places, self._grid.columns)
        return Batch(
            self._grid.u[column],
            self._grid.v[row],
            (places[:, None] * headings + np.arange(headings)).ravel(),
            np.repeat(np.arange(len(places)), headings),
            np.tile(self._grid.headings_deg, len(places)),
        )

    def pieces(self, step: int = 1 << 16) -> Iterator[NDArray[np.float64]]:
        """Yield all poses in the bank's order, in pieces [k, 3]."""
        for start in range(0, len(self._grid), step):
            yield self._grid.poses(start, start + step)


class ListSource:
    """The poses of a list, sorted by orbit and place."""

    def __init__(self, poses: NDArray[np.float64]):
        self._poses = poses

    def batches(self, most_poses: int) -> Iterator[Batch]:
        """Split the poses into batches; see `PoseSource`."""
        u, v = self._poses[:, 0], self._poses[:, 1]
        p, q, _ = offset_codes(u, v)
        smaller, larger = np.minimum(np.abs(p), np.abs(q)), np.maximum(np.abs(p), np.abs(q))
        order = np.lexsort((q, p, smaller, larger))
        starts_orbit = (np.diff(smaller[order]) != 0) | (np.diff(larger[order]) != 0)
        ends = np.append(np.flatnonzero(starts_orbit) + 1, len(order))  # of each orbit
        start = 0
        while start < len(order):
            fits = int(np.searchsorted(ends, start + most_poses, side="right"))
            end = int(ends[max(fits - 1, int(np.searchsorted(ends, start, side="right")))])
            yield self._batch(order[start:end], p, q)
            start = end

    def _batch(self, pose: NDArray[np.int64], p: NDArray[np.int64], q: NDArray[np.int64]) -> Batch:
        fresh = (np.diff(p[pose]) != 0) | (np.diff(q[pose]) != 0)
        place = np.concatenate([[0], np.cumsum(fresh)])
        first = pose[np.concatenate([[0], np.flatnonzero(fresh) + 1])]
        u, v, heading_deg = self._poses.T
        return Batch(u[first], v[first], pose, place, heading_deg[pose])

    def pieces(self) -> Iterator[NDArray[np.float64]]:
        """Yield all poses in the bank's order, in pieces [k, 3]."""
        yield self._poses
