"""How far a track is off where the truth is known."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from slicematch.digits import digits
from slicematch.localization.geodesy import offset_m
from slicematch.tracking.outputs import Track

Truth = tuple[float, float, float]  # latitude, longitude, heading_deg (NaN if unknown)
# Until then a track is being found.
SETTLED_S = 10.0
# Beyond this a place is in another street.
STREET_M = 15.0


@dataclass(frozen=True)
class TrackErrors:
    """Errors of a track after its first `SETTLED_S`, or of all of a shorter one.

    Attributes
    ----------
    frames : int
        With a truth.
    place_median_m, place_95_m : float
        Half of the places, and 95 in a hundred, are off by less.
    heading_median_deg : float or None
    wrong_street : float
        Share of the frames that are more than `STREET_M` off.
    inside_ellipse : float
        Share of the truths that lie in the ellipse of 95 %.
    """

    frames: int
    place_median_m: float
    place_95_m: float
    heading_median_deg: float | None
    wrong_street: float
    inside_ellipse: float

    @classmethod
    def of(cls, track: Track, truths: Sequence[Truth | None]) -> "TrackErrors | None":
        """The errors of a track; None if no truth is known."""
        known = [k for k, truth in enumerate(truths) if truth is not None]
        begin_s = track.times_s[0] + SETTLED_S
        settled = [k for k in known if track.times_s[k] >= begin_s]
        chosen = settled or known
        if not chosen:
            return None
        places, headings, inside = [], [], []
        for k in chosen:
            one, truth = track.estimates[k], truths[k]
            assert truth is not None
            places.append(math.hypot(*offset_m(truth[:2], (one.lat, one.lon))))
            headings.append(abs((one.heading_deg - truth[2] + 180.0) % 360.0 - 180.0))
            inside.append(one.holds(*offset_m(track.origin, truth[:2])))
        turned = [value for value in headings if not math.isnan(value)]
        return cls(
            len(chosen),
            float(np.median(places)),
            float(np.percentile(places, 95)),
            float(np.median(turned)) if turned else None,
            float(np.mean(np.array(places) > STREET_M)),
            float(np.mean(inside)),
        )

    def as_dict(self) -> dict[str, Any]:
        """As plain values."""
        return asdict(self)

    def __str__(self) -> str:
        return self.report()

    def report(self) -> str:
        """A line of text."""
        turned = self.heading_median_deg
        heading = "" if turned is None else f", {digits(turned)} degrees at the median"
        return (
            f"off by {self.place_median_m:.2f} m at the median and less than {self.place_95_m:.2f} "
            f"m in 95 % of {self.frames:,} frames{heading}; in another street (over "
            f"{STREET_M:g} m) in {self.wrong_street:.1%}; the ellipses of 95 % hold "
            f"{self.inside_ellipse:.0%}"
        )
