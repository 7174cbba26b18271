"""What a belief holds away from all its clouds: a histogram over the coarse candidates of a tile.

A single image of a junction suits many places. So what a search of the whole tile finds is kept and
moves with the camera: the next search starts from it, and a place becomes a hypothesis of its own
once several images have agreed on it. A drive begins like this, too, with everything elsewhere.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from torch import Tensor

from slicematch.angles import angle_difference_deg
from slicematch.localization.on_map import PlaceOnGlobe
from slicematch.tracking.fixes import PlacedFix
from slicematch.tracking.hypotheses import MOST, Hypothesis
from slicematch.tracking.local_scores import COARSE_GRID, LocalScorer
from slicematch.tracking.odometry import (
    EAST,
    HEADING,
    NORTH,
    MotionNoise,
    Odometry,
    mean_move,
    start_states,
)
from slicematch.tracking.tiles import TrackTile, TrackTiles

Floats = NDArray[np.float64]

# A place becomes a hypothesis where it holds so much of the whole belief.
LEAST_MASS = 0.005
# What is near a peak, in metres and degrees, is one place: a step and a half of the grid.
PEAK_M, PEAK_DEG = 8.0, 17.0
# What is so near to a hypothesis is that one.
KNOWN_M = 5.0
# The share that the histogram forgets at a search: what came into the tile, or was ruled out by
# images that say nothing of their place.
FORGOTTEN = 0.05
# Where the camera is likelier elsewhere than anywhere, the tiles around are searched in turn: their
# centres, in shares of a tile's side.
AROUND = 0.4
COURSE = [(0, 0), (0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, -1), (-1, 1)]


@dataclass(frozen=True)
class _Histogram:
    """Probabilities [K] of a tile's coarse candidates, 1 in all."""

    tile: TrackTile
    likely: Floats


class Elsewhere:
    """The belief away from all hypotheses.

    Parameters
    ----------
    scorer : LocalScorer
    tiles : TrackTiles
    start : PlaceOnGlobe
        What is known of the place at the start; the drive's origin.
    heading : (centre, deviation) or None
        What is known of the heading at the start.
    noise : MotionNoise
        What is unknown of the odometry.
    rng : numpy.random.Generator

    Attributes
    ----------
    probability : float
        That the camera is at no hypothesis.
    """

    def __init__(
        self,
        scorer: LocalScorer,
        tiles: TrackTiles,
        start: PlaceOnGlobe,
        heading: tuple[float, float] | None,
        noise: MotionNoise,
        rng: np.random.Generator,
    ) -> None:
        self.scorer, self.tiles, self.noise, self.rng = scorer, tiles, noise, rng
        self.start, self.start_heading = start, heading
        self.probability = 1.0
        self._histogram: _Histogram | None = None
        self._motion = _still()
        self._turn = 0  # of the course

    def move(self, odometry: Odometry, dt_s: float, scale: float, bias_dps: float) -> None:
        """Go on by odometry, corrected by what is known of it."""
        known = np.column_stack([self._motion[:, :3], [[scale, bias_dps]]])
        self._motion = mean_move(known, odometry, dt_s)

    def blind(self, particles: int) -> Hypothesis:
        """What is known of the start before any image."""
        within_m, heading = self.start.within_m, self.start_heading
        spread_m = self.tiles.side_m / 4 if within_m is None else within_m
        places = self.rng.normal(0.0, spread_m, (particles, 2))
        if heading is None:
            headings = self.rng.uniform(0.0, 360.0, particles)
        else:
            headings = self.rng.normal(heading[0], heading[1], particles) % 360.0
        states = start_states(np.column_stack([places, headings]), self.noise, self.rng)
        return Hypothesis(states, np.full(particles, 1.0 / particles), 1.0)

    def search(
        self,
        ground: Tensor,
        hypotheses: list[Hypothesis],
        fix: PlacedFix | None,
        fix_share: float,
    ) -> "Search | None":
        """Score the whole tile around the belief.

        Parameters
        ----------
        ground : float [1, N * B, C]
            The image, encoded.
        hypotheses : list of Hypothesis
            The likeliest first; at the start there is none.
        fix : PlacedFix, optional
            What a satellite receiver says at this time.
        fix_share : float
            What the fixes since the last search count as.

        Returns
        -------
        Search or None
            None where there is no map.
        """
        tile = self._tile(hypotheses, fix)
        if tile is None:
            return None
        poses = tile.states(self.scorer.coarse_grid.poses())
        scores = self.scorer.whole(ground, tile.scored).scores.ravel()
        forgotten = FORGOTTEN if hypotheses else 0.0
        prior = self._prior(tile, poses, fix, fix_share, forgotten)
        fix_evidence = float(prior.sum())
        for one in hypotheses:
            prior[_within(poses, one.mean(), KNOWN_M)] = 0.0
        prior /= prior.sum()
        return Search(self, tile, poses, scores.astype(np.float64), prior, fix_evidence)

    def keep(self, tile: TrackTile, likely: Floats) -> None:
        """Take up a histogram; what moves from now on is counted anew."""
        self._histogram = _Histogram(tile, likely)
        self._motion = _still()

    def _tile(self, hypotheses: list[Hypothesis], fix: PlacedFix | None) -> TrackTile | None:
        if not hypotheses:
            return self.tiles.at(0.0, 0.0)
        if fix is not None and fix.deviation_m < self.tiles.side_m / 2:
            return self.tiles.at(fix.east_m, fix.north_m)
        east_m, north_m = hypotheses[0].mean()[:2]
        self._turn = self._turn + 1 if self.probability > 0.5 else 0
        east, north = COURSE[self._turn % len(COURSE)]
        away_m = AROUND * self.tiles.side_m
        return self.tiles.at(east_m + east * away_m, north_m + north * away_m)

    def _prior(
        self,
        tile: TrackTile,
        poses: Floats,
        fix: PlacedFix | None,
        fix_share: float,
        forgotten: float,
    ) -> Floats:
        """Probabilities of a tile's candidates [K] before the image is seen.

        Their sum is how likely the fix is by them.
        """
        kept = self._moved(poses)
        total = float(kept.sum())
        # What has come into the tile since, and all of it where the tile is another one.
        held = (1.0 - forgotten) * min(1.0, total)
        kept *= held / max(total, 1e-12)
        anywhere = np.full(len(poses), 1.0 / len(poses))
        if fix is not None:
            rows, columns, headings = COARSE_GRID
            places = fix.prior(poses[::headings, :2], tile.side_m**2 / (rows * columns))
            anywhere = np.repeat(places / headings, headings)
            kept *= fix.likelihood(poses[:, :2]) ** fix_share
        return kept + (1.0 - held) * anywhere

    def _at_the_start(self, poses: Floats) -> Floats:
        prior = np.zeros(len(poses))
        if self.start.within_m is not None:
            prior -= np.square(poses[:, :2]).sum(axis=1) / (2 * self.start.within_m**2)
        if self.start_heading is not None:
            off = angle_difference_deg(poses[:, HEADING], self.start_heading[0])
            deviation = max(self.start_heading[1], 360.0 / COARSE_GRID[2])
            prior -= np.square(off / deviation) / 2
        return np.exp(prior - prior.max())

    def _before(self, poses: Floats) -> Floats:
        """Where a camera was at the last search, or the start, that is now at poses [K, 3]."""
        right_m, forward_m, turn_deg = self._motion[0, :3]
        before = poses.copy()
        before[:, HEADING] -= turn_deg
        angle = np.radians(before[:, HEADING])
        before[:, EAST] -= forward_m * np.sin(angle) + right_m * np.cos(angle)
        before[:, NORTH] -= forward_m * np.cos(angle) - right_m * np.sin(angle)
        return before

    def _moved(self, poses: Floats) -> Floats:
        """Of what was elsewhere at the last search, or the start, what has come to poses [K, 3]."""
        if self._histogram is None:
            likely = self._at_the_start(self._before(poses))
            return likely / likely.sum()
        u, v, heading_deg = self._histogram.tile.poses(self._before(poses)).T
        grid, likely = self.scorer.coarse_grid, self._histogram.likely.reshape(COARSE_GRID)
        likely = np.concatenate([likely, likely[..., :1]], axis=2)
        at = [
            (v - grid.v[0]) / (grid.v[1] - grid.v[0]),
            (u - grid.u[0]) / (grid.u[1] - grid.u[0]),
            heading_deg % 360.0 / (360.0 / COARSE_GRID[2]),
        ]
        return np.asarray(map_coordinates(likely, at, order=1, mode="grid-constant"))


@dataclass(frozen=True)
class Search:
    """A tile that was searched; made by `Elsewhere.search`.

    Attributes
    ----------
    elsewhere : Elsewhere
    tile : TrackTile
    poses : float64 [K, 3]
        Its candidates in the frame of the drive.
    scores : float64 [K]
        What they score.
    prior : float64 [K]
        Their probabilities before the image, if the camera is at no hypothesis; 1 in all.
    fix_evidence : float
        How likely the fix is, if the camera is at no hypothesis.
    """

    elsewhere: Elsewhere
    tile: TrackTile
    poses: Floats
    scores: Floats
    prior: Floats
    fix_evidence: float

    def hypotheses(
        self, likelihood: Floats, probability: float, particles: int
    ) -> list[Hypothesis]:
        """The places that become hypotheses; they are taken out of what is elsewhere.

        Parameters
        ----------
        likelihood : float64 [K]
            Of the candidates, by the image.
        probability : float
            Of being elsewhere, the image included; `Elsewhere.probability` is then what is left.
        particles : int
            Of each.
        """
        left = self.prior * likelihood
        left /= left.sum()
        found: list[Hypothesis] = []
        while len(found) < MOST:
            around = _within(self.poses, self.poses[int(left.argmax())])
            mass = float(left[around].sum())
            if probability * mass < LEAST_MASS:
                break
            states = self._drawn(around, left[around] / mass, particles)
            weights = np.full(particles, 1.0 / particles)
            found.append(Hypothesis(states, weights, probability * mass))
            left[around] = 0.0
        rest = float(left.sum())
        self.elsewhere.probability = probability * min(1.0, rest)
        self.elsewhere.keep(self.tile, left / max(rest, 1e-12))
        return found

    def _drawn(self, around: NDArray[np.intp], weights: Floats, count: int) -> Floats:
        """States of particles at some candidates, each anywhere in its cell."""
        rng = self.elsewhere.rng
        poses = self.poses[rng.choice(around, count, p=weights)]
        cell_m = self.tile.side_m / COARSE_GRID[0]
        cell = np.array([cell_m, cell_m, 360.0 / COARSE_GRID[2]])
        poses = poses + rng.uniform(-0.5, 0.5, (count, 3)) * cell
        return start_states(poses, self.elsewhere.noise, rng)


def _still() -> Floats:
    """The state [1, 5] of a camera that has not moved."""
    return np.array([[0.0, 0.0, 0.0, 1.0, 0.0]])


def _within(poses: Floats, pose: Floats, reach_m: float = PEAK_M) -> NDArray[np.intp]:
    near = np.hypot(*(poses[:, :2] - pose[:2]).T) <= reach_m
    turned = np.abs(angle_difference_deg(poses[:, HEADING], float(pose[HEADING])))
    return np.flatnonzero(near & (turned <= PEAK_DEG))
