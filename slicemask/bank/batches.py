"""Poses in batches that can be computed on their own.

Slices can only be equal, or images of each other, if their places are; so places that are images
of each other go into one batch, and a batch's masks owe nothing to other batches (half-planes,
which are tied to no place, apart).
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
    """Some poses, with all poses of their places and of those places' images.

    Parameters
    ----------
    u, v : float64 [P]
        The places.
    pose : int64 [n]
        Pose indices in the bank.
    place : int64 [n]
        Index of each pose's place.
    heading_deg : float64 [n]
        Each pose's heading.
    """

    u: NDArray[np.float64]
    v: NDArray[np.float64]
    pose: NDArray[np.int64]
    place: NDArray[np.int64]
    heading_deg: NDArray[np.float64]


class PoseSource(Protocol):
    """Where batches come from: places, and the poses of each."""

    u: NDArray[np.float64]
    v: NDArray[np.float64]
    counts: NDArray[np.int64]

    def batch(self, places: NDArray[np.int64]) -> Batch:
        """Return the poses of some places."""

    def pieces(self) -> Iterator[NDArray[np.float64]]:
        """Yield all poses in the bank's order, in pieces [k, 3]."""


class GridSource:
    """The poses of a grid, made as they are needed."""

    def __init__(self, grid: PoseGrid):
        self._grid = grid
        self.v, self.u = (axis.ravel() for axis in np.meshgrid(grid.v, grid.u, indexing="ij"))
        self.counts = np.full(len(self.u), grid.headings)

    def batch(self, places: NDArray[np.int64]) -> Batch:
        """Return the poses of some places."""
        headings = self._grid.headings
        return Batch(
            self.u[places],
            self.v[places],
            (places[:, None] * headings + np.arange(headings)).ravel(),
            np.repeat(np.arange(len(places)), headings),
            np.tile(self._grid.headings_deg, len(places)),
        )

    def pieces(self, step: int = 1 << 16) -> Iterator[NDArray[np.float64]]:
        """Yield all poses in the bank's order, in pieces [k, 3]."""
        for start in range(0, len(self._grid), step):
            yield self._grid.poses(start, start + step)


class ListSource:
    """The poses of a list, sorted by place once."""

    def __init__(self, poses: NDArray[np.float64]):
        self._poses = poses
        u, v = poses[:, 0], poses[:, 1]
        self._order = np.lexsort((v, u))
        fresh = np.ones(len(poses), dtype=bool)
        fresh[1:] = (np.diff(u[self._order]) != 0) | (np.diff(v[self._order]) != 0)
        self._starts = np.flatnonzero(fresh)
        self.counts = np.diff(np.append(self._starts, len(poses)))
        self.u, self.v = u[self._order[self._starts]], v[self._order[self._starts]]

    def batch(self, places: NDArray[np.int64]) -> Batch:
        """Return the poses of some places."""
        counts = self.counts[places]
        within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        pose = self._order[np.repeat(self._starts[places], counts) + within]
        place = np.repeat(np.arange(len(places)), counts)
        return Batch(self.u[places], self.v[places], pose, place, self._poses[pose, 2])

    def pieces(self) -> Iterator[NDArray[np.float64]]:
        """Yield all poses in the bank's order, in pieces [k, 3]."""
        yield self._poses


def batches(source: PoseSource, most_poses: int) -> Iterator[Batch]:
    """Cut poses into batches of about ``most_poses``, more only if a single place's images ask.

    The cut depends on the poses and that number alone, so that a bank's rows always come in the
    same order.
    """
    p, q, _ = offset_codes(source.u, source.v)
    near, far = np.minimum(np.abs(p), np.abs(q)), np.maximum(np.abs(p), np.abs(q))
    order = np.lexsort((near, far))
    ends = np.flatnonzero(
        (np.diff(near[order], append=-1) != 0) | (np.diff(far[order], append=-1) != 0)
    )  # the last place of each set of images
    poses_until = np.cumsum(source.counts[order])[ends]
    start, done = 0, 0
    while start < len(order):
        orbit = int(np.searchsorted(poses_until, done + most_poses, side="right")) - 1
        orbit = max(orbit, int(np.searchsorted(ends, start)))
        yield source.batch(order[start : ends[orbit] + 1])
        start, done = int(ends[orbit]) + 1, int(poses_until[orbit])
