"""Suburbs and villages: detached houses in gardens along bent streets with verges."""

from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString, Polygon
from shapely.geometry.base import BaseGeometry

from slicemask.synth.layout.blocks import lay_out_retail
from slicemask.synth.layout.city import City, city_of, land_between, park_cars
from slicemask.synth.layout.elements import Area, Colour, Kind, Plan, Slot
from slicemask.synth.layout.lots import largest, oriented_bounds, split
from slicemask.synth.layout.open_spaces import lay_out_park
from slicemask.synth.layout.palette import vary_colour
from slicemask.synth.layout.streets import (
    Street,
    Style,
    free_pieces,
    lay_streets,
    point_and_direction,
)
from slicemask.synth.vary.dwellings import Dwellings
from slicemask.synth.vary.horizon import draw_horizon
from slicemask.synth.vary.junctions import (
    Roundabout,
    build_island,
    draw_roundabouts,
    without_cars_on,
)
from slicemask.synth.vary.roads import (
    ANY,
    PAVED,
    Paint,
    draw_pavement,
    paint_roads,
    patches,
)
from slicemask.synth.vary.switches import Variation
from slicemask.synth.vary.trees import Flora

# Heights of the layers of ground above the street, metres.
VERGE_M, KERB_STONE_M, LAWN_M, BED_M, PATH_M, DRIVE_M = 0.05, 0.10, 0.06, 0.065, 0.075, 0.08
SOFT: tuple[Colour, ...] = ((0.45, 0.35, 0.25), (0.36, 0.28, 0.20), (0.55, 0.48, 0.38))


@dataclass(frozen=True)
class Suburb:
    """What the streets and gardens of a suburb have in common. Lengths in metres.

    Parameters
    ----------
    lot_m2
        Typical size of a lot.
    verge_m
        Width of the grass between street and lots, the path included.
    kerb
        Whether streets have kerb stones.
    path_m
        Width of the path, 0 for none, and how far from the street it runs.
    setback_m
        From the lot's front to the house.
    lane_m
        Width of a lane.
    street_tree_m
        Between trees on the verge; infinite for none.
    garden_trees
        Expected number in a lot.
    mown
        Whether grass is lawn; else it is meadow.
    fences
        Share of the borders between lots that are fenced.
    """

    lot_m2: float
    verge_m: float
    kerb: bool
    path_m: float
    path_off_m: float
    setback_m: float
    lane_m: float
    street_tree_m: float
    garden_trees: float
    mown: bool
    fences: float

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "Suburb":
        """Draw a suburb, or, with larger lots and no kerbs, a village."""
        village = rng.random() < 0.35
        verge = rng.uniform(1.5, 6.0)
        return cls(
            lot_m2=float(rng.uniform(1000, 2400) if village else rng.uniform(420, 1100)),
            verge_m=float(verge),
            kerb=bool(rng.random() < (0.1 if village else 0.85)),
            path_m=float(rng.uniform(1.1, 1.8) if not village and rng.random() < 0.65 else 0.0),
            path_off_m=float(rng.uniform(0.2, max(0.3, verge - 1.8))),
            setback_m=float(rng.uniform(5, 18) if village else rng.uniform(3.5, 9.5)),
            lane_m=float(rng.uniform(2.3, 3.2) if village else rng.uniform(2.8, 4.6)),
            street_tree_m=float(rng.uniform(9, 26)) if rng.random() < 0.75 else float("inf"),
            garden_trees=float(rng.uniform(0.8, 7.0)),
            mown=bool(rng.random() < 0.6),
            fences=float(rng.uniform(0, 0.9)),
        )


def lay_out_suburb(seed: tuple[int, ...], half_extent_m: float, variation: Variation) -> City:
    """Lay out a suburb. The same seed and extent give the same one."""
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence([*seed, 31]).spawn(5)]
    style_rng, street_rng, lot_rng, tree_rng, car_rng = streams
    suburb = Suburb.draw(style_rng)
    style = replace(
        Style.draw(style_rng, half_extent_m),
        block_m=(float(style_rng.uniform(95, 190)), float(style_rng.uniform(58, 85))),
        stagger=float(style_rng.uniform(0.3, 1.0)),
        bend_m=float(style_rng.uniform(2, 26)),
        diagonals=0,
    )
    flora = Flora.draw(style_rng)
    base, painted = draw_pavement(style_rng, PAVED if suburb.kerb else ANY)
    paint = Paint.draw(style_rng, float(style_rng.uniform(0, 0.7)))
    streets = [
        Street(street.line, 2, False, suburb.lane_m)
        for street in lay_streets(style, half_extent_m, street_rng)
    ]
    roundabouts: list[Roundabout] = []
    if "junctions" in variation:
        roundabouts = draw_roundabouts(streets, True, variation.random("junctions"))
    plan = Plan()
    dwellings = Dwellings.draw(style_rng, style)
    radius = float(style_rng.uniform(3, 9))
    circles = [roundabout.ground for roundabout in roundabouts]
    for block in land_between(streets, half_extent_m, radius, circles):
        _fill(block, suburb, style, dwellings, flora, plan, lot_rng)
    if painted:
        plan.areas += paint_roads(streets, paint, base[1])
        plan.areas += patches(streets, base[1], 0.006, street_rng)
    _line_streets(streets, suburb, flora, plan, tree_rng)
    ring_of_trees(half_extent_m, flora, plan, tree_rng)
    keep_clear(plan, streets)
    for roundabout in roundabouts:
        ground, plants = build_island(roundabout, style, flora, tree_rng)
        plan.areas += ground
        plan.trees += plants
    islands = [roundabout.island for roundabout in roundabouts]
    cars = park_cars(plan.slots, streets, car_rng, 260.0)
    backdrops = draw_horizon(half_extent_m, tree_rng)
    city = city_of(plan, half_extent_m, style, streets, cars, base=base, backdrops=backdrops)
    return without_cars_on(city, islands)


def _fill(
    block: Polygon,
    suburb: Suburb,
    style: Style,
    dwellings: Dwellings,
    flora: Flora,
    plan: Plan,
    rng: np.random.Generator,
) -> None:
    """Verge, kerb, path, and lots with their houses."""
    grass = Kind.GRASS if suburb.mown else Kind.MEADOW
    plan.areas.append(Area(block, grass, vary_colour(rng, (style.grass,), 0.08), VERGE_M))
    if suburb.kerb:
        add_ring(plan, block, 0.0, 0.35, Kind.CONCRETE, (0.66, 0.65, 0.62), KERB_STONE_M)
    elif rng.random() < 0.6:
        add_ring(plan, block, 0.0, rng.uniform(0.3, 1.2), Kind.GRAVEL, (0.58, 0.53, 0.45), 0.052)
    if suburb.path_m:
        add_ring(
            plan, block, suburb.path_off_m, suburb.path_m, Kind.CONCRETE,
            vary_colour(rng, ((0.68, 0.66, 0.62),)), PATH_M,
        )  # fmt: skip
    inner = largest(block.buffer(-suburb.verge_m, join_style="mitre"))
    if inner is None or inner.area < 150:
        return
    if inner.area > 2500 and rng.random() < 0.12:
        (lay_out_park if rng.random() < 0.5 else lay_out_retail)(inner, style, plan, rng)
        plan.trees = [
            tree if tree.species else flora.tree(tree.x, tree.y, rng) for tree in plan.trees
        ]
        return
    for lot in split(inner, suburb.lot_m2 * rng.uniform(0.8, 1.25), rng):
        _fill_lot(lot, block, suburb, style, dwellings, flora, plan, rng)


def add_ring(
    plan: Plan,
    block: Polygon,
    off_m: float,
    width_m: float,
    kind: Kind,
    colour: Colour,
    top_m: float,
) -> None:
    """A strip along the inside of a block's edge."""
    outer = block.buffer(-off_m) if off_m else block
    for part in shapely.get_parts(outer.difference(outer.buffer(-width_m))):
        if isinstance(part, Polygon) and part.area > 0.3:
            plan.areas.append(Area(part, kind, colour, top_m))


def _fill_lot(
    lot: Polygon,
    block: Polygon,
    suburb: Suburb,
    style: Style,
    dwellings: Dwellings,
    flora: Flora,
    plan: Plan,
    rng: np.random.Generator,
) -> None:
    """A garden with a house that faces the street, a drive, beds, sheds, fences and trees."""
    grass = Kind.GRASS if rng.random() < (0.85 if suburb.mown else 0.3) else Kind.MEADOW
    colour = vary_colour(rng, (style.grass, style.grass, (0.45, 0.40, 0.26)), 0.12)
    plan.areas.append(Area(lot, grass, colour, LAWN_M))
    free: BaseGeometry = lot.buffer(-0.6)
    kerb = block.exterior
    front = frontage(lot, kerb)
    if front is not None and rng.random() < 0.94:
        taken = dwellings.build(lot, front, suburb.setback_m, kerb, plan, rng)
        free = free.difference(taken.buffer(0.8))
    if rng.random() < 0.5:
        _bed(free, plan, rng)
    shared = lot.exterior.difference(kerb.buffer(suburb.verge_m + 6.0))
    if rng.random() < suburb.fences:
        _fence(shared, free, plan, rng)
    add_trees(free, int(rng.poisson(suburb.garden_trees)), flora, plan, rng)
    add_trees(free, int(rng.poisson(1.6 * suburb.garden_trees)), flora, plan, rng, "bush")


def frontage(lot: Polygon, street: LineString) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The point of the street that is nearest to a lot, and the direction from it to the lot."""
    centre = shapely.get_coordinates(lot.centroid)[0]
    point = shapely.get_coordinates(street.interpolate(street.project(lot.centroid)))[0]
    inward = centre - point
    return point, inward / max(float(np.hypot(*inward)), 1e-6)


def _bed(free: BaseGeometry, plan: Plan, rng: np.random.Generator) -> None:
    """A bed of soil or bark with bushes."""
    place = largest(free)
    if place is None or place.area < 60:
        return
    centre, along, length, _ = oriented_bounds(place)
    spot = centre + along * rng.uniform(-0.35, 0.35) * length
    bed = shapely.Point(spot).buffer(rng.uniform(1.5, 4.0)).intersection(place)
    for part in shapely.get_parts(bed):
        if isinstance(part, Polygon) and part.area > 2:
            plan.areas.append(Area(part, Kind.LITTER, vary_colour(rng, SOFT), BED_M))


def _fence(line: BaseGeometry, free: BaseGeometry, plan: Plan, rng: np.random.Generator) -> None:
    """A fence of boards or a hedge along a border."""
    hedge = rng.random() < 0.25
    width, top = (0.5, rng.uniform(0.8, 1.9)) if hedge else (0.05, rng.uniform(0.9, 1.9))
    colours = (
        ((0.22, 0.31, 0.14),)
        if hedge
        else ((0.50, 0.42, 0.33), (0.62, 0.60, 0.56), (0.40, 0.36, 0.32), (0.34, 0.40, 0.36))
    )
    colour = vary_colour(rng, colours)
    for part in shapely.get_parts(line.simplify(0.2).buffer(width, cap_style="flat")):
        if isinstance(part, Polygon) and part.area > 0.3:
            plan.areas.append(Area(part, Kind.LEAVES if hedge else Kind.PLAIN, colour, float(top)))


def add_trees(
    room: BaseGeometry,
    count: int,
    flora: Flora,
    plan: Plan,
    rng: np.random.Generator,
    species: str = "",
) -> None:
    """Plant up to so many trees in an area."""
    if room.is_empty or count <= 0:
        return
    west, south, east, north = room.bounds
    points = rng.uniform((west, south), (east, north), (2 * count + 2, 2))
    for x, y in points[shapely.contains_xy(room, points)][:count]:
        plan.trees.append(flora.tree(float(x), float(y), rng, species))


def _line_streets(
    streets: list[Street], suburb: Suburb, flora: Flora, plan: Plan, rng: np.random.Generator
) -> None:
    """Trees on the verges and, here and there, cars along them."""
    for street, piece in free_pieces(streets):
        for line in (piece, piece.reverse()):
            along_m = rng.uniform(4, 12)
            while along_m < piece.length - 4:
                point, along = point_and_direction(line, along_m)
                right = np.array([along[1], -along[0]])
                if np.isfinite(suburb.street_tree_m) and rng.random() < 0.75:
                    off = street.width_m / 2 + rng.uniform(0.8, max(1.0, suburb.verge_m - 0.3))
                    x, y = (point + right * off).tolist()
                    plan.trees.append(flora.tree(x, y, rng))
                if rng.random() < 0.10 and street.lane_m > 2.7:
                    x, y = (point + right * (street.width_m / 2 - 1.1)).tolist()
                    heading = float(np.degrees(np.arctan2(along[0], along[1])) % 360.0)
                    plan.slots.append(Slot(x, y, heading, 0.6))
                every = suburb.street_tree_m if np.isfinite(suburb.street_tree_m) else 15.0
                along_m += every * rng.uniform(0.7, 1.4)


def ring_of_trees(
    half_extent_m: float, flora: Flora, plan: Plan, rng: np.random.Generator, count: int = 350
) -> None:
    """Trees beyond the edge, in clumps, for the horizon."""
    density = rng.uniform(0.1, 1.0)
    clumps = rng.uniform(0, 2 * np.pi, 12)
    for _ in range(int(count * density)):
        angle = clumps[rng.integers(12)] + rng.normal(0, 0.25)
        far = half_extent_m * rng.uniform(1.05, 2.6)
        x, y = np.sin(angle), np.cos(angle)
        reach = far / max(abs(x), abs(y))
        plan.trees.append(flora.tree(float(x * reach), float(y * reach), rng, "wood"))


def keep_clear(plan: Plan, streets: list[Street]) -> None:
    """Take away trees whose trunks stand on a street or in a house."""
    if not plan.trees:
        return
    hard = [street.carriageway.buffer(0.4) for street in streets]
    hard += [building.footprint.buffer(0.8) for building in plan.buildings]
    points = shapely.points([(tree.x, tree.y) for tree in plan.trees])
    bad = set(shapely.STRtree(hard).query(points, predicate="intersects")[0].tolist())
    plan.trees = [tree for number, tree in enumerate(plan.trees) if number not in bad]
