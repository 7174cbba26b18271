"""Open country: a few roads, fields, meadows, woods, hedges, and farms or single houses."""

from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry import LineString, Polygon
from shapely.geometry.base import BaseGeometry
from shapely.ops import substring

from slicemask.synth.layout.city import City, city_of, park_cars
from slicemask.synth.layout.elements import Area, Colour, Kind, Plan
from slicemask.synth.layout.lots import largest, split
from slicemask.synth.layout.palette import vary_colour
from slicemask.synth.layout.streets import (
    Street,
    Style,
    free_pieces,
    point_and_direction,
    rectangle,
)
from slicemask.synth.vary.dwellings import Dwellings
from slicemask.synth.vary.farms import build_farm
from slicemask.synth.vary.horizon import draw_horizon
from slicemask.synth.vary.junctions import build_island, draw_roundabouts, without_cars_on
from slicemask.synth.vary.roads import ANY, Paint, draw_pavement, paint_roads, patches
from slicemask.synth.vary.suburbs import add_trees, keep_clear, ring_of_trees
from slicemask.synth.vary.switches import Variation
from slicemask.synth.vary.trees import Flora

# Layers above the base, which is rough grass, metres.
FIELD_M, DITCH_M, SHOULDER_M, ROAD_M, SIDE_M, PAINT_M = 0.01, 0.004, 0.015, 0.03, 0.025, 0.045
SEEN_M = 75.0  # from a road, what tiles show
FIELDS: dict[str, tuple[Kind, tuple[Colour, ...]]] = {
    "crop": (Kind.CROP, ((0.30, 0.42, 0.16), (0.42, 0.46, 0.20), (0.60, 0.52, 0.28))),
    "stubble": (Kind.CROP, ((0.66, 0.57, 0.38), (0.58, 0.50, 0.36), (0.48, 0.38, 0.28))),
    "soil": (Kind.SOIL, ((0.42, 0.32, 0.24), (0.30, 0.24, 0.20), (0.50, 0.36, 0.26))),
    "pasture": (Kind.GRASS, ((0.34, 0.44, 0.20), (0.44, 0.46, 0.24))),
    "meadow": (Kind.MEADOW, ((0.36, 0.42, 0.20), (0.52, 0.47, 0.29), (0.44, 0.42, 0.26))),
    "wood": (Kind.LITTER, ((0.34, 0.28, 0.20), (0.28, 0.30, 0.18))),
    "scrub": (Kind.MEADOW, ((0.46, 0.42, 0.28), (0.38, 0.38, 0.22))),
}


@dataclass(frozen=True)
class Country:
    """What a stretch of country has in common. Lengths in metres.

    Parameters
    ----------
    shares
        Of each of `FIELDS`.
    field_m2
        Typical size of a field.
    verge_m
        Rough grass between a road's edge and the fields.
    shoulder_m
        Gravel along the roads' edges.
    borders
        Shares of fields' borders that are bare, fenced, hedged and lined with trees.
    canopy_m
        Between trees along the roads; infinite for none.
    houses
        Chance of a house or farm at each place where one could be.
    poles
        Whether poles stand along the road.
    """

    shares: tuple[float, ...]
    field_m2: float
    verge_m: float
    shoulder_m: float
    borders: tuple[float, ...]
    canopy_m: float
    houses: float
    poles: bool

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "Country":
        """Draw a stretch of country: farmland, woods, or both."""
        wooded = rng.random()
        weights = np.array([1.5, 0.8, 1.2, 1.0, 1.0, 0.2, 0.4])
        if wooded < 0.3:
            weights = np.array([0.1, 0.05, 0.05, 0.2, 0.6, 4.0, 0.8])
        elif wooded < 0.55:
            weights = np.array([0.5, 0.3, 0.3, 0.6, 0.8, 1.5, 0.8])
        return cls(
            shares=tuple(rng.dirichlet(weights).tolist()),
            field_m2=float(np.exp(rng.uniform(np.log(3000), np.log(40000)))),
            verge_m=float(rng.uniform(1.5, 8.0)),
            shoulder_m=float(rng.uniform(0.3, 2.0) if rng.random() < 0.7 else 0.0),
            borders=tuple(rng.dirichlet([1.2, 1.0, 0.5, 0.5]).tolist()),
            canopy_m=float(rng.uniform(6, 30)) if rng.random() < 0.4 else float("inf"),
            houses=float(rng.uniform(0, 0.5) ** 1.5),
            poles=bool(rng.random() < 0.5),
        )


def lay_out_country(seed: tuple[int, ...], half_extent_m: float, variation: Variation) -> City:
    """Lay out a stretch of country. The same seed and extent give the same one."""
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence([*seed, 32]).spawn(5)]
    style_rng, road_rng, field_rng, tree_rng, car_rng = streams
    country, style = Country.draw(style_rng), Style.draw(style_rng, half_extent_m)
    flora = Flora.draw(style_rng)
    plan = Plan()
    streets: list[Street] = []
    pavements: list[tuple[Kind, Colour]] = []
    for number, line in enumerate(_lay_roads(half_extent_m, road_rng)):
        (kind, colour), painted = draw_pavement(road_rng, ANY)
        pavements.append((kind, colour))
        lane = float(road_rng.uniform(2.7, 3.9) if painted else road_rng.uniform(1.9, 3.2))
        street = Street(line, 2, False, lane)
        streets.append(street)
        top = ROAD_M if number == 0 else SIDE_M - 0.001 * number
        surface = ragged(street.carriageway, 0.0 if painted else 0.35, road_rng)
        _add_parts(plan, surface, kind, colour, top)
        if country.shoulder_m:
            shoulder = line.buffer(street.width_m / 2 + country.shoulder_m, cap_style="flat")
            tone = vary_colour(road_rng, ((0.56, 0.51, 0.43), colour), 0.08)
            _add_parts(plan, ragged(shoulder, 0.4, road_rng), Kind.GRAVEL, tone, SHOULDER_M)
        if painted:
            plan.areas += patches([street], colour, top + 0.003, road_rng)
            paint = Paint.draw(road_rng, float(road_rng.uniform(0.2, 1.0)))
            plan.areas += paint_roads([street], paint, colour, PAINT_M)
    islands = []
    if "junctions" in variation:
        for roundabout in draw_roundabouts(streets, True, variation.random("junctions")):
            _add_parts(plan, roundabout.ground, *pavements[0], ROAD_M + 0.001)
            ground, plants = build_island(roundabout, style, flora, road_rng)
            plan.areas += ground
            islands.append((roundabout, plants))
    _lay_fields(streets, country, style, flora, half_extent_m, plan, field_rng)
    _settle(streets, country, style, flora, plan, field_rng)
    _line_roads(streets, country, flora, plan, tree_rng)
    ring_of_trees(half_extent_m, flora, plan, tree_rng)
    keep_clear(plan, streets)
    plan.trees += [tree for _, plants in islands for tree in plants]
    cars = park_cars(plan.slots, streets, car_rng, 400.0)
    base = (Kind.MEADOW, vary_colour(style_rng, (style.grass, (0.48, 0.44, 0.28)), 0.08))
    backdrops = draw_horizon(half_extent_m, tree_rng)
    city = city_of(plan, half_extent_m, style, streets, cars, base=base, backdrops=backdrops)
    return without_cars_on(city, [roundabout.island for roundabout, _ in islands])


def _lay_roads(half_extent_m: float, rng: np.random.Generator) -> list[LineString]:
    """A main road across, and up to three that meet or cross it."""
    angle = rng.uniform(0, np.pi)
    lines = [_bent(np.zeros(2), angle, -1.5, 1.5, half_extent_m, rng)]
    for _ in range(rng.choice(4, p=[0.2, 0.4, 0.25, 0.15])):
        main = lines[0]
        point, along = point_and_direction(main, main.length * rng.uniform(0.38, 0.62))
        way = np.arctan2(along[1], along[0]) + np.radians(rng.uniform(45, 135))
        first = -1.5 if rng.random() < 0.35 else 0.0
        last = 1.5 * rng.choice([-1, 1]) if first == 0.0 else 1.5
        lines.append(_bent(point, way, first, last, half_extent_m, rng))
    box = shapely.box(-half_extent_m, -half_extent_m, half_extent_m, half_extent_m)
    parts = [shapely.get_parts(line.intersection(box)) for line in lines]
    return [part for some in parts for part in some if part.length > 30.0]


def _bent(
    start: np.ndarray,
    angle: float,
    first: float,
    last: float,
    half_extent_m: float,
    rng: np.random.Generator,
) -> LineString:
    """A smooth line through a point, between two multiples of the extent along a direction."""
    far = np.linspace(first, last, 80) * half_extent_m
    bend = rng.choice([0.0, 0.0, rng.uniform(3, 30)])
    length = rng.uniform(120, 400)
    phase = rng.uniform(0, 2 * np.pi)
    aside = bend * (np.sin(2 * np.pi * far / length + phase) - np.sin(phase))
    aside += rng.choice([0, 0, rng.normal(0, 0.0012)]) * far**2
    cos, sin = np.cos(angle), np.sin(angle)
    offset = rng.uniform(-15, 15, 2) if first < 0 and last > 0 else np.zeros(2)
    points = np.stack([far * cos - aside * sin, far * sin + aside * cos], axis=1)
    return LineString(points + start + offset * bool(not start.any()))


def ragged(shape: BaseGeometry, by_m: float, rng: np.random.Generator) -> BaseGeometry:
    """A shape whose edge wavers, as that of an unpaved road does."""
    if not by_m:
        return shape
    parts = []
    for part in shapely.get_parts(shape):
        ring = shapely.get_coordinates(part.exterior.segmentize(1.5))[:-1]
        steps = rng.normal(0, 1, (len(ring), 2))
        kernel = np.hanning(7)[1:-1]
        smooth = np.stack(
            [np.convolve(np.pad(axis, 2, mode="wrap"), kernel, "valid") for axis in steps.T], axis=1
        )
        wavy = Polygon(ring + by_m / 1.7 * smooth)
        parts.append(wavy if wavy.is_valid else wavy.buffer(0))
    return shapely.union_all(parts)


def _add_parts(
    plan: Plan,
    shape: BaseGeometry,
    kind: Kind,
    colour: Colour,
    top_m: float,
    angle_deg: float = 0.0,
) -> None:
    for part in shapely.get_parts(shape):
        if isinstance(part, Polygon) and part.area > 0.5:
            plan.areas.append(Area(part, kind, colour, top_m, angle_deg))


def _lay_fields(
    streets: list[Street],
    country: Country,
    style: Style,
    flora: Flora,
    half_extent_m: float,
    plan: Plan,
    rng: np.random.Generator,
) -> None:
    """Cut the land into fields, and give each a crop, a wood or a meadow, and a border."""
    corridor = shapely.union_all(
        [street.line.buffer(street.width_m / 2 + country.verge_m) for street in streets]
    )
    box = shapely.box(-half_extent_m, -half_extent_m, half_extent_m, half_extent_m)
    seen = shapely.union_all([street.line.buffer(SEEN_M) for street in streets])
    names = list(FIELDS)
    for land in shapely.get_parts(box.difference(corridor)):
        if not isinstance(land, Polygon) or land.area < 50:
            continue
        angle = rng.uniform(0, 180)
        for field in split(land, country.field_m2, rng):
            name = names[rng.choice(len(names), p=country.shares)]
            kind, colours = FIELDS[name]
            turned = angle + 90.0 * rng.integers(2) + rng.normal(0, 2)
            shape = ragged(field.buffer(-0.3), 0.5, rng)
            _add_parts(plan, shape, kind, vary_colour(rng, colours, 0.05), FIELD_M, float(turned))
            _fill_field(name, field, seen, flora, plan, rng)
            _border(field, country, flora, plan, rng)


def _fill_field(
    name: str,
    field: Polygon,
    seen: BaseGeometry,
    flora: Flora,
    plan: Plan,
    rng: np.random.Generator,
) -> None:
    room = field.buffer(-1.0)
    if name == "wood":
        species = max(("wood", "fir", "sparse"), key=lambda key: flora.shares[key] + rng.random())
        each_m2 = rng.uniform(11, 26)
        # Where no tile and no camera sees into it, a wood need not be dense.
        for part, thin in ((room.intersection(seen), 1.0), (room.difference(seen), 0.25)):
            count = int(part.area / each_m2 * thin)
            for kind, share in ((species, 0.7), ("wood", 0.3)):
                add_trees(part, int(count * share), flora, plan, rng, kind)
        rim = room.difference(field.buffer(-12))
        add_trees(rim, int(rim.area / 12), flora, plan, rng, "bush")
    elif name == "scrub":
        add_trees(room, int(field.area / 90), flora, plan, rng, "bush")
        add_trees(room, int(field.area / 250), flora, plan, rng)
    elif name in ("pasture", "meadow"):
        add_trees(room, int(rng.poisson(field.area / 2500)), flora, plan, rng)


def _border(
    field: Polygon, country: Country, flora: Flora, plan: Plan, rng: np.random.Generator
) -> None:
    kind = rng.choice(4, p=country.borders)
    inside = largest(field.buffer(-0.5))
    if kind == 0 or inside is None:
        return
    ring = inside.exterior
    ring = substring(ring, ring.length * rng.uniform(0, 0.3), ring.length * rng.uniform(0.6, 1.0))
    if kind == 1:
        colour = vary_colour(rng, ((0.45, 0.40, 0.34), (0.75, 0.74, 0.72)))
        for along_m in np.arange(1.0, ring.length, 4.0):
            x, y = ring.interpolate(along_m).coords[0]
            post = shapely.box(x - 0.06, y - 0.06, x + 0.06, y + 0.06)
            plan.areas.append(Area(post, Kind.PLAIN, colour, 1.2))
        return
    species = "bush" if kind == 2 else ""
    every = rng.uniform(1.5, 3) if kind == 2 else rng.uniform(4, 12)
    for along_m in np.arange(1.0, ring.length, every):
        if rng.random() < 0.8:
            x, y = ring.interpolate(along_m).coords[0]
            plan.trees.append(flora.tree(x, y, rng, species))


def _settle(
    streets: list[Street],
    country: Country,
    style: Style,
    flora: Flora,
    plan: Plan,
    rng: np.random.Generator,
) -> None:
    """Farms and single houses beside the roads."""
    roads = shapely.union_all([street.carriageway.buffer(3.0) for street in streets])
    dwellings = Dwellings.draw(rng, style)
    taken: list[BaseGeometry] = []
    for street in streets:
        for along_m in np.arange(25.0, street.line.length - 25.0, 38.0):
            for side in (-1, 1):
                if rng.random() > country.houses:
                    continue
                point, along = point_and_direction(street.line, along_m + rng.uniform(-8, 8))
                out = side * np.array([-along[1], along[0]])
                edge = street.width_m / 2
                depth = rng.uniform(28, 50)
                lot = rectangle(
                    point + out * (edge + 2.0 + depth / 2), along, rng.uniform(26, 36), depth
                )
                if lot.intersects(roads) or any(lot.intersects(other) for other in taken):
                    continue
                taken.append(lot)
                _clear_trees(plan, lot)
                yard = Kind.GRASS if rng.random() < 0.7 else Kind.GRAVEL
                colour = style.grass if yard == Kind.GRASS else (0.60, 0.55, 0.47)
                _add_parts(
                    plan, ragged(lot, 0.5, rng), yard, vary_colour(rng, (colour,), 0.08), 0.014
                )
                kerb = street.line.offset_curve(side * edge)
                if rng.random() < 0.3:
                    build_farm(lot, point + out * edge, out, plan, rng)
                else:
                    dwellings.build(lot, (point + out * edge, out), rng.uniform(4, 14), kerb, plan,
                                    rng)  # fmt: skip
                add_trees(lot.buffer(-1), int(rng.poisson(4)), flora, plan, rng)
                add_trees(lot.buffer(-1), int(rng.poisson(3)), flora, plan, rng, "bush")


def _clear_trees(plan: Plan, lot: Polygon) -> None:
    inside = shapely.contains_xy(lot, [(tree.x, tree.y) for tree in plan.trees] or [(0, 0)])
    plan.trees = [t for t, hit in zip(plan.trees, inside, strict=False) if not hit]


def _line_roads(
    streets: list[Street],
    country: Country,
    flora: Flora,
    plan: Plan,
    rng: np.random.Generator,
) -> None:
    """Trees along the roads, whose crowns may close over them, and poles along one side."""
    for street, piece in free_pieces(streets):
        for line in (piece, piece.reverse()):
            along_m = rng.uniform(2, 10)
            while np.isfinite(country.canopy_m) and along_m < piece.length - 2:
                point, along = point_and_direction(line, along_m)
                right = np.array([along[1], -along[0]])
                off = street.width_m / 2 + rng.uniform(1.0, country.verge_m + 1.0)
                x, y = (point + right * off).tolist()
                plan.trees.append(flora.tree(x, y, rng))
                along_m += country.canopy_m * rng.uniform(0.5, 1.6)
    if country.poles and streets:
        street = streets[0]
        side = rng.choice([-1, 1])
        for along_m in np.arange(10.0, street.line.length - 5, 38.0):
            point, along = point_and_direction(street.line, along_m)
            off = street.width_m / 2 + min(country.verge_m, 3.0)
            x, y = point + side * off * np.array([-along[1], along[0]])
            pole = shapely.Point(x, y).buffer(0.15, quad_segs=2)
            plan.areas.append(Area(pole, Kind.PLAIN, (0.40, 0.33, 0.27), 9.0))
