"""Scores around a belief: candidates that follow it, and scores of poses between them.

Masks and scores of a banded model cost some milliseconds a pose in closed form, too long for
hundreds of particles ten times a second. So they are computed once, for candidates 0.75 m and 5.6
degrees apart in the middle of a tile (a bank, kept in the cache), of which each frame scores the
few around the belief, every one or every second of them, as the belief is narrow or wide. Particles
between candidates get a spline's value. A search scores coarse candidates of the whole tile.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from torch import Tensor

from slicemask import PoseGrid, build_bank
from slicematch.localization.localizer import Localizer
from slicematch.localization.members import load_candidates, only
from slicematch.localization.tiles import AerialTile
from slicematch.scoring.scores import score_candidates
from slicematch.tracking.place_scores import PlaceCandidates, PlaceDescriptors

Floats = NDArray[np.float64]
Integers = NDArray[np.intp]

# The share of a tile's side that fine candidates cover, in its middle.
FINE_SHARE = 0.5
FINE_GRID, COARSE_GRID = (48, 48, 64), (14, 14, 32)
# Places along each side, and headings, that are scored around a belief at most.
MOST_PLACES, MOST_HEADINGS = 9, 33
LEAST_REACH = 2  # candidates to each side, for the spline
# Tiles of which the fine candidates are kept: 150 MB each, if all of them are asked for.
FINE_TILES_KEPT = 4


@dataclass(frozen=True)
class Volume:
    """Scores on a regular part of a grid.

    Attributes
    ----------
    scores : float32 [rows, columns, headings]
    first : (v, u, heading_deg)
        Of its first candidate.
    steps : (v, u, heading_deg)
        From one to the next.
    round : bool
        Whether the headings go all the way round.
    """

    scores: NDArray[np.float32]
    first: tuple[float, float, float]
    steps: tuple[float, float, float]
    round: bool

    def at(self, poses: Floats) -> Floats:
        """Scores of poses [P, 3] (u, v, heading_deg) between them, by cubic splines.

        Beyond the edge a score is that of the edge.
        """
        row = (poses[:, 1] - self.first[0]) / self.steps[0]
        column = (poses[:, 0] - self.first[1]) / self.steps[1]
        turned = (poses[:, 2] - self.first[2]) % 360.0
        scores, count = self.scores, self.scores.shape[2]
        if self.round:
            around = 3  # of the other end, for the spline
            scores = np.concatenate([scores[..., -around:], scores, scores[..., :around]], axis=2)
            heading = turned / self.steps[2] + around
        else:
            middle = (count - 1) / 2 * self.steps[2]
            turned = (turned - middle + 180.0) % 360.0 - 180.0 + middle
            heading = turned / self.steps[2]
        at = [
            np.clip(axis, 0, size - 1)
            for axis, size in zip((row, column, heading), scores.shape, strict=True)
        ]
        return np.asarray(map_coordinates(scores, at, np.float64, order=3, mode="nearest"))


@dataclass(frozen=True)
class ScoredTile:
    """A tile with what it shows at candidates; made by `LocalScorer.describe`.

    Attributes
    ----------
    encoded : AerialTile
    fine, coarse : PlaceDescriptors or None
        None where each slice has an attention map of its own: there is nothing to be kept then.
    """

    encoded: AerialTile
    fine: PlaceDescriptors | None
    coarse: PlaceDescriptors | None


class LocalScorer:
    """Scores of encoded ground images around beliefs and in whole tiles.

    Parameters
    ----------
    localizer : Localizer
        A run whose slices share one attention map, or not; the former is several times faster.
    cache : path, optional
        The folder of banks.
    """

    def __init__(self, localizer: Localizer, cache: str | Path | None = None) -> None:
        self.localizer = localizer
        frustum, cells = localizer.frustum, localizer.model.cells
        low, high = (1 - FINE_SHARE) / 2, (1 + FINE_SHARE) / 2
        fine = PoseGrid(*FINE_GRID, extent=(low, low, high, high))
        grids = fine, PoseGrid(*COARSE_GRID)
        banks = [build_bank(grid, frustum, cells, cache=cache).path for grid in grids]
        loaded = [load_candidates(bank, frustum, cells) for bank in banks]
        (every, self.fine_grid), (coarse, self.coarse_grid) = loaded
        self.coarse, self.fine = (
            PlaceCandidates(candidates.to(localizer.device), grid)
            for candidates, grid in ((coarse, self.coarse_grid), (every, self.fine_grid))
        )
        self._recent: list[PlaceDescriptors] = []  # the last one that was used is the last

    def describe(self, tile: AerialTile) -> ScoredTile:
        """What a tile shows at candidates, which is computed once they are asked for."""
        model = self.localizer.model
        if model.aerial_attention.cross_view:
            return ScoredTile(tile, None, None)
        with torch.inference_mode():
            features = only(tile.features)
            attention = model.aerial_attention.attention(features)
            fine, coarse = (
                places.describe(features, attention) for places in (self.fine, self.coarse)
            )
        return ScoredTile(tile, fine, coarse)

    def whole(self, ground: Tensor, tile: ScoredTile) -> Volume:
        """Scores of coarse candidates of a whole tile."""
        rows, columns, headings = COARSE_GRID
        chosen = _every(rows * columns), _every(headings)
        scores = self._scores(ground, tile, tile.coarse, self.coarse, *chosen)
        return _volume(scores.reshape(COARSE_GRID), self.coarse_grid, (0, 0, 0), (1, 1), True)

    def around(self, ground: Tensor, tile: ScoredTile, pose: Floats, spread: Floats) -> Volume:
        """Scores of fine candidates around a pose.

        Parameters
        ----------
        ground : float [1, N * B, C]
            d_g^{n,b}.
        tile : ScoredTile
        pose : float64 [3]
            u, v, heading_deg.
        spread : float64 [3]
            How far from it scores are needed, in the same units; beyond what the fine candidates
            cover, and what can be scored in a frame's time, there are none.
        """
        self._keep_few(tile.fine)
        grid = self.fine_grid
        step = grid.u[1] - grid.u[0]
        stride = _stride(max(spread[0], spread[1]) / step, MOST_PLACES)
        rows = _along((pose[1] - grid.v[0]) / step, spread[1] / step, stride, len(grid.v))
        columns = _along((pose[0] - grid.u[0]) / step, spread[0] / step, stride, len(grid.u))
        count, step_deg = grid.headings, 360.0 / grid.headings
        turn = _stride(spread[2] / step_deg, MOST_HEADINGS)
        reach = max(LEAST_REACH, int(np.ceil(spread[2] / step_deg / turn)))
        wanted = min(2 * reach + 1, count // turn)
        first_heading = (round(pose[2] / step_deg / turn) - wanted // 2) * turn
        headings = first_heading + turn * np.arange(wanted)
        places = (rows[:, None] * grid.shape[1] + columns).ravel()
        scores = self._scores(ground, tile, tile.fine, self.fine, places, headings % count)
        return _volume(
            scores.reshape(len(rows), len(columns), wanted),
            grid,
            (int(rows[0]), int(columns[0]), int(first_heading)),
            (stride, turn),
            wanted * turn == count,
        )

    def _keep_few(self, used: PlaceDescriptors | None) -> None:
        if used is not None:
            self._recent = [one for one in self._recent if one is not used] + [used]
            while len(self._recent) > FINE_TILES_KEPT:
                self._recent.pop(0).forget()

    def _scores(
        self,
        ground: Tensor,
        tile: ScoredTile,
        known: PlaceDescriptors | None,
        candidates: PlaceCandidates,
        places: Integers,
        headings: Integers,
    ) -> NDArray[np.float32]:
        with torch.inference_mode():
            if known is not None:
                scores = known.scores(ground, places, headings)
            else:
                features = only(tile.encoded.features)
                attention = self.localizer.model.attend(features, ground)
                window = candidates.window(places, headings)
                scores = score_candidates(ground, features, attention, window)[0]
        return np.asarray(scores.float().cpu().numpy())


def _every(count: int) -> Integers:
    return np.arange(count, dtype=np.intp)


def _stride(reach: float, most: int) -> int:
    """Every which candidate is scored, so that so far to both sides at most so many are."""
    stride = 1
    while 2 * np.ceil(reach / stride) + 1 > most:
        stride *= 2
    return stride


def _along(middle: float, reach: float, stride: int, size: int) -> Integers:
    """Which of an axis's values lie so far around one, those that there are."""
    steps = max(LEAST_REACH, int(np.ceil(reach / stride)))
    # The same places as in the frame before, where they lie further apart, too: they are known.
    centre = stride * round(min(max(middle, 0.0), size - 1.0) / stride)
    at = centre + stride * np.arange(-steps, steps + 1)
    return np.asarray(at[(at >= 0) & (at < size)])


def _volume(
    scores: NDArray[np.float32],
    grid: PoseGrid,
    first: tuple[int, int, int],
    strides: tuple[int, int],
    all_round: bool,
) -> Volume:
    stride, turn = strides
    step, step_deg = float(grid.u[1] - grid.u[0]), 360.0 / grid.headings
    row, column, heading = first
    return Volume(
        scores,
        (float(grid.v[row]), float(grid.u[column]), heading * step_deg),
        (stride * step, stride * step, turn * step_deg),
        all_round,
    )
