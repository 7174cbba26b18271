"""Satellite fixes along a drive: weak evidence of the place, for their errors last for seconds.

Beside buildings a reflected signal sets all fixes of half a minute off to the same side. So fixes
do not average: each one counts as the share that its time since the last one has of `LASTS_S`. Nor
does a receiver know how far off it is: errors are taken to have the heavy tail of Student's t
distribution, and none of them rules a place out.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# How long an error goes on.
LASTS_S = 20.0
# Of a fix that does not say how accurate it is, metres; and what none is better than, for maps lie
# off, too.
ACCURACY_M, LEAST_M = 20.0, 2.0
# Degrees of freedom: of 100 fixes 6 are off by 4 of their deviations or more, and 1 by 8.
FREEDOM = 3.0
# How likely a place is at least, against the likeliest one, and what all places of a tile hold at
# least together: receivers also hold on to a place where they are not any more.
WRONG = 1e-4


@dataclass(frozen=True)
class PlacedFix:
    """A fix in the frame of a drive.

    Attributes
    ----------
    east_m, north_m : float
    deviation_m : float
        Of it, to the east and to the north, as the receiver claims: the scale of the distribution,
        within which three in five are to each side.
    time_s : float
        When it was.
    """

    east_m: float
    north_m: float
    deviation_m: float
    time_s: float

    def likelihood(self, places: Floats) -> Floats:
        """How likely places [P, 2] (east_m, north_m) are by it, against the fix's own: [P]."""
        return (1.0 - WRONG) * self._density(places) + WRONG

    def share_after(self, before_s: float) -> float:
        """What it counts as, where the last one that counted was at that time."""
        return min(1.0, max(0.0, self.time_s - before_s) / LASTS_S)

    def after(self, way_m: float) -> "PlacedFix":
        """What it still says where the camera has gone so far since, nobody knows which way."""
        return replace(self, deviation_m=math.hypot(self.deviation_m, way_m))

    def prior(self, places: Floats, area_m2: float) -> Floats:
        """Probabilities of places [P, 2] that stand for so much ground each: at most 1 in all.

        What is missing to 1 lies elsewhere.
        """
        shares = self._density(places) * area_m2 / (2.0 * math.pi * self.deviation_m**2)
        shares /= max(1.0, float(shares.sum()))
        return (1.0 - WRONG) * shares + WRONG / len(places)

    def _density(self, places: Floats) -> Floats:
        """Student's t distribution in two dimensions at places [P, 2], 1 at its top.

        Lange, Little, Taylor, *Robust Statistical Modeling Using the t Distribution*, JASA 1989.
        """
        away_m = np.hypot(places[:, 0] - self.east_m, places[:, 1] - self.north_m)
        squared = (away_m / self.deviation_m) ** 2
        return np.asarray((1.0 + squared / FREEDOM) ** -((FREEDOM + 2.0) / 2.0))


def deviation_of(accuracy_m: float | None) -> float:
    """The deviation that a fix is taken to claim, metres."""
    if accuracy_m is None or not math.isfinite(accuracy_m) or accuracy_m <= 0:
        return ACCURACY_M
    return max(accuracy_m, LEAST_M)
