"""A whole city laid out from a seed: streets, blocks, street trees, lamps and two sets of cars."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString, Polygon

from slicemask.synth.layout.blocks import fill_block
from slicemask.synth.layout.elements import (
    CAR_BODIES,
    Area,
    Backdrop,
    Building,
    Car,
    Colour,
    Kind,
    Landmark,
    Plan,
    Slot,
    Tree,
)
from slicemask.synth.layout.greenery import draw_tree
from slicemask.synth.layout.palette import BRIGHT, vary_colour
from slicemask.synth.layout.streets import (
    LANE_M,
    PARKING_M,
    Street,
    Style,
    free_pieces,
    lay_streets,
    paint_markings,
    point_and_direction,
    rectangle,
)

CAR_COLOURS: tuple[Colour, ...] = (
    (0.85, 0.85, 0.86), (0.60, 0.61, 0.63), (0.12, 0.12, 0.13), (0.30, 0.31, 0.33),
    (0.55, 0.08, 0.08), (0.10, 0.18, 0.38), (0.72, 0.70, 0.62), (0.15, 0.30, 0.22),
    (0.85, 0.65, 0.10), (0.35, 0.50, 0.62),
)  # fmt: skip
MARKING_M = 0.012
# No car of the ground view stands nearer to a camera than this.
CLEAR_M = 5.5


@dataclass(frozen=True)
class City:
    """A city as laid out. Metres, x east, y north, z up, the centre at (0, 0).

    Parameters
    ----------
    half_extent_m
        The city is the square that reaches this far from its centre; fields lie beyond.
    style
        What its parts have in common.
    streets, areas, buildings, trees, landmarks
        Its parts; `areas` lie on the base.
    lamps
        Street lamps: x, y and the heading of the arm, degrees.
    cars_aerial, cars_ground
        The cars that stand in the aerial view, and those of the ground view: most parked ones are
        the same, those on the lanes differ.
    base
        What shows where no area lies, which is the streets: its kind and colour.
    islands
        Of roundabouts, around which lanes end.
    backdrops
        What stands around it, far off.
    """

    half_extent_m: float
    style: Style
    streets: tuple[Street, ...]
    areas: tuple[Area, ...]
    buildings: tuple[Building, ...]
    trees: tuple[Tree, ...]
    landmarks: tuple[Landmark, ...]
    cars_aerial: tuple[Car, ...]
    cars_ground: tuple[Car, ...]
    lamps: tuple[tuple[float, float, float], ...] = ()
    base: tuple[Kind, Colour] = (Kind.ASPHALT, (0.30, 0.30, 0.31))
    islands: tuple[Polygon, ...] = ()
    backdrops: tuple[Backdrop, ...] = ()

    def drives(self) -> list[LineString]:
        """The middle of every lane, in the direction of travel, inside the city."""
        lanes = [street.drive(lane) for street in self.streets for lane in range(street.lanes)]
        if not self.islands:
            return lanes
        closed = shapely.union_all(self.islands).buffer(1.5)
        parts = shapely.get_parts(shapely.difference(np.array(lanes, dtype=object), closed))
        return [part for part in parts if isinstance(part, LineString) and part.length > 1.0]

    def heading_deg(self, x: float, y: float) -> float:
        """Where a car at a place heads: along the nearest lane, clockwise from north."""
        drives = self.drives()
        point = shapely.Point(x, y)
        nearest = drives[int(np.argmin(shapely.distance(np.array(drives, dtype=object), point)))]
        return _heading(point_and_direction(nearest, nearest.project(point))[1])

    def clear_of_cars(self, places: NDArray[np.float64]) -> "City":
        """Take the cars of the ground view away from cameras' places, float64 [n, 2]."""
        cars = self.cars_ground
        if not cars or not len(places):
            return self
        tree = shapely.STRtree(shapely.points(places))
        spots = shapely.points([(car.x, car.y) for car in cars])
        near = set(tree.query(spots, predicate="dwithin", distance=CLEAR_M)[0].tolist())
        kept = tuple(car for number, car in enumerate(cars) if number not in near)
        return replace(self, cars_ground=kept)


def lay_out_city(seed: int | Sequence[int], half_extent_m: float) -> City:
    """Lay out a city. The same seed and extent give the same city.

    Parameters
    ----------
    seed : int or sequence of int
        The layout's seed.
    half_extent_m : float
        The city reaches this far from its centre to all four sides.
    """
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(5)]
    style_rng, street_rng, block_rng, kerb_rng, car_rng = streams
    style = Style.draw(style_rng, half_extent_m)
    streets = lay_streets(style, half_extent_m, street_rng)
    plan = Plan()
    for block in land_between(streets, half_extent_m):
        fill_block(block, style, plan, block_rng)
    lamps: list[tuple[float, float, float]] = []
    slots: list[Slot] = []
    for street, piece in free_pieces(streets):
        for polygon, colour in paint_markings(style, street, piece, street_rng):
            plan.areas.append(Area(polygon, Kind.PLAIN, colour, MARKING_M))
        slots += _kerb_slots(street, piece, kerb_rng)
        lamps += _line_kerbs(street, piece, style, plan, kerb_rng)
    parked = plan.slots + slots
    cars = park_cars(parked, streets, car_rng)
    return city_of(plan, half_extent_m, style, streets, cars, lamps=tuple(lamps))


def city_of(
    plan: Plan,
    half_extent_m: float,
    style: Style,
    streets: Sequence[Street],
    cars: tuple[list[Car], list[Car]],
    **others: Any,
) -> City:
    """The layout of a plan; `cars` are those from above, and at ground."""
    cars_aerial, cars_ground = cars
    return City(
        half_extent_m=half_extent_m,
        style=style,
        streets=tuple(streets),
        areas=tuple(area for area in plan.areas if area.polygon.area > 1e-3),
        buildings=tuple(plan.buildings),
        trees=tuple(plan.trees),
        landmarks=tuple(plan.landmarks),
        cars_aerial=tuple(cars_aerial),
        cars_ground=tuple(cars_ground),
        **others,
    )


def land_between(
    streets: list[Street],
    half_extent_m: float,
    radius_m: float = 3.0,
    circles: Sequence[Polygon] = (),
) -> list[Polygon]:
    """The land between the carriageways and the grounds of roundabouts, with rounded corners."""
    square = shapely.box(-half_extent_m, -half_extent_m, half_extent_m, half_extent_m)
    roads = shapely.union_all([*(street.carriageway for street in streets), *circles])
    land = square.difference(roads).buffer(-radius_m, quad_segs=3).buffer(radius_m, quad_segs=3)
    return [part for part in shapely.get_parts(land) if isinstance(part, Polygon)]


def _kerb_slots(street: Street, piece: LineString, rng: np.random.Generator) -> list[Slot]:
    """Places to park along both kerbs of a stretch."""
    if not street.parking:
        return []
    slots = []
    aside = LANE_M + PARKING_M / 2 + 0.2
    for line in (piece, piece.reverse()):
        busy = rng.uniform(0.15, 0.85)
        for along_m in np.arange(11.0, piece.length - 10.0, 5.9):
            point, along = point_and_direction(line, along_m + rng.uniform(-0.3, 0.3))
            x, y = (point + aside * np.array([along[1], -along[0]])).tolist()
            slots.append(Slot(x, y, _heading(along), busy))
    return slots


def _heading(along: NDArray[np.float64]) -> float:
    return float(np.degrees(np.arctan2(along[0], along[1])) % 360.0)


def _line_kerbs(
    street: Street, piece: LineString, style: Style, plan: Plan, rng: np.random.Generator
) -> list[tuple[float, float, float]]:
    """Plant street trees and set lamps along a stretch; kiosks stand on a few corners."""
    lamps = []
    for line in (piece, piece.reverse()):
        every = rng.uniform(8.0, 15.0)
        planted = rng.random() < 0.6 * style.tree_density
        for number, along_m in enumerate(np.arange(8.0, piece.length - 7.0, every)):
            point, along = point_and_direction(line, along_m)
            right = np.array([along[1], -along[0]])
            x, y = (point + right * (street.width_m / 2 + 1.0)).tolist()
            if number % 3 == 1:
                lamps.append((x, y, _heading(-right)))
            elif planted and rng.random() < 0.85:
                plan.trees.append(draw_tree(x, y, style, rng, street=True))
        if rng.random() < 0.1:
            point, along = point_and_direction(line, 4.0)
            right = np.array([along[1], -along[0]])
            x, y = (point + right * (street.width_m / 2 + 2.0)).tolist()
            shape = "kiosk" if rng.random() < 0.5 else "column"
            height, radius = (2.8, 1.0) if shape == "kiosk" else (4.0, 0.7)
            plan.landmarks.append(Landmark(x, y, shape, height, radius, vary_colour(rng, BRIGHT)))
    return lamps


def park_cars(
    slots: list[Slot], streets: list[Street], rng: np.random.Generator, every_m: float = 70.0
) -> tuple[list[Car], list[Car]]:
    """Draw the cars of the aerial and of the ground view.

    One parked car in five differs between the views, and all of those on the lanes do; these are
    `every_m` apart, more or less.
    """
    views: tuple[list[Car], list[Car]] = ([], [])
    for slot in slots:
        taken = rng.random() < slot.chance
        car = _draw_car(slot, rng)
        changed = rng.random() < 0.2
        later = _draw_car(slot, rng)
        if taken:
            views[0].append(car)
        if changed:
            if rng.random() < slot.chance:
                views[1].append(later)
        elif taken:
            views[1].append(car)
    for cars in views:
        for street in streets:
            for lane in range(street.lanes):
                line = street.drive(lane)
                along_m = rng.exponential(50.0)
                while along_m < line.length:
                    point, along = point_and_direction(line, along_m)
                    x, y = point.tolist()
                    cars.append(_draw_car(Slot(x, y, _heading(along), 1.0), rng))
                    along_m += 9.0 + rng.exponential(every_m)
    return _apart(views[0]), _apart(views[1])


def _draw_car(slot: Slot, rng: np.random.Generator) -> Car:
    body = int(rng.choice(4, p=[0.4, 0.3, 0.2, 0.1]))
    colour = vary_colour(rng, CAR_COLOURS, 0.04)
    heading = slot.heading_deg + rng.normal(0.0, 1.5)
    x, y = (np.array([slot.x, slot.y]) + rng.normal(0.0, 0.12, 2)).tolist()
    return Car(x, y, float(heading), body, colour)


def _apart(cars: list[Car]) -> list[Car]:
    """Leave out cars that would stand in earlier ones, as where lanes cross."""
    grounds = []
    for car in cars:
        angle = np.radians(car.heading_deg)
        length, width, *_ = CAR_BODIES[car.body]
        along = np.array([np.sin(angle), np.cos(angle)])
        grounds.append(rectangle(np.array([car.x, car.y]), along, length, width))
    first, second = shapely.STRtree(grounds).query(grounds, predicate="intersects")
    late = set(first[second < first].tolist())
    return [car for number, car in enumerate(cars) if number not in late]
