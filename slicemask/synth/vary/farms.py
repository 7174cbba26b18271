"""Farm yards: barns, silos, gravel."""

import numpy as np
from numpy.typing import NDArray
from shapely.geometry import Polygon

from slicemask.synth.layout.elements import Area, Building, Facade, Kind, Landmark, Plan
from slicemask.synth.layout.palette import vary_colour
from slicemask.synth.layout.streets import rectangle
from slicemask.synth.vary.dwellings import BOARDS, SHEET


def build_farm(
    lot: Polygon,
    entry: NDArray[np.float64],
    inward: NDArray[np.float64],
    plan: Plan,
    rng: np.random.Generator,
) -> None:
    """Build barns on a lot, around a yard that a track joins to the road at `entry`."""
    along = np.array([inward[1], -inward[0]])
    track = rectangle(entry + inward * 12.0, inward, 24.5, rng.uniform(3, 7))
    yard = rectangle(entry + inward * 24.0, along, rng.uniform(14, 24), rng.uniform(10, 18))
    colour = vary_colour(rng, ((0.62, 0.57, 0.49), (0.50, 0.41, 0.32)))
    plan.areas.append(Area(track.union(yard), Kind.GRAVEL, colour, 0.018))
    walls = ((0.50, 0.20, 0.16), *SHEET, *BOARDS)
    for side in (-1, 1):
        barn = rectangle(
            entry + inward * rng.uniform(15, 34) + side * along * rng.uniform(8, 10),
            inward if rng.random() < 0.6 else along,
            rng.uniform(9, 20),
            rng.uniform(6, 9),
        )
        if lot.contains(barn) and not barn.intersects(track):
            facade = Facade(vary_colour(rng, walls), (0.3, 0.3, 0.3), (0.3, 0.3, 0.3), width=0.0)
            plan.buildings.append(
                Building(barn, float(rng.uniform(3, 6)), facade, vary_colour(rng, SHEET), "gable")
            )
    if rng.random() < 0.5:
        x, y = (entry + inward * rng.uniform(26, 38) + along * rng.uniform(-4, 4)).tolist()
        plan.landmarks.append(
            Landmark(x, y, "column", float(rng.uniform(5, 14)), float(rng.uniform(1.5, 3)),
                     vary_colour(rng, ((0.72, 0.73, 0.74), (0.85, 0.85, 0.84))))
        )  # fmt: skip
