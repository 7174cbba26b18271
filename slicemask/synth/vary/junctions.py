"""Roundabouts: where streets cross, an island to drive around."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from shapely.geometry import Point, Polygon

from slicemask.synth.layout.city import City
from slicemask.synth.layout.elements import Area, Kind, Tree
from slicemask.synth.layout.streets import Street, Style
from slicemask.synth.vary.trees import Flora

ISLAND_M = 0.10  # height


@dataclass(frozen=True)
class Roundabout:
    """A roundabout: its middle, the radius of its island and that of the road around it."""

    x: float
    y: float
    island_m: float
    outer_m: float

    @property
    def island(self) -> Polygon:
        """The ground of the island."""
        return Point(self.x, self.y).buffer(self.island_m, quad_segs=8)

    @property
    def ground(self) -> Polygon:
        """The ground of the island and of the road around it."""
        return Point(self.x, self.y).buffer(self.outer_m, quad_segs=8)


def draw_roundabouts(
    streets: Sequence[Street], widen: bool, rng: np.random.Generator
) -> list[Roundabout]:
    """Choose some of the crossings of streets.

    Parameters
    ----------
    widen
        Whether there is room for a road around that is wider than the crossing.
    """
    chance = rng.uniform(0.1, 0.7)
    found: list[Roundabout] = []
    tree = shapely.STRtree([street.line for street in streets])
    for number, street in enumerate(streets):
        for other in tree.query(street.line, predicate="intersects"):
            crossing = street.line.intersection(streets[other].line)
            if other <= number or not isinstance(crossing, Point) or rng.random() > chance:
                continue
            narrow = min(street.width_m, streets[other].width_m) / 2
            outer = narrow * rng.uniform(1.8, 2.6) if widen else narrow * 1.2
            island = outer - narrow * rng.uniform(0.9, 1.1)
            near = [Point(one.x, one.y).distance(crossing) for one in found]
            if island > 0.8 and min(near, default=99.0) > 30.0:
                found.append(Roundabout(crossing.x, crossing.y, float(island), float(outer)))
    return found


def build_island(
    roundabout: Roundabout, style: Style, flora: Flora, rng: np.random.Generator
) -> tuple[list[Area], list[Tree]]:
    """The island: a kerb, grass or stone, and perhaps a tree or bushes."""
    green = roundabout.island_m > 1.5 and rng.random() < 0.7
    kind, colour = (Kind.GRASS, style.grass) if green else (Kind.CONCRETE, (0.62, 0.58, 0.52))
    inside = Point(roundabout.x, roundabout.y).buffer(roundabout.island_m - 0.35, quad_segs=8)
    areas = [
        Area(roundabout.island, Kind.CONCRETE, (0.68, 0.67, 0.64), ISLAND_M),
        Area(inside, kind, colour, ISLAND_M + 0.02),
    ]
    trees = []
    if green and rng.random() < 0.6:
        species = "bush" if rng.random() < 0.5 else ""
        trees.append(flora.tree(roundabout.x, roundabout.y, rng, species))
    return areas, trees


def with_roundabouts(city: City, rng: np.random.Generator) -> City:
    """Put small islands on the crossings of a city whose blocks leave no more room."""
    flora = Flora.draw(rng)
    areas, trees, islands = list(city.areas), list(city.trees), []
    for roundabout in draw_roundabouts(city.streets, False, rng):
        islands.append(roundabout.island)
        ground, plants = build_island(roundabout, city.style, flora, rng)
        areas += ground
        trees += plants
    return without_cars_on(replace(city, areas=tuple(areas), trees=tuple(trees)), islands)


def without_cars_on(city: City, islands: Sequence[Polygon]) -> City:
    """Mark islands, and take away the cars that would stand on them."""
    if not islands:
        return city
    closed = shapely.union_all(islands).buffer(2.5)
    aerial, ground = (
        tuple(car for car in cars if not shapely.contains_xy(closed, car.x, car.y))
        for cars in (city.cars_aerial, city.cars_ground)
    )
    return replace(city, islands=tuple(islands), cars_aerial=aerial, cars_ground=ground)
