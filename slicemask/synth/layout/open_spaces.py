"""Car parks, parks, courts and landmarks."""

import numpy as np
import shapely
from shapely.geometry import LineString, Polygon
from shapely.geometry.base import BaseGeometry

from slicemask.synth.layout.elements import Area, Kind, Landmark, Plan, Slot
from slicemask.synth.layout.greenery import plant
from slicemask.synth.layout.lots import LOT_M, PAINT_M, PATH_M, fit, largest, oriented_bounds
from slicemask.synth.layout.palette import BRIGHT, CONCRETE, vary_colour
from slicemask.synth.layout.streets import WHITE, Style, rectangle


def parking_lot(ground: BaseGeometry, plan: Plan, rng: np.random.Generator) -> None:
    """Lay a car park with marked rows over a polygon."""
    polygon = largest(ground)
    if polygon is None:
        return
    shade = rng.uniform(0.24, 0.38)
    plan.areas.append(Area(polygon, Kind.ASPHALT, (shade, shade, shade * 1.02), PATH_M))
    centre, along, length, width = oriented_bounds(polygon)
    left = np.array([-along[1], along[0]])
    room = polygon.buffer(-0.4)
    busy = rng.uniform(0.2, 0.8)
    for row in np.arange(-width / 2 + 2.8, width / 2 - 2.0, 8.2):
        for slot in np.arange(-length / 2 + 1.6, length / 2 - 1.0, 2.7):
            place = centre + along * slot + left * row
            if not room.contains(rectangle(place, left, 5.0, 2.6)):
                continue
            for side in (-1.35, 1.35):
                line = rectangle(place + side * along, left, 4.8, 0.12)
                plan.areas.append(Area(line, Kind.PLAIN, WHITE, PAINT_M))
            heading = np.degrees(np.arctan2(left[0], left[1])) + 180.0 * rng.integers(2)
            x, y = place.tolist()
            plan.slots.append(Slot(x, y, float(heading % 360.0), busy))


def lay_out_park(lot: Polygon, style: Style, plan: Plan, rng: np.random.Generator) -> None:
    """Grass, paths, trees, and a pond, a court or a landmark."""
    plan.areas.append(Area(lot, Kind.GRASS, vary_colour(rng, (style.grass,)), LOT_M))
    centre = shapely.get_coordinates(lot.centroid)[0]
    rim = lot.exterior
    paths = [rim.buffer(0.9)]
    start = rng.random()
    for position in start + np.arange(rng.integers(3, 7)) / 6.0:
        end = shapely.get_coordinates(rim.interpolate(position % 1.0, normalized=True))[0]
        bow = (centre + end) / 2 + rng.normal(0, 3.0, 2)
        paths.append(LineString([centre, bow, end]).buffer(rng.uniform(0.7, 1.2)))
    square = shapely.Point(centre).buffer(rng.uniform(3.0, 6.0))
    walks = shapely.union_all([*paths, square]).intersection(lot)
    colour = vary_colour(rng, ((0.66, 0.58, 0.44), CONCRETE, (0.55, 0.42, 0.34)))
    for part in shapely.get_parts(walks):
        plan.areas.append(Area(part, Kind.PAVING, colour, PATH_M))
    free = lot.difference(walks.buffer(0.8))
    patches = sorted(
        (part for part in shapely.get_parts(free) if isinstance(part, Polygon)),
        key=lambda part: -part.area,
    )
    for part in patches[:3]:
        what = rng.random()
        if what < 0.35 and part.area > 300:
            court = fit(part, 24, 12, 1.0, rng)
            if court is not None:
                _court(court, plan, rng)
                free = free.difference(court.buffer(2.0))
        elif what < 0.6 and part.area > 150:
            pond = largest(part.buffer(-3.0))
            if pond is not None:
                pond = pond.buffer(-2).buffer(2)
                for water in shapely.get_parts(pond):
                    plan.areas.append(Area(water, Kind.WATER, (0.16, 0.30, 0.34), PATH_M))
                free = free.difference(pond.buffer(2.0))
    add_landmark(plan, shapely.Point(centre).buffer(2.0), rng)
    plant(plan, free, int(lot.area / 75 * style.tree_density), style, rng)


def _court(court: Polygon, plan: Plan, rng: np.random.Generator) -> None:
    """A playing field: a coloured ground with white lines."""
    colour = vary_colour(rng, ((0.55, 0.25, 0.18), (0.16, 0.36, 0.50), (0.20, 0.42, 0.26)))
    plan.areas.append(Area(court, Kind.PLAIN, colour, PATH_M))
    lines = court.buffer(-0.8, join_style="mitre")
    centre, along, _, width = oriented_bounds(lines)
    painted = lines.difference(lines.buffer(-0.15, join_style="mitre")).union(
        rectangle(centre, along, 0.15, width)
    )
    ring = shapely.Point(centre).buffer(2.2)
    for part in shapely.get_parts(painted.union(ring.difference(ring.buffer(-0.15)))):
        plan.areas.append(Area(part, Kind.PLAIN, WHITE, PAINT_M))


def add_landmark(plan: Plan, where: BaseGeometry, rng: np.random.Generator) -> None:
    """Set up a landmark in an area, where there is room for one."""
    room = where.buffer(-1.5)
    if room.is_empty:
        return
    point = room.representative_point()
    shape = str(rng.choice(["column", "dome", "pylon", "kiosk"]))
    height = {"column": 9.0, "dome": 3.6, "pylon": 14.0, "kiosk": 3.0}[shape]
    radius = {"column": 0.9, "dome": 2.4, "pylon": 1.2, "kiosk": 1.6}[shape]
    size = rng.uniform(0.8, 1.3)
    plan.landmarks.append(
        Landmark(
            point.x,
            point.y,
            shape,
            float(height * size),
            float(radius * size),
            vary_colour(rng, BRIGHT),
        )
    )
