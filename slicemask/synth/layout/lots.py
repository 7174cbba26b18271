"""Land cut into lots, and rectangles that fit into them."""

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from slicemask.synth.layout.streets import rectangle

KERB_M = 0.12
# Grounds lie on one another in layers, so that none has to be cut out of the one below.
LOT_M, PATH_M, PAINT_M = KERB_M + 0.02, KERB_M + 0.04, KERB_M + 0.06


def oriented_bounds(
    polygon: BaseGeometry,
) -> tuple[NDArray[np.float64], NDArray[np.float64], float, float]:
    """Centre, direction of the long side, length and width of the smallest rectangle around."""
    corners = shapely.get_coordinates(shapely.minimum_rotated_rectangle(polygon))[:4]
    sides = corners[1] - corners[0], corners[2] - corners[1]
    lengths = [float(np.hypot(*side)) for side in sides]
    long = int(lengths[1] > lengths[0])
    return corners.mean(axis=0), sides[long] / lengths[long], lengths[long], lengths[1 - long]


def split(polygon: Polygon, area_m2: float, rng: np.random.Generator) -> list[Polygon]:
    """Cut a polygon across its long side, again and again, into lots of about an area."""
    if polygon.area < 1.5 * area_m2:
        return [polygon]
    centre, along, length, width = oriented_bounds(polygon)
    cut = centre + along * length * rng.uniform(-0.1, 0.1)
    reach = length + width
    lots: list[Polygon] = []
    for side in (-1, 1):
        half = rectangle(cut + side * along * reach / 2, along, reach, 2 * reach)
        for part in shapely.get_parts(shapely.intersection(polygon, half)):
            if isinstance(part, Polygon) and part.area > 15.0:
                lots += split(part, area_m2, rng)
    return lots


def largest(shape: BaseGeometry) -> Polygon | None:
    """Give the largest polygon of a shape; None if it has none."""
    parts = [part for part in shapely.get_parts(shape) if isinstance(part, Polygon)]
    return max(parts, key=lambda part: part.area, default=None)


def fit(
    lot: Polygon, length: float, width: float, gap_m: float, rng: np.random.Generator
) -> Polygon | None:
    """Give a rectangle of at most this size inside a lot, along the lot's own sides."""
    centre, along, *_ = oriented_bounds(lot)
    anchor = shapely.get_coordinates(lot.centroid)[0] * 0.5 + centre * 0.5
    room = lot.buffer(-gap_m)
    for shrink in (1.0, 0.85, 0.7, 0.55):
        for _ in range(3):
            candidate = rectangle(
                anchor + rng.normal(0, 1.0, 2), along, length * shrink, width * shrink
            )
            if room.contains(candidate):
                return candidate
    return None
