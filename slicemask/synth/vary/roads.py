"""Roads of other make: what they are paved with, and what is painted on them."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import shapely
from shapely.geometry import LineString, Polygon
from shapely.geometry.base import BaseGeometry
from shapely.ops import substring

from slicemask.synth.layout.city import MARKING_M, City
from slicemask.synth.layout.elements import Area, Colour, Kind
from slicemask.synth.layout.palette import vary_colour
from slicemask.synth.layout.streets import WHITE, YELLOW, Street, beside, free_pieces

# What roads are made of: kind, colours, and whether anything is painted on them.
PAVEMENTS: dict[str, tuple[Kind, tuple[Colour, ...], bool]] = {
    "asphalt": (
        Kind.TAR,
        ((0.27, 0.27, 0.28), (0.36, 0.36, 0.36), (0.47, 0.46, 0.45), (0.55, 0.54, 0.52)),
        True,
    ),
    "red asphalt": (Kind.TAR, ((0.42, 0.36, 0.33), (0.46, 0.41, 0.38)), True),
    "concrete": (Kind.CONCRETE, ((0.62, 0.61, 0.58), (0.72, 0.70, 0.66)), True),
    "gravel": (Kind.GRAVEL, ((0.66, 0.62, 0.54), (0.55, 0.53, 0.50), (0.72, 0.68, 0.60)), False),
    "dirt": (Kind.DIRT, ((0.58, 0.47, 0.34), (0.52, 0.42, 0.33), (0.60, 0.38, 0.26)), False),
}
PAVED, ANY = (0.62, 0.10, 0.28, 0.0, 0.0), (0.44, 0.06, 0.12, 0.24, 0.14)
PATCH_M, SHOULDER_M = 0.006, 0.003


@dataclass(frozen=True)
class Paint:
    """What is painted along a road.

    Parameters
    ----------
    centre
        "none", "dashes", "line", "double" or "mixed", which is a line beside dashes.
    centre_colour
    edges
        Whether lines run along both edges.
    mouths
        Whether dashes close the mouths of side streets.
    strength
        1 is fresh paint, 0 none that is left.
    """

    centre: str
    centre_colour: Colour
    edges: bool
    mouths: bool
    strength: float

    @classmethod
    def draw(cls, rng: np.random.Generator, busy: float) -> "Paint":
        """Draw the paint of a road; the busier, in [0, 1], the likelier there is some."""
        some = rng.random() < 0.25 + 0.75 * busy
        kind = str(rng.choice(["dashes", "line", "double", "mixed"], p=[0.4, 0.15, 0.35, 0.1]))
        return cls(
            centre=kind if some else "none",
            centre_colour=YELLOW if rng.random() < 0.5 else WHITE,
            edges=bool(some and rng.random() < busy * 0.8),
            mouths=bool(rng.random() < 0.35),
            strength=float(rng.uniform(0.15, 1.0) ** 0.7),
        )


def draw_pavement(
    rng: np.random.Generator, weights: tuple[float, ...]
) -> tuple[tuple[Kind, Colour], bool]:
    """Draw a road's kind and colour, and whether anything is painted on it."""
    kind, colours, painted = PAVEMENTS[list(PAVEMENTS)[rng.choice(len(PAVEMENTS), p=weights)]]
    return (kind, vary_colour(rng, colours, 0.08)), painted


def faded(paint: Colour, road: Colour, strength: float) -> Colour:
    """A colour of paint through which the road shows."""
    red, green, blue = (
        float(strength * a + (1 - strength) * b) for a, b in zip(paint, road, strict=True)
    )
    return red, green, blue


def repave(city: City, rng: np.random.Generator) -> City:
    """Give a city of streets other roads: another pavement, some streets unlike the others."""
    base, painted = draw_pavement(rng, PAVED)
    areas = [
        Area(street.carriageway, kind, colour, PATCH_M)
        for street in city.streets
        if rng.random() < 0.25
        for kind, colour in [draw_pavement(rng, PAVED)[0]]
    ]
    areas += list(patches(city.streets, base[1], PATCH_M + 0.002, rng))
    strength = rng.uniform(0.1, 1.0) if painted and rng.random() < 0.8 else 0.0
    for area in city.areas:
        if area.top_m != MARKING_M:
            areas.append(area)
        elif rng.random() < 0.25 + strength:
            areas.append(replace(area, colour=faded(area.colour, base[1], strength)))
    return replace(city, base=base, areas=tuple(area for area in areas if _filled(area.polygon)))


def _filled(shape: BaseGeometry) -> bool:
    return isinstance(shape, Polygon) and shape.area > 1e-3


def patches(
    streets: tuple[Street, ...] | list[Street],
    colour: Colour,
    top_m: float,
    rng: np.random.Generator,
) -> Iterator[Area]:
    """Mended places: pieces of lane of another shade."""
    often = rng.uniform(0, 0.02)
    for street in streets:
        for _ in range(rng.poisson(often * street.line.length)):
            start = rng.uniform(0, street.line.length)
            piece = substring(street.line, start, start + np.exp(rng.uniform(0.5, 3.5)))
            aside = rng.uniform(-0.4, 0.4) * street.width_m
            if piece.length < 1:
                continue
            width = rng.uniform(0.4, 1.8)
            shape = beside(piece, aside).buffer(width / 2, cap_style="flat")
            if isinstance(shape, Polygon) and street.carriageway.contains(shape):
                shade = rng.uniform(0.65, 1.15)
                yield Area(shape, Kind.TAR, faded(colour, (0, 0, 0), shade), top_m)


def paint_lines(
    street: Street, piece: LineString, paint: Paint, road: Colour, top_m: float
) -> Iterator[Area]:
    """Paint a stretch of a road of two lanes between junctions."""

    def area(shape: BaseGeometry, colour: Colour) -> Iterator[Area]:
        for part in shapely.get_parts(shape):
            if _filled(part):
                yield Area(part, Kind.PLAIN, faded(colour, road, paint.strength), top_m)

    dashes = _dashes(piece, 3.0, 9.0)
    if paint.centre == "dashes":
        yield from area(_stripe(dashes, 0.06), paint.centre_colour)
    elif paint.centre == "line":
        yield from area(_stripe(piece, 0.06), paint.centre_colour)
    elif paint.centre != "none" and piece.length > 3:
        sides = [beside(piece, 0.13), beside(piece, -0.13)]
        if paint.centre == "mixed":
            sides[0] = _dashes(sides[0], 3.0, 9.0)
        for side in sides:
            yield from area(_stripe(side, 0.06), paint.centre_colour)
    if paint.edges and piece.length > 3:
        for aside in (-1, 1):
            edge = beside(piece, aside * (street.width_m / 2 - 0.35))
            yield from area(_stripe(edge, 0.06), WHITE)


def _stripe(line: BaseGeometry, half_m: float) -> BaseGeometry:
    return line.buffer(half_m, cap_style="flat")


def _dashes(line: LineString, dash_m: float, every_m: float) -> BaseGeometry:
    starts = np.arange(0.5, max(line.length - dash_m, 0.6), every_m)
    return shapely.union_all([substring(line, start, start + dash_m) for start in starts])


def paint_mouths(streets: list[Street], paint: Paint, road: Colour, top_m: float) -> Iterator[Area]:
    """Broad dashes where side streets meet the edge of another."""
    if not paint.mouths:
        return
    grounds = np.array([street.carriageway for street in streets], dtype=object)
    tree = shapely.STRtree(grounds)
    for number, street in enumerate(streets):
        others = [k for k in tree.query(street.line, predicate="intersects") if k != number]
        for other in others:
            # Only those that end here: where streets cross, nothing is closed.
            ends = [shapely.Point(streets[other].line.coords[k]) for k in (0, -1)]
            if min(end.distance(street.line) for end in ends) > street.width_m:
                continue
            for aside in (-1, 1):
                edge = beside(street.line, aside * street.width_m / 2)
                for part in shapely.get_parts(edge.intersection(grounds[other].buffer(1.5))):
                    if isinstance(part, LineString) and 3.0 < part.length < 30.0:
                        for dash in shapely.get_parts(_stripe(_dashes(part, 0.6, 1.2), 0.14)):
                            if _filled(dash):
                                colour = faded(WHITE, road, paint.strength)
                                yield Area(dash, Kind.PLAIN, colour, top_m)


def paint_roads(
    streets: list[Street], paint: Paint, road: Colour, top_m: float = MARKING_M
) -> list[Area]:
    """Everything that is painted on a network of roads of two lanes."""
    areas = list(paint_mouths(streets, paint, road, top_m))
    for street, piece in free_pieces(streets):
        areas += paint_lines(street, piece, paint, road, top_m)
    return areas
