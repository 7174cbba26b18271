"""Blocks of a generated city: what stands between the streets."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import shapely
from shapely.geometry import Polygon

from slicemask.synth.layout.elements import Area, Building, Kind, Plan
from slicemask.synth.layout.greenery import plant
from slicemask.synth.layout.houses import lay_out_houses
from slicemask.synth.layout.lots import KERB_M, LOT_M, PATH_M, fit, largest, oriented_bounds, split
from slicemask.synth.layout.open_spaces import add_landmark, lay_out_park, parking_lot
from slicemask.synth.layout.palette import (
    CONCRETE,
    FLAT_ROOFS,
    TILED_ROOFS,
    draw_facade,
    vary_colour,
)
from slicemask.synth.layout.streets import Style, rectangle


def fill_block(block: Polygon, style: Style, plan: Plan, rng: np.random.Generator) -> None:
    """Fill a block with pavement along the streets and, inside, one of the zones."""
    plan.areas.append(Area(block, Kind.PAVING, vary_colour(rng, (style.pavement,), 0.03), KERB_M))
    inner = largest(block.buffer(-rng.uniform(2.6, 3.8), join_style="mitre"))
    if inner is None or inner.area < 120.0:
        return
    centre = inner.centroid
    far = np.hypot(centre.x - style.downtown[0], centre.y - style.downtown[1])
    weights = np.array(style.zones)
    weights[2] *= 4.0 * np.exp(-((far / 120.0) ** 2)) + 0.15  # towers
    if inner.area < 700.0:
        weights[[2, 3]] = 0.0
    zones = (lay_out_houses, _rows, _towers, lay_out_retail, lay_out_park, _mixed)
    zone: Callable[[Polygon, Style, Plan, np.random.Generator], None] = zones[
        rng.choice(len(zones), p=weights / weights.sum())
    ]
    zone(inner, style, plan, rng)


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
                plant(plan, part, 2, style, rng)
                continue
            top = 3.2 * max(2, int(storeys + rng.integers(-1, 2))) + rng.uniform(0.4, 1.4)
            facade = draw_facade(style, "row", rng)
            _, _, length, width = oriented_bounds(part)
            regular = part.area > 0.93 * length * width and width > 4.0
            if pitched and regular:
                centre, along, *_ = oriented_bounds(part)
                part = rectangle(centre, along, length, width)
                roof, kind, colour = "gable", Kind.TILES, vary_colour(rng, TILED_ROOFS)
            else:
                roof, kind, colour = "flat", Kind.ROOF, vary_colour(rng, FLAT_ROOFS)
            plan.buildings.append(Building(part, float(top), facade, colour, roof, 0.0, kind))
    yard = largest(court)
    if yard is None or yard.area < 40.0:
        return
    if yard.area > 450.0 and rng.random() < 0.45:
        parking_lot(yard.buffer(-1.0, join_style="mitre"), plan, rng)
        return
    plan.areas.append(Area(yard, Kind.GRASS, vary_colour(rng, (style.grass,)), LOT_M))
    for shed in split(yard, 90.0, rng)[:6]:
        place = fit(shed, 4, 3, 0.8, rng) if rng.random() < 0.35 else None
        if place is not None:
            plan.buildings.append(
                Building(place, 2.6, draw_facade(style, "shed", rng), vary_colour(rng, FLAT_ROOFS))
            )
    sheds = shapely.union_all([b.footprint for b in plan.buildings[-6:]])
    trees = int(yard.area / 90 * style.tree_density)
    plant(plan, yard.difference(sheds.buffer(1)), trees, style, rng)


def _towers(lot: Polygon, style: Style, plan: Plan, rng: np.random.Generator) -> None:
    """Tall buildings on podiums, on paved squares."""
    colour = vary_colour(rng, ((0.58, 0.55, 0.50), (0.50, 0.50, 0.52), (0.66, 0.58, 0.50)))
    plan.areas.append(Area(lot, Kind.PAVING, colour, LOT_M))
    far = np.hypot(lot.centroid.x - style.downtown[0], lot.centroid.y - style.downtown[1])
    tall = 14.0 * np.exp(-((far / 150.0) ** 2)) + 5.0
    for site in split(lot, rng.uniform(900, 1900), rng):
        _, _, length, width = oriented_bounds(site)
        base = fit(site, length * 0.9, width * 0.88, rng.uniform(1.0, 4.0), rng)
        if base is None or base.area < 120.0:
            plant(plan, site, 4, style, rng)
            continue
        facade = draw_facade(style, "tower", rng)
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
        plant(plan, free, int(free.area / 70 * style.tree_density), style, rng)
        if rng.random() < 0.25:
            add_landmark(plan, free, rng)


def lay_out_retail(lot: Polygon, style: Style, plan: Plan, rng: np.random.Generator) -> None:
    """A large flat building and its car park."""
    halves = sorted(split(lot, lot.area * 0.55, rng), key=lambda part: part.area)
    for half in halves[:-1]:
        parking_lot(half, plan, rng)
    site = halves[-1]
    plan.areas.append(Area(site, Kind.PAVING, vary_colour(rng, (CONCRETE,)), LOT_M))
    shop = largest(site.buffer(-rng.uniform(1.5, 4.0), join_style="mitre"))
    if shop is not None and shop.area > 80.0:
        colours = (*FLAT_ROOFS, (0.82, 0.82, 0.80), (0.40, 0.50, 0.58))
        top = rng.uniform(5.0, 9.0)
        facade = draw_facade(style, "shed", rng)
        plan.buildings.append(Building(shop, float(top), facade, vary_colour(rng, colours)))
        centre, along, length, width = oriented_bounds(shop)
        if rng.random() < 0.5 and shop.area > 400:  # skylights in rows
            for offset in np.arange(-length / 2 + 4, length / 2 - 4, 6.0):
                light = rectangle(centre + along * offset, along, 1.6, width * 0.6)
                if shop.buffer(-1).contains(light):
                    plan.buildings.append(
                        Building(light, float(top) + 0.7, facade, (0.75, 0.82, 0.86), base_m=top)
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
            plant(plan, site, int(site.area / 60 * style.tree_density), style, rng)
            continue
        block = largest(site.buffer(-rng.choice([0.15, 1.0, 2.5]), join_style="mitre"))
        if block is None or block.area < 50.0:
            continue
        centre, along, length, width = oriented_bounds(block)
        if what < 0.6 and block.area > 250.0:  # an L: cut a corner off
            corner = centre + along * length * 0.35 * rng.choice([-1, 1])
            corner = corner + np.array([-along[1], along[0]]) * width * 0.35 * rng.choice([-1, 1])
            block = largest(block.difference(rectangle(corner, along, length * 0.5, width * 0.5)))
            if block is None:
                continue
        facade = draw_facade(style, "row", rng)
        top = facade.storey_m * rng.integers(1, 7) + rng.uniform(0.5, 1.2)
        plan.buildings.append(Building(block, float(top), facade, vary_colour(rng, FLAT_ROOFS)))
