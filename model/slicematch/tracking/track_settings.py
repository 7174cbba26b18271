"""How a tracker goes about it."""

import math
from dataclasses import dataclass, field

from slicematch.errors import ConfigError
from slicematch.tracking.odometry import MotionNoise


@dataclass(frozen=True)
class TrackSettings:
    """What a tracker takes for likely, and how much it does.

    Attributes
    ----------
    particles, other_particles : int
        Of the likeliest hypothesis, and of each other one.
    independent_m : float
        Scores of neighbouring frames are wrong alike, for they see the same street in the same
        map. A frame counts as the share of this way that the camera has gone since the last one,
        so that an ellipse holds what it says.
    same_sight_m : float
        The same of the choice between hypotheses: a place that looks like another one does so for
        as long as the same buildings are in sight.
    standing : float
        What a frame counts at least, for a camera that stands.
    outliers : float
        How likely a place is at least, against the best one, whatever its score: how often an
        image says nothing of its place.
    says_nothing : float
        How often an image suits all places of a tile alike, where it is searched.
    least_elsewhere : float
        How likely it is at least, after a search, that the camera is at none of the places that are
        followed: images of a street can be wrong together for longer than any model of them says.
    registration_m : float
        What no number of frames averages out, for it is the same along a street: how far a map lies
        off the ground, and a model's answers off the truth. It is added to the covariance of
        estimates, as a standard deviation to the east and to the north.
    search_s, doubt_search_s : float
        How often the whole tile is searched for better places, and how often where the belief is
        in doubt.
    ahead_s : float
        How long before the camera comes there a tile is encoded.
    noise : MotionNoise
        How far off odometry is.
    seed : int
        The same images and the same seed give the same answers.
    """

    particles: int = 800
    other_particles: int = 100
    independent_m: float = 2.2
    same_sight_m: float = 10.0
    standing: float = 0.01
    outliers: float = 0.05
    says_nothing: float = 0.1
    least_elsewhere: float = 0.05
    registration_m: float = 0.45
    search_s: float = 1.0
    doubt_search_s: float = 0.5
    ahead_s: float = 3.0
    noise: MotionNoise = field(default_factory=MotionNoise)
    seed: int = 0

    def __post_init__(self) -> None:
        if min(self.particles, self.other_particles) < 10:
            raise ConfigError(
                f"there are {self.particles} and {self.other_particles} particles; each must be 10 "
                "or more"
            )
        for name in ("independent_m", "same_sight_m", "search_s", "doubt_search_s", "ahead_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ConfigError(f"{name} is {value:g}; it must be above 0")
        for name in ("standing", "outliers", "says_nothing", "least_elsewhere"):
            value = getattr(self, name)
            if not 0 < value < 1:
                raise ConfigError(f"{name} is {value:g}; it must be between 0 and 1")
