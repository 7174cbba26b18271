"""Searching whole tiles: where a drive begins, and where else the camera may be."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from slicematch.angles import angle_difference_deg
from slicematch.localization.probabilities import probabilities
from slicematch.tracking.fixes import PlacedFix
from slicematch.tracking.hypotheses import Hypothesis, same_place
from slicematch.tracking.local_scores import COARSE_GRID, LocalScorer
from slicematch.tracking.odometry import MotionNoise, start_states
from slicematch.tracking.tiles import TrackTile, TrackTiles

Floats = NDArray[np.float64]

# Modes that are taken up at the start and in a search, and the probability that they must hold.
START_MODES, SEARCH_MODES = 12, 4
START_MASS = 0.98
LEAST_MASS = 0.01
# A mode is what lies so near to a peak, in metres and degrees: a step and a half of the grid.
MODE_M, MODE_DEG = 8.0, 17.0
# In doubt the tiles around are searched in turn: their centres, in shares of a tile's side.
AROUND = 0.4
COURSE = [(0, 0), (0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, -1), (-1, 1)]


@dataclass(frozen=True)
class Search:
    """What was found in a tile.

    Attributes
    ----------
    found : list of Hypothesis
        At places that no hypothesis has; their probabilities are those within the tile.
    known : float64 [hypotheses]
        Probabilities within the tile of what was found where each hypothesis is already.
    scores : float32 [K]
        Of the tile's candidates.
    prior : float64 [K]
        How likely they are before the image, if the camera is lost: alike, or by the last fix.
    agrees : bool
        Whether the tile's best place is that of the likeliest hypothesis.
    """

    found: list[Hypothesis]
    known: Floats
    scores: NDArray[np.float32]
    prior: Floats
    agrees: bool


class Searcher:
    """Finds hypotheses in whole tiles.

    Parameters
    ----------
    scorer : LocalScorer
    tiles : TrackTiles
    temperature : float
        That makes scores probabilities.
    rng : numpy.random.Generator
    """

    def __init__(
        self,
        scorer: LocalScorer,
        tiles: TrackTiles,
        temperature: float,
        rng: np.random.Generator,
    ) -> None:
        self.scorer, self.tiles = scorer, tiles
        self.temperature, self.rng = temperature, rng
        self._turn = 0  # of the course

    def begin(
        self,
        ground: Tensor | None,
        within_m: float | None,
        heading: tuple[float, float] | None,
        particles: int,
        noise: MotionNoise,
    ) -> list[Hypothesis]:
        """The hypotheses at the drive's origin.

        Parameters
        ----------
        ground : float [1, N * B, C] or None
            The first image, encoded.
        within_m : float or None
            Accuracy of the place; None for anywhere in the tile.
        heading : (centre, deviation) or None
        particles : int
            Of each.
        noise : MotionNoise
            What is unknown of the odometry.
        """
        tile = self.tiles.at(0.0, 0.0)
        if ground is None or tile is None:
            return [self._blind(within_m, heading, particles, noise)]
        scores = self.scorer.whole(ground, tile.scored).scores
        poses = tile.states(self.scorer.coarse_grid.poses())
        prior = np.zeros(len(poses))
        if within_m is not None:
            prior -= np.square(poses[:, :2]).sum(axis=1) / (2 * within_m**2)
        if heading is not None:
            off = angle_difference_deg(poses[:, 2], heading[0])
            prior -= np.square(off / max(heading[1], 360.0 / COARSE_GRID[2])) / 2
        likely = probabilities(scores.ravel() / self.temperature + prior, 1.0)
        return self._modes(tile, poses, likely, START_MODES, particles, noise)

    def search(
        self,
        ground: Tensor,
        hypotheses: list[Hypothesis],
        doubt: bool,
        particles: int,
        noise: MotionNoise,
        fix: PlacedFix | None = None,
    ) -> "Search | None":
        """Look for places that no hypothesis has, around the likeliest one.

        In doubt the tiles around are searched, another one each time.

        Parameters
        ----------
        ground : float [1, N * B, C]
            An image, encoded.
        hypotheses : list of Hypothesis
        doubt : bool
            Whether the likeliest one is in doubt.
        particles : int
            Of each that is found.
        noise : MotionNoise
            What is unknown of the odometry.
        fix : PlacedFix, optional
            What a satellite receiver says at this time.

        Returns
        -------
        Search or None
            None where there is no map.
        """
        best = hypotheses[0].mean()
        self._turn = self._turn + 1 if doubt else 0
        east, north = COURSE[self._turn % len(COURSE)]
        away_m = AROUND * self.tiles.side_m
        tile = self.tiles.at(best[0] + east * away_m, best[1] + north * away_m)
        if tile is None:
            return None
        scores = self.scorer.whole(ground, tile.scored).scores.ravel()
        poses = tile.states(self.scorer.coarse_grid.poses())
        prior = self._prior(tile, poses, fix)
        likely = probabilities(scores / self.temperature + np.log(prior), 1.0)
        found = self._modes(tile, poses, likely, SEARCH_MODES, particles, noise)
        means = [one.mean() for one in hypotheses]
        new, known = [], np.zeros(len(means))
        for one in found:
            same = [number for number, mean in enumerate(means) if _known(one.mean(), mean)]
            if same:
                known[same[0]] += one.probability
            else:
                new.append(one)
        return Search(new, known, scores, prior, _known(found[0].mean(), best))

    def _prior(self, tile: TrackTile, poses: Floats, fix: PlacedFix | None) -> Floats:
        """Probabilities of a tile's candidates [K] before the image is seen."""
        if fix is None:
            return np.full(len(poses), 1.0 / len(poses))
        rows, columns, headings = COARSE_GRID
        places = fix.prior(poses[::headings, :2], tile.side_m**2 / (rows * columns))
        return np.repeat(places / headings, headings)

    def _modes(
        self,
        tile: TrackTile,
        poses: Floats,
        likely: Floats,
        most: int,
        particles: int,
        noise: MotionNoise,
    ) -> list[Hypothesis]:
        """The peaks of probabilities [K] at poses [K, 3], each with what lies around it."""
        left = likely.copy()
        found: list[Hypothesis] = []
        while len(found) < most and left.sum() > 1.0 - START_MASS:
            peak = int(left.argmax())
            around = _within(poses, poses[peak], MODE_M, MODE_DEG)
            mass = float(left[around].sum())
            if found and mass < LEAST_MASS:
                break
            chosen = self.rng.choice(around, particles, p=left[around] / mass)
            jitter = self.rng.uniform(-0.5, 0.5, (particles, 3))
            cell_m = tile.side_m / COARSE_GRID[0]
            drawn = poses[chosen] + jitter * [cell_m, cell_m, 360.0 / COARSE_GRID[2]]
            states = start_states(drawn, noise, self.rng)
            found.append(Hypothesis(states, np.full(particles, 1.0 / particles), mass))
            left[around] = 0.0
        return found

    def _blind(
        self,
        within_m: float | None,
        heading: tuple[float, float] | None,
        particles: int,
        noise: MotionNoise,
    ) -> Hypothesis:
        """What is known before any image."""
        spread_m = self.tiles.side_m / 4 if within_m is None else within_m
        places = self.rng.normal(0.0, spread_m, (particles, 2))
        if heading is None:
            headings = self.rng.uniform(0.0, 360.0, particles)
        else:
            headings = self.rng.normal(heading[0], heading[1], particles) % 360.0
        states = start_states(np.column_stack([places, headings]), noise, self.rng)
        return Hypothesis(states, np.full(particles, 1.0 / particles), 1.0)


def _within(poses: Floats, pose: Floats, reach_m: float, reach_deg: float) -> NDArray[np.intp]:
    near = np.hypot(*(poses[:, :2] - pose[:2]).T) <= reach_m
    turned = np.abs(angle_difference_deg(poses[:, 2], float(pose[2])))
    return np.flatnonzero(near & (turned <= reach_deg))


def _known(pose: Floats, other: Floats) -> bool:
    """Whether a mode of the coarse grid is a place that is known."""
    near = np.hypot(*(pose[:2] - other[:2])) < MODE_M
    return bool(
        (near and abs(angle_difference_deg(pose[2:], float(other[2]))[0]) < MODE_DEG)
        or same_place(pose, other)
    )
