"""A tracker: a Bayes filter over place and heading that follows a camera on a map."""

import logging
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from slicemask.errors import ImageError
from slicemask.images import Picture
from slicematch.data.maps import AerialMap
from slicematch.data.positions import Fix
from slicematch.digits import digits
from slicematch.localization.localizer import Localizer
from slicematch.localization.members import only
from slicematch.localization.on_map import PlaceOnGlobe, tile_side
from slicematch.tracking.elsewhere import Elsewhere
from slicematch.tracking.fixes import PlacedFix, deviation_of
from slicematch.tracking.hypotheses import Hypothesis, merged, normalised
from slicematch.tracking.local_scores import LocalScorer
from slicematch.tracking.odometry import BIAS, HEADING, SCALE, Odometry, move
from slicematch.tracking.tiles import TrackTiles
from slicematch.tracking.track_estimate import TrackEstimate, TrackMode
from slicematch.tracking.track_settings import TrackSettings

log = logging.getLogger(__name__)

Floats = NDArray[np.float64]


# Beliefs whose likeliest hypothesis is less likely than this are searched more often.
CERTAIN = 0.9
# Of a belief that begins without an image, or with one that says nothing.
START_ELSEWHERE = 0.1
# What is followed is not given up at once.
MOST_ELSEWHERE = 0.99
# Beyond this much of a gap the motion between two frames is anybody's guess.
LONGEST_GAP_S = 10.0
# Particles' spread around a mean that scores are needed for, in standard deviations.
DEVIATIONS = 2.5
# How many hypotheses a frame weighs beside the likeliest one: those that waited longest.
OTHERS, OTHERS_IN_DOUBT = 1, 2
# A cloud wider than this, in shares of the tile's side, is scored by coarse candidates.
WIDE_SHARE = 1 / 10


class Tracker:
    """Follows a camera on a map, frame by frame.

    Parameters
    ----------
    localizer : Localizer
        A run on tiles with north up. Of an ensemble the first network alone follows: a frame has
        little time.
    aerial_map : AerialMap
        Of the drive.
    start : PlaceOnGlobe
        Where it begins: a fix, with `within_m` its accuracy, the distance that about two in three
        of such fixes are off by less; without it, anywhere in the tile around the place.
    heading : (centre, deviation), optional
        What is known of the heading at the start, degrees; by default nothing.
    side_m : float, optional
        Side of the tiles on the ground; the run's own by default.
    settings : TrackSettings, optional
    cache : path, optional
        The folder of banks.

    Raises
    ------
    ConfigError
        If the run's tiles are turned with the camera, or a setting is invalid.
    BankError
        If the bank of candidates can neither be read nor written.

    Notes
    -----
    Each step predicts by odometry, weighs particles by the scores of candidates around them, and
    resamples. Now and then the whole tile is searched, and what is found away from all hypotheses
    becomes one more (`slicematch.tracking.hypotheses`, `slicematch.tracking.elsewhere`).

    Examples
    --------
    ::

        with Tracker(localizer, AerialMap.open("map.tif"), PlaceOnGlobe(40.75, -73.99, 20)) as it:
            for image, speed, yaw_rate in frames:
                estimate = it.step(image, Odometry(speed, yaw_rate), dt_s=0.1)
                print(estimate.lat, estimate.lon, estimate.heading_deg)
    """

    def __init__(
        self,
        localizer: Localizer,
        aerial_map: AerialMap,
        start: PlaceOnGlobe,
        heading: tuple[float, float] | None = None,
        side_m: float | None = None,
        settings: TrackSettings | None = None,
        cache: str | Path | None = None,
    ) -> None:
        localizer = self.localizer = localizer.alone()
        self.settings = settings or TrackSettings()
        self.scorer = LocalScorer(localizer, cache)
        self.tiles = TrackTiles(
            self.scorer, aerial_map, (start.lat, start.lon), tile_side(localizer.config, side_m)
        )
        self.temperature = localizer.temperature
        self.rng = np.random.default_rng(self.settings.seed)
        self.elsewhere = Elsewhere(
            self.scorer, self.tiles, start, heading, self.settings.noise, self.rng
        )
        self.hypotheses: list[Hypothesis] = []
        self.time_s = 0.0
        self._odometry = Odometry(0.0)
        self._way_m = 0.0  # since the last image that was used
        self._unsearched_m = 0.0  # since the last search
        self._search_due_s = self.settings.doubt_search_s
        self._fix: PlacedFix | None = None  # the last one
        self._since_fix_m = 0.0
        # How likely fixes since the last search are by the hypotheses, and what they count as.
        self._fix_evidence, self._fix_share = 1.0, 0.0
        self._notes: list[str] = []

    def __enter__(self) -> "Tracker":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def odometry(self) -> Odometry:
        """The motion of the last step."""
        return self._odometry

    def close(self) -> None:
        """End the thread that encodes tiles."""
        self.tiles.close()

    def step(
        self,
        image: Picture | None,
        odometry: Odometry | None = None,
        dt_s: float = 0.0,
        note: str = "",
        fix: Fix | None = None,
    ) -> TrackEstimate:
        """Go on by one frame.

        Nothing that a frame may lack ends the drive: an image that is missing or unreadable,
        odometry that is missing or not finite, a clock that stands still or runs backwards, a map
        that ends. The belief then goes on with what is left, grows wider, and the estimate's notes
        say so.

        Parameters
        ----------
        image : path, PIL image, uint8 [height, width, 3], or None
            As `Localizer.localize` takes it; None if there is none at this time.
        odometry : Odometry, optional
            The mean motion since the last step; without it the last one is taken to go on, about.
        dt_s : float
            Since the last step, seconds; at the first step it says nothing.
        note : str
            Why there is no image, for the estimate's notes.
        fix : Fix, optional
            Of a satellite receiver at this time, as weak evidence (`slicematch.tracking.fixes`).

        Returns
        -------
        TrackEstimate
        """
        self._notes = []
        first = not self.hypotheses
        odometry, dt_s = self._checked(odometry, dt_s, first)
        if note:
            self._say(note)
        self.time_s += dt_s
        if not first and dt_s > 0:
            self._predict(odometry, dt_s)
        if fix is not None:
            self._weigh_by_fix(fix)
        seen = self._look(image)
        self.hypotheses = normalised(merged(self.hypotheses))
        self._resample()
        if seen:
            self._way_m = 0.0
        self._encode_ahead()
        return self._estimate(seen)

    def _checked(
        self, odometry: Odometry | None, dt_s: float, first: bool
    ) -> tuple[Odometry | None, float]:
        if odometry is not None and not odometry.finite:
            self._say("the odometry is not finite, so that the last motion is taken to go on")
            odometry = None
        if first:
            return odometry, 0.0
        if odometry is None and not self._notes:
            self._say("there is no odometry, so that the last motion is taken to go on")
        if not (math.isfinite(dt_s) and dt_s > 0):
            self._say(f"the clock went on by {dt_s:g} s, so that no time is taken to have passed")
            return odometry, 0.0
        if dt_s > LONGEST_GAP_S:
            self._say(f"nothing came for {digits(dt_s, 4)} s")
        return odometry, float(dt_s)

    def _predict(self, odometry: Odometry | None, dt_s: float) -> None:
        noise = self.settings.noise
        self.hypotheses = [
            replace(one, states=move(one.states, odometry, self._odometry, dt_s, noise, self.rng))
            for one in self.hypotheses
        ]
        if odometry is not None:
            self._odometry = odometry
        best = self.hypotheses[0]
        self.elsewhere.move(self._odometry, dt_s, *(best.weights @ best.states[:, [SCALE, BIAS]]))
        gone_m = abs(self._odometry.speed_mps) * dt_s
        self._way_m += gone_m
        self._unsearched_m += gone_m
        self._since_fix_m += gone_m
        # A turn shows other things too.
        turned = abs(self._odometry.yaw_rate_dps) * dt_s / 90.0
        self._way_m += turned * self.settings.independent_m

    def _weigh_by_fix(self, fix: Fix) -> None:
        if not (math.isfinite(fix.lat) and math.isfinite(fix.lon)):
            self._say("the fix is not finite, so that it is not used")
            return
        placed = PlacedFix(
            *self.tiles.metres(fix.lat, fix.lon), deviation_of(fix.accuracy_m), self.time_s
        )
        share = placed.share_after(self._fix.time_s) if self._fix else 1.0
        self._fix = placed
        self._since_fix_m, self._fix_share = 0.0, self._fix_share + share
        if self.hypotheses:
            self._count_fix(placed, share)

    def _count_fix(self, fix: PlacedFix, share: float) -> None:
        """Weigh the hypotheses by a fix that counts as such a share."""
        weighed = []
        for one in self.hypotheses:
            likely = fix.likelihood(one.states[:, :2])
            after, evidence = one.weighed(share * np.log(likely))
            weighed.append(replace(after, probability=one.probability * math.exp(evidence)))
        self._fix_evidence *= sum(one.probability for one in weighed)
        self.hypotheses = normalised(weighed)

    def _fresh_fix(self) -> PlacedFix | None:
        """The last fix, if it is news since the last search or the camera has hardly moved since.

        Odometry knows better where a camera has gone than that it is not where a fix once was.
        """
        if self._fix is None:
            return None
        fresh = self._fix_share > 0.0 or self._since_fix_m <= self._fix.deviation_m
        return self._fix.after(self._since_fix_m) if fresh else None

    def _look(self, image: Picture | None) -> bool:
        """Weigh the belief by an image; whether there was one."""
        ground = None
        if image is not None:
            try:
                ground = only(self.localizer.encode_ground(image))
            except ImageError as error:
                self._say(f"the image is not used: {error}")
        if not self.hypotheses:
            self._begin(ground)
            return ground is not None
        if ground is None:
            return False
        settings = self.settings
        share = min(1.0, max(self._way_m / settings.independent_m, settings.standing))
        self.hypotheses = [
            replace(one, waiting=min(1.0, one.waiting + share)) for one in self.hypotheses
        ]
        turn = sorted(self.hypotheses[1:], key=lambda one: -one.waiting)
        turn = [self.hypotheses[0], *turn[: OTHERS_IN_DOUBT if self._in_doubt else OTHERS]]
        scores = [self._scores(ground, one) for one in turn]
        best = max((float(some.max()) for some in scores if some is not None), default=0.0)
        if any(some is None for some in scores):
            self._say("the map ends here, so that the belief goes on by odometry alone")
        weighed = [one for one in self.hypotheses if all(one is not other for other in turn)]
        for one, some in zip(turn, scores, strict=True):
            if some is None:  # no more likely than a place that looks otherwise
                some = np.full(len(one.weights), -math.inf)
            after, evidence = one.weighed(one.waiting * np.log(self._likelihood(some, best)))
            evidence *= settings.independent_m / settings.same_sight_m
            probability = one.probability * math.exp(evidence)
            weighed.append(replace(after, probability=probability, waiting=0.0))
        belief = [
            (one.probability * one.weights, some)
            for one, some in zip(turn, scores, strict=True)
            if some is not None
        ]
        self.hypotheses = normalised(weighed)
        if self.time_s >= self._search_due_s:
            self._search(ground, belief)
        return True

    def _scores(self, ground: Tensor, one: Hypothesis) -> Floats | None:
        """Scores [P] of a hypothesis's particles; None where there is no map."""
        mean, spread = one.mean(), np.sqrt(np.diag(one.covariance()))
        tile = self.tiles.at(mean[0], mean[1])
        if tile is None:
            return None
        poses = tile.poses(one.states[:, :3])
        middle = tile.poses(mean[None])[0]
        reach = DEVIATIONS * spread / [tile.side_m, tile.side_m, 1.0]
        if max(reach[0], reach[1]) > DEVIATIONS * WIDE_SHARE:
            return self.scorer.whole(ground, tile.scored).at(poses)
        return self.scorer.around(ground, tile.scored, middle, reach).at(poses)

    def _begin(self, ground: Tensor | None) -> None:
        """The first belief: what the first image says within what is known of the place."""
        settings = self.settings
        search, fix = None, self._fix
        if ground is not None:
            search = self.elsewhere.search(ground, [], fix, self._fix_share)
        if search is not None:
            likely = self._in_tile(search.scores, search.scores)
            self.hypotheses = search.hypotheses(likely, 1.0, settings.other_particles)
            self.hypotheses = normalised(merged(self.hypotheses))
        else:
            lacks = "first image" if ground is None else "map at the start"
            self._say(f"there is no {lacks}, so that the belief is what was known before")
        if not self.hypotheses:
            self.hypotheses = [self.elsewhere.blind(4 * settings.particles)]
            self.elsewhere.probability = START_ELSEWHERE
            if fix is not None:
                self._count_fix(fix, self._fix_share)
        if search is not None:
            self._fix_evidence, self._fix_share = 1.0, 0.0

    def _search(self, ground: Tensor, belief: list[tuple[Floats, Floats]]) -> None:
        """Search the whole tile; by Bayes' rule, how likely it is that the camera is elsewhere.

        The evidence of that is the mean likelihood over the tile's candidates, against that over
        the particles before the image.
        """
        settings, elsewhere = self.settings, self.elsewhere
        fix = self._fresh_fix()
        search = elsewhere.search(ground, self.hypotheses, fix, min(1.0, self._fix_share))
        if search is not None:
            share = min(1.0, max(self._unsearched_m / settings.same_sight_m, settings.standing))
            there = self._in_tile(search.scores, search.scores) ** share
            here = settings.says_nothing**share  # where there is no map
            if belief:
                weights, scores = (np.concatenate(part) for part in zip(*belief, strict=True))
                suits = self._in_tile(scores, search.scores) ** share
                here = float(weights @ suits / weights.sum())
            lost = elsewhere.probability * search.fix_evidence * float(search.prior @ there)
            kept = (1.0 - elsewhere.probability) * self._fix_evidence * here
            lost = min(max(lost / (lost + kept), settings.least_elsewhere), MOST_ELSEWHERE)
            found = search.hypotheses(there, lost, settings.other_particles)
            known = [
                replace(one, probability=one.probability * (1.0 - lost)) for one in self.hypotheses
            ]
            self.hypotheses = normalised(known + found)
            self._unsearched_m, self._fix_evidence, self._fix_share = 0.0, 1.0, 0.0
        pause_s = settings.doubt_search_s if self._in_doubt else settings.search_s
        self._search_due_s = self.time_s + pause_s

    @property
    def _in_doubt(self) -> bool:
        return self.hypotheses[0].probability * (1.0 - self.elsewhere.probability) < CERTAIN

    def _likelihood(self, scores: Floats, most: float) -> Floats:
        """How likely places are by their scores, against the best one."""
        return np.asarray(np.exp((scores - most) / self.temperature) + self.settings.outliers)

    def _in_tile(self, scores: Floats, of_tile: Floats) -> Floats:
        """How likely places are by their scores, against the mean of a tile's candidates [K]."""
        most = float(of_tile.max())
        mean = float(np.exp((of_tile - most) / self.temperature).mean())
        says = np.exp((scores - most) / self.temperature) / mean
        return np.asarray((1.0 - self.settings.says_nothing) * says + self.settings.says_nothing)

    def _resample(self) -> None:
        settings = self.settings
        for number, one in enumerate(self.hypotheses):
            count = settings.other_particles if number else settings.particles
            if len(one.weights) != count or one.effective() < count / 2:
                self.hypotheses[number] = one.resampled(count, self.rng)

    def _encode_ahead(self) -> None:
        best = self.hypotheses[0].mean()
        way_m = self._odometry.speed_mps * self.settings.ahead_s
        angle = math.radians(best[HEADING])
        self.tiles.ahead(best[0] + way_m * math.sin(angle), best[1] + way_m * math.cos(angle))

    def _estimate(self, seen: bool) -> TrackEstimate:
        modes = []
        least = np.diag([self.settings.registration_m**2] * 2 + [0.0])
        for one in self.hypotheses:
            east_m, north_m, heading_deg = one.mean().tolist()
            lat, lon = self.tiles.globe(east_m, north_m)
            heading_deg = (heading_deg - self.tiles.turn_deg(lat, lon)) % 360.0
            modes.append(
                TrackMode(
                    lat,
                    lon,
                    heading_deg,
                    one.covariance() + least,
                    one.probability * (1.0 - self.elsewhere.probability),
                    east_m,
                    north_m,
                )
            )
        best = self.hypotheses[0]
        return TrackEstimate(
            self.time_s,
            tuple(modes),
            seen,
            tuple(dict.fromkeys(self._notes)),
            float(best.weights @ best.states[:, SCALE]),
            float(best.weights @ best.states[:, BIAS]),
        )

    def _say(self, note: str) -> None:
        self._notes.append(note)
