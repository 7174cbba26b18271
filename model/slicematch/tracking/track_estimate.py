"""What a tracker answers at a frame: a pose on the globe, how sure it is, and what went wrong."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slicematch.localization.probabilities import ellipse

Floats = NDArray[np.float64]

# Less likely estimates are in doubt; after a search other places together have 5 % at least.
SURE = 0.8
# Less likely modes, but for the first, are not shown.
NOTABLE = 0.02


@dataclass(frozen=True)
class TrackMode:
    """One of the places where the camera may be.

    Attributes
    ----------
    lat, lon : float
        Degrees on WGS 84.
    heading_deg : float
        Clockwise from north, in [0, 360).
    covariance : float64 [3, 3]
        Of east, north (metres) and heading (degrees).
    probability : float
        That it is the right one of all.
    east_m, north_m : float
        In the frame of the drive: azimuthal equidistant around its origin.
    """

    lat: float
    lon: float
    heading_deg: float
    covariance: Floats
    probability: float
    east_m: float
    north_m: float


@dataclass(frozen=True)
class TrackEstimate:
    """A tracker's belief at a frame.

    Attributes
    ----------
    time_s : float
        Since the tracker's start.
    modes : tuple of TrackMode
        The likeliest first; the answer is the first one.
    seen : bool
        Whether the frame's image was used.
    notes : tuple of str
        What went wrong at this frame and what was done instead, a sentence each.
    speed_scale, yaw_bias_dps : float
        What was found of the odometry: by what its speeds are to be multiplied, and what its yaw
        rate says too much.
    """

    time_s: float
    modes: tuple[TrackMode, ...]
    seen: bool
    notes: tuple[str, ...] = ()
    speed_scale: float = 1.0
    yaw_bias_dps: float = 0.0

    @property
    def lat(self) -> float:
        """Latitude of the answer, degrees on WGS 84."""
        return self.modes[0].lat

    @property
    def lon(self) -> float:
        """Longitude of the answer, degrees on WGS 84."""
        return self.modes[0].lon

    @property
    def heading_deg(self) -> float:
        """Heading of the answer, degrees clockwise from north, in [0, 360)."""
        return self.modes[0].heading_deg

    @property
    def covariance(self) -> Floats:
        """Of east, north (metres) and heading (degrees), float64 [3, 3], if its mode is right."""
        return self.modes[0].covariance

    @property
    def probability(self) -> float:
        """That its mode is the right one."""
        return self.modes[0].probability

    @property
    def sure(self) -> bool:
        """Whether the answer's mode is likely to be the right one."""
        return self.probability > SURE

    @property
    def notable(self) -> tuple[TrackMode, ...]:
        """The answer's mode, and the others that are not too unlikely to be shown."""
        return self.modes[:1] + tuple(one for one in self.modes[1:] if one.probability >= NOTABLE)

    def as_row(self) -> dict[str, Any]:
        """The estimate as one flat row, rounded to what can matter."""
        mode, covariance = self.modes[0], self.covariance
        major_m, minor_m, azimuth_deg = ellipse(covariance[:2, :2])
        east_m, north_m, heading_deg = np.sqrt(np.diag(covariance)).tolist()
        names = ("ee", "en", "eh", "nn", "nh", "hh")
        upper = covariance[np.triu_indices(3)].tolist()
        return {
            "time_s": round(self.time_s, 6),
            "lat": round(mode.lat, 9),
            "lon": round(mode.lon, 9),
            "heading_deg": round(mode.heading_deg, 3) % 360.0,
            "probability": round(mode.probability, 5),
            "std_east_m": round(east_m, 3),
            "std_north_m": round(north_m, 3),
            "std_heading_deg": round(heading_deg, 3),
            "ellipse_major_m": round(major_m, 3),
            "ellipse_minor_m": round(minor_m, 3),
            "ellipse_azimuth_deg": round(azimuth_deg, 3),
            **{f"cov_{name}": round(value, 6) for name, value in zip(names, upper, strict=True)},
            "east_m": round(mode.east_m, 3),
            "north_m": round(mode.north_m, 3),
            "seen": int(self.seen),
            "notes": "; ".join(self.notes),
        }

    def holds(self, east_m: float, north_m: float, confidence: float = 0.95) -> bool:
        """Whether the ellipse of the confidence holds a place of the drive's frame."""
        away = np.array([east_m - self.modes[0].east_m, north_m - self.modes[0].north_m])
        square = away @ np.linalg.solve(self.covariance[:2, :2], away)
        return bool(square <= -2.0 * math.log1p(-confidence))
