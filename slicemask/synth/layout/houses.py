"""Detached houses in gardens."""

from dataclasses import replace

import numpy as np
import shapely
from shapely.geometry import LineString, Polygon
from shapely.geometry.base import BaseGeometry

from slicemask.synth.layout.elements import Area, Building, Kind, Plan, Slot
from slicemask.synth.layout.greenery import plant
from slicemask.synth.layout.lots import LOT_M, PAINT_M, PATH_M, fit, largest, oriented_bounds, split
from slicemask.synth.layout.palette import (
    CONCRETE,
    FLAT_ROOFS,
    TILED_ROOFS,
    draw_facade,
    vary_colour,
)
from slicemask.synth.layout.streets import Style, rectangle


def lay_out_houses(lot: Polygon, style: Style, plan: Plan, rng: np.random.Generator) -> None:
    """Detached houses in gardens, with drives, pools and sheds."""
    plan.areas.append(Area(lot, Kind.GRASS, vary_colour(rng, (style.grass,), 0.05), LOT_M))
    street = lot.exterior
    hedge_chance = rng.random() * 0.6
    tiled = rng.choice(len(TILED_ROOFS), 3)  # neighbours share a few roofs
    for garden in split(lot, rng.uniform(300, 480), rng):
        if garden.distance(street) > 0.5:
            plant(plan, garden, int(rng.integers(1, 5)), style, rng)
            continue
        room: BaseGeometry = garden
        house = fit(garden, rng.uniform(10, 16), rng.uniform(8, 11), 1.5, rng)
        if house is not None:
            roof = str(rng.choice(["gable", "hip", "hip", "flat"], p=[0.4, 0.3, 0.2, 0.1]))
            storeys = rng.integers(1, 4)
            colours = FLAT_ROOFS if roof == "flat" else tuple(TILED_ROOFS[k] for k in tiled)
            building = Building(
                house,
                top_m=3.0 * float(storeys) + 0.6,
                facade=draw_facade(style, "house", rng),
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
            pool = fit(largest(room.buffer(-0.5)) or garden, 8, 4, 0.5, rng)
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
        plant(plan, room, int(rng.poisson(2.2 * style.tree_density)), style, rng)


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
