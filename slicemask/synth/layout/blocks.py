"""Blocks of a generated city: what stands between the streets."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString, Polygon
from shapely.geometry.base import BaseGeometry

from slicemask.synth.layout.elements import (
    Area,
    Building,
    Colour,
    Facade,
    Kind,
    Landmark,
    Plan,
    Slot,
    Tree,
)
from slicemask.synth.layout.streets import WHITE, Style, rectangle

KERB_M = 0.12
# Grounds lie on one another in layers, so that none has to be cut out of the one below.
LOT_M, PATH_M, PAINT_M = KERB_M + 0.02, KERB_M + 0.04, KERB_M + 0.06

WALLS: tuple[Colour, ...] = (
    (0.74, 0.68, 0.58), (0.62, 0.40, 0.31), (0.80, 0.78, 0.73), (0.58, 0.60, 0.62),
    (0.70, 0.58, 0.42), (0.52, 0.33, 0.27), (0.83, 0.76, 0.60), (0.60, 0.66, 0.62),
    (0.46, 0.44, 0.43), (0.78, 0.66, 0.62), (0.55, 0.62, 0.70), (0.86, 0.85, 0.82),
)  # fmt: skip
FLAT_ROOFS: tuple[Colour, ...] = (
    (0.62, 0.61, 0.58), (0.42, 0.42, 0.43), (0.75, 0.74, 0.72), (0.52, 0.48, 0.43),
    (0.33, 0.33, 0.35), (0.60, 0.52, 0.45), (0.45, 0.52, 0.46), (0.68, 0.66, 0.60),
)  # fmt: skip
TILED_ROOFS: tuple[Colour, ...] = (
    (0.55, 0.29, 0.21), (0.40, 0.36, 0.34), (0.33, 0.35, 0.39), (0.47, 0.37, 0.28),
    (0.60, 0.36, 0.26), (0.37, 0.41, 0.38), (0.28, 0.27, 0.28), (0.50, 0.24, 0.20),
)  # fmt: skip
BRIGHT: tuple[Colour, ...] = (
    (0.80, 0.12, 0.10), (0.10, 0.35, 0.75), (0.95, 0.70, 0.05), (0.05, 0.55, 0.35),
    (0.55, 0.15, 0.60), (0.95, 0.45, 0.08), (0.05, 0.60, 0.70), (0.90, 0.90, 0.92),
)  # fmt: skip
CONCRETE: Colour = (0.60, 0.59, 0.56)


def vary_colour(
    rng: np.random.Generator, colours: tuple[Colour, ...], spread: float = 0.06
) -> Colour:
    """Pick a colour and vary its brightness and tint a little."""
    colour = np.array(colours[rng.integers(len(colours))])
    colour = colour * (1 + rng.normal(0, spread)) + rng.normal(0, spread / 4, 3)
    red, green, blue = np.clip(colour, 0.03, 0.95).tolist()
    return red, green, blue


def fill_block(block: Polygon, style: Style, plan: Plan, rng: np.random.Generator) -> None:
    """Fill a block with pavement along the streets and, inside, one of the zones."""
    plan.areas.append(Area(block, Kind.PAVING, vary_colour(rng, (style.pavement,), 0.03), KERB_M))
    inner = _largest(block.buffer(-rng.uniform(2.6, 3.8), join_style="mitre"))
    if inner is None or inner.area < 120.0:
        return
    centre = inner.centroid
    far = np.hypot(centre.x - style.downtown[0], centre.y - style.downtown[1])
    weights = np.array(style.zones)
    weights[2] *= 4.0 * np.exp(-((far / 120.0) ** 2)) + 0.15  # towers
    if inner.area < 700.0:
        weights[[2, 3]] = 0.0
    zones = (_houses, _rows, _towers, _retail, _park, _mixed)
    zone: Callable[[Polygon, Style, Plan, np.random.Generator], None] = zones[
        rng.choice(len(zones), p=weights / weights.sum())
    ]
    zone(inner, style, plan, rng)


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


def _largest(shape: BaseGeometry) -> Polygon | None:
    parts = [part for part in shapely.get_parts(shape) if isinstance(part, Polygon)]
    return max(parts, key=lambda part: part.area, default=None)


def _fit(
    lot: Polygon, length: float, width: float, gap_m: float, rng: np.random.Generator
) -> Polygon | None:
    """Give a rectangle of at most this size inside a lot, along the lot's own sides."""
    centre, along, *_ = oriented_bounds(lot)
    anchor = shapely.get_coordinates(lot.centroid)[0] * 0.5 + centre * 0.5
    room = lot.buffer(-gap_m)
    for shrink in (1.0, 0.85, 0.7, 0.55):
        for _ in range(3):
            place = rectangle(
                anchor + rng.normal(0, 1.0, 2), along, length * shrink, width * shrink
            )
            if room.contains(place):
                return place
    return None


def _facade(style: Style, kind: str, rng: np.random.Generator) -> Facade:
    wall = vary_colour(rng, WALLS)
    wall = (
        min(max(wall[0] + style.wall_hue, 0.05), 0.95),
        wall[1],
        min(max(wall[2] - style.wall_hue, 0.05), 0.95),
    )
    facade = Facade(
        colour=wall,
        window=vary_colour(rng, ((0.20, 0.24, 0.29), (0.28, 0.33, 0.37), (0.16, 0.18, 0.20))),
        shop=vary_colour(rng, BRIGHT),
        pitch_m=float(rng.uniform(2.0, 3.6)),
        storey_m=float(rng.uniform(2.8, 3.5)),
        width=float(rng.uniform(0.32, 0.6)),
        height=float(rng.uniform(0.42, 0.6)),
        bricks=float(rng.choice([0.0, 0.0, 1.0])),
    )
    if kind == "house":
        return facade
    if kind == "tower" and rng.random() < 0.6:
        # A curtain wall, or bands of glass.
        return replace(
            facade,
            window=vary_colour(rng, ((0.25, 0.35, 0.45), (0.18, 0.28, 0.30), (0.38, 0.46, 0.52))),
            width=float(rng.choice([0.88, 1.0])),
            height=float(rng.uniform(0.55, 0.88)),
            bricks=0.0,
            shops=True,
        )
    if kind == "shed":
        return replace(facade, width=0.0, bricks=0.0, shops=bool(rng.random() < 0.6))
    return replace(facade, shops=bool(rng.random() < 0.45))


def _plant(
    plan: Plan, where: BaseGeometry, count: int, style: Style, rng: np.random.Generator
) -> None:
    """Plant up to so many trees in an area that keep off its border."""
    room = where.buffer(-1.5)
    if room.is_empty or count <= 0:
        return
    west, south, east, north = room.bounds
    points = rng.uniform((west, south), (east, north), (count * 2, 2))
    for x, y in points[shapely.contains_xy(room, points)][:count]:
        plan.trees.append(draw_tree(float(x), float(y), style, rng))


def draw_tree(
    x: float, y: float, style: Style, rng: np.random.Generator, street: bool = False
) -> Tree:
    """Draw a tree at a place; those along streets are slimmer and have a free trunk."""
    conifer = bool(rng.random() < 0.15) and not street
    height = rng.uniform(5.0, 8.0) if street else rng.uniform(4.0, 12.0)
    radius = rng.uniform(1.3, 2.1) if street else height * rng.uniform(0.22, 0.34)
    greens: tuple[Colour, ...] = (
        (0.25, 0.36, 0.15), (0.33, 0.42, 0.18), (0.20, 0.30, 0.15), (0.40, 0.43, 0.17),
    )  # fmt: skip
    colour = vary_colour(rng, ((0.16, 0.26, 0.17),) if conifer else greens, 0.12)
    return Tree(x, y, float(height), float(radius * (0.7 if conifer else 1)), conifer, colour)


def _houses(lot: Polygon, style: Style, plan: Plan, rng: np.random.Generator) -> None:
    """Detached houses in gardens, with drives, pools and sheds."""
    plan.areas.append(Area(lot, Kind.GRASS, vary_colour(rng, (style.grass,), 0.05), LOT_M))
    street = lot.exterior
    hedge_chance = rng.random() * 0.6
    tiled = rng.choice(len(TILED_ROOFS), 3)  # neighbours share a few roofs
    for garden in split(lot, rng.uniform(300, 480), rng):
        if garden.distance(street) > 0.5:
            _plant(plan, garden, int(rng.integers(1, 5)), style, rng)
            continue
        room: BaseGeometry = garden
        house = _fit(garden, rng.uniform(10, 16), rng.uniform(8, 11), 1.5, rng)
        if house is not None:
            roof = str(rng.choice(["gable", "hip", "hip", "flat"], p=[0.4, 0.3, 0.2, 0.1]))
            storeys = rng.integers(1, 4)
            colours = FLAT_ROOFS if roof == "flat" else tuple(TILED_ROOFS[k] for k in tiled)
            building = Building(
                house,
                top_m=3.0 * float(storeys) + 0.6,
                facade=_facade(style, "house", rng),
                roof_colour=vary_colour(rng, colours),
                roof=roof,
                roof_kind=Kind.ROOF if roof == "flat" else Kind.TILES,
            )
            plan.buildings.append(building)
            wing_chance = rng.random()
            if wing_chance < 0.35:
                _wing(plan, building, garden, rng)
            room = room.difference(house.buffer(1.5))
            drive = _drive(garden, house, street, rng)
            if drive is not None:
                path, slot = drive
                plan.areas.append(Area(path, Kind.PAVING, vary_colour(rng, (CONCRETE,)), PATH_M))
                plan.slots.append(slot)
                room = room.difference(path)
        if rng.random() < 0.12:
            pool = _fit(_largest(room.buffer(-0.5)) or garden, 8, 4, 0.5, rng)
            if pool is not None and room.contains(pool):
                deck = pool.buffer(1.2, join_style="mitre")
                plan.areas.append(Area(deck, Kind.PAVING, (0.72, 0.68, 0.6), PATH_M))
                plan.areas.append(Area(pool, Kind.WATER, (0.15, 0.55, 0.65), PAINT_M))
                room = room.difference(deck)
        if rng.random() < hedge_chance:
            fence = garden.boundary.buffer(0.25).intersection(room.buffer(-0.1))
            for part in shapely.get_parts(fence.difference(street.buffer(1.0))):
                if isinstance(part, Polygon) and part.area > 1.0:
                    plan.areas.append(
                        Area(part, Kind.LEAVES, (0.2, 0.3, 0.14), LOT_M + rng.uniform(0.8, 1.6))
                    )
        _plant(plan, room, int(rng.poisson(2.2 * style.tree_density)), style, rng)


def _wing(plan: Plan, house: Building, garden: Polygon, rng: np.random.Generator) -> None:
    """Build a lower wing across the house, when there is room."""
    centre, along, length, width = oriented_bounds(house.footprint)
    left = np.array([-along[1], along[0]])
    side = rng.choice([-1, 1])
    place = centre + along * length * rng.uniform(-0.2, 0.2) + side * left * width * 0.7
    wing = rectangle(place, left, width * 0.9, length * 0.45)
    if garden.buffer(-0.8).contains(wing):
        plan.buildings.append(replace(house, footprint=wing, top_m=house.top_m - 0.4))


def _drive(
    garden: Polygon, house: Polygon, street: LineString, rng: np.random.Generator
) -> tuple[Polygon, Slot] | None:
    """A drive from beside the house to the street, and the place of a car on it."""
    corner = shapely.get_coordinates(house.buffer(1.6, join_style="mitre").exterior)[
        rng.integers(4)
    ]
    kerb = shapely.get_coordinates(
        shapely.line_interpolate_point(
            street, shapely.line_locate_point(street, shapely.points(corner))
        )
    )[0]
    length = float(np.hypot(*(kerb - corner)))
    if not 4.0 < length < 20.0:
        return None
    along = (kerb - corner) / length
    path = rectangle((corner + kerb) / 2, along, length + 1.0, 2.8)
    if path.intersection(garden).area < 0.8 * path.area or path.intersects(house):
        return None
    x, y = (corner + along * min(3.0, length / 2)).tolist()
    return path, Slot(x, y, float(np.degrees(np.arctan2(along[0], along[1]))) % 360.0, 0.55)


def _rows(lot: Polygon, style: Style, plan: Plan, rng: np.random.Generator) -> None:
    """Houses wall to wall around a court."""
    depth = rng.uniform(9.5, 13.0)
    court = lot.buffer(-depth, join_style="mitre")
    ring = lot.difference(court)
    storeys = rng.integers(2, 6)
    pitched = rng.random() < 0.35
    for piece in split(lot, rng.uniform(150, 320), rng):
        for part in shapely.get_parts(ring.intersection(piece)):
            if not isinstance(part, Polygon) or part.area < 35.0:
                continue
            if rng.random() < 0.07:  # a gap, used as a small garden
                plan.areas.append(Area(part, Kind.GRASS, style.grass, LOT_M))
                _plant(plan, part, 2, style, rng)
                continue
            top = 3.2 * max(2, int(storeys + rng.integers(-1, 2))) + rng.uniform(0.4, 1.4)
            facade = _facade(style, "row", rng)
            _, _, length, width = oriented_bounds(part)
            regular = part.area > 0.93 * length * width and width > 4.0
            if pitched and regular:
                centre, along, *_ = oriented_bounds(part)
                part = rectangle(centre, along, length, width)
                roof, kind, colour = "gable", Kind.TILES, vary_colour(rng, TILED_ROOFS)
            else:
                roof, kind, colour = "flat", Kind.ROOF, vary_colour(rng, FLAT_ROOFS)
            plan.buildings.append(Building(part, float(top), facade, colour, roof, 0.0, kind))
    yard = _largest(court)
    if yard is None or yard.area < 40.0:
        return
    if yard.area > 450.0 and rng.random() < 0.45:
        parking_lot(yard.buffer(-1.0, join_style="mitre"), plan, rng)
        return
    plan.areas.append(Area(yard, Kind.GRASS, vary_colour(rng, (style.grass,)), LOT_M))
    for shed in split(yard, 90.0, rng)[:6]:
        place = _fit(shed, 4, 3, 0.8, rng) if rng.random() < 0.35 else None
        if place is not None:
            plan.buildings.append(
                Building(place, 2.6, _facade(style, "shed", rng), vary_colour(rng, FLAT_ROOFS))
            )
    sheds = shapely.union_all([b.footprint for b in plan.buildings[-6:]])
    trees = int(yard.area / 90 * style.tree_density)
    _plant(plan, yard.difference(sheds.buffer(1)), trees, style, rng)


def _towers(lot: Polygon, style: Style, plan: Plan, rng: np.random.Generator) -> None:
    """Tall buildings on podiums, on paved squares."""
    colour = vary_colour(rng, ((0.58, 0.55, 0.50), (0.50, 0.50, 0.52), (0.66, 0.58, 0.50)))
    plan.areas.append(Area(lot, Kind.PAVING, colour, LOT_M))
    far = np.hypot(lot.centroid.x - style.downtown[0], lot.centroid.y - style.downtown[1])
    tall = 14.0 * np.exp(-((far / 150.0) ** 2)) + 5.0
    for site in split(lot, rng.uniform(900, 1900), rng):
        _, _, length, width = oriented_bounds(site)
        base = _fit(site, length * 0.9, width * 0.88, rng.uniform(1.0, 4.0), rng)
        if base is None or base.area < 120.0:
            _plant(plan, site, 4, style, rng)
            continue
        facade = _facade(style, "tower", rng)
        storeys = max(4, rng.poisson(tall))
        top = facade.storey_m * storeys + rng.uniform(0.5, 2.0)
        roof = vary_colour(rng, FLAT_ROOFS)
        shaft = base
        if rng.random() < 0.6 and base.area > 350.0:
            low = facade.storey_m * rng.integers(1, 4)
            plan.buildings.append(Building(base, low + 0.8, replace(facade, shops=True), roof))
            centre, along, length, width = oriented_bounds(base)
            slimmer = rng.uniform(0.5, 0.8, 2)
            shift = along * rng.uniform(-0.5, 0.5) * length * (1 - slimmer[0]) * 0.8
            shaft = rectangle(centre + shift, along, length * slimmer[0], width * slimmer[1])
        plan.buildings.append(Building(shaft, float(top), facade, vary_colour(rng, FLAT_ROOFS)))
        free = site.difference(base.buffer(2.5))
        _plant(plan, free, int(free.area / 70 * style.tree_density), style, rng)
        if rng.random() < 0.25:
            _landmark(plan, free, rng)


def _retail(lot: Polygon, style: Style, plan: Plan, rng: np.random.Generator) -> None:
    """A large flat building and its car park."""
    halves = sorted(split(lot, lot.area * 0.55, rng), key=lambda part: part.area)
    for half in halves[:-1]:
        parking_lot(half, plan, rng)
    site = halves[-1]
    plan.areas.append(Area(site, Kind.PAVING, vary_colour(rng, (CONCRETE,)), LOT_M))
    shop = _largest(site.buffer(-rng.uniform(1.5, 4.0), join_style="mitre"))
    if shop is not None and shop.area > 80.0:
        colours = (*FLAT_ROOFS, (0.82, 0.82, 0.80), (0.40, 0.50, 0.58))
        top = rng.uniform(5.0, 9.0)
        facade = _facade(style, "shed", rng)
        plan.buildings.append(Building(shop, float(top), facade, vary_colour(rng, colours)))
        centre, along, length, width = oriented_bounds(shop)
        if rng.random() < 0.5 and shop.area > 400:  # skylights in rows
            for offset in np.arange(-length / 2 + 4, length / 2 - 4, 6.0):
                light = rectangle(centre + along * offset, along, 1.6, width * 0.6)
                if shop.buffer(-1).contains(light):
                    plan.buildings.append(
                        Building(light, float(top) + 0.7, facade, (0.75, 0.82, 0.86), base_m=top)
                    )


def parking_lot(ground: BaseGeometry, plan: Plan, rng: np.random.Generator) -> None:
    """Lay a car park with marked rows over a polygon."""
    polygon = _largest(ground)
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


def _park(lot: Polygon, style: Style, plan: Plan, rng: np.random.Generator) -> None:
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
            court = _fit(part, 24, 12, 1.0, rng)
            if court is not None:
                _court(court, plan, rng)
                free = free.difference(court.buffer(2.0))
        elif what < 0.6 and part.area > 150:
            pond = _largest(part.buffer(-3.0))
            if pond is not None:
                pond = pond.buffer(-2).buffer(2)
                for water in shapely.get_parts(pond):
                    plan.areas.append(Area(water, Kind.WATER, (0.16, 0.30, 0.34), PATH_M))
                free = free.difference(pond.buffer(2.0))
    _landmark(plan, shapely.Point(centre).buffer(2.0), rng)
    _plant(plan, free, int(lot.area / 75 * style.tree_density), style, rng)


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


def _landmark(plan: Plan, where: BaseGeometry, rng: np.random.Generator) -> None:
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


def _mixed(lot: Polygon, style: Style, plan: Plan, rng: np.random.Generator) -> None:
    """Lots of every kind beside one another: flats, shops, yards, small car parks."""
    ground = Area(lot, Kind.PAVING, vary_colour(rng, (CONCRETE, style.pavement)), LOT_M)
    plan.areas.append(ground)
    for site in split(lot, rng.uniform(320, 800), rng):
        what = rng.random()
        if what < 0.14:
            parking_lot(site.buffer(-0.5, join_style="mitre"), plan, rng)
            continue
        if what < 0.26:
            plan.areas.append(Area(site, Kind.GRASS, vary_colour(rng, (style.grass,)), PATH_M))
            _plant(plan, site, int(site.area / 60 * style.tree_density), style, rng)
            continue
        block = _largest(site.buffer(-rng.choice([0.15, 1.0, 2.5]), join_style="mitre"))
        if block is None or block.area < 50.0:
            continue
        centre, along, length, width = oriented_bounds(block)
        if what < 0.6 and block.area > 250.0:  # an L: cut a corner off
            corner = centre + along * length * 0.35 * rng.choice([-1, 1])
            corner = corner + np.array([-along[1], along[0]]) * width * 0.35 * rng.choice([-1, 1])
            block = _largest(block.difference(rectangle(corner, along, length * 0.5, width * 0.5)))
            if block is None:
                continue
        facade = _facade(style, "row", rng)
        top = facade.storey_m * rng.integers(1, 7) + rng.uniform(0.5, 1.2)
        plan.buildings.append(Building(block, float(top), facade, vary_colour(rng, FLAT_ROOFS)))
