"""Trees of a generated city."""

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from slicemask.synth.layout.elements import Colour, Plan, Tree
from slicemask.synth.layout.palette import vary_colour
from slicemask.synth.layout.streets import Style


def plant(
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
