"""Seasons: colours of leaves and grass, and trees that are bare."""

from dataclasses import dataclass, replace

import numpy as np

from slicemask.synth.layout.city import City
from slicemask.synth.layout.elements import Area, Colour, Kind, Tree

EVERGREEN = ("gum", "fir")
GREEN_GROUND = (Kind.GRASS, Kind.MEADOW, Kind.CROP)


@dataclass(frozen=True)
class Season:
    """What a season does to green.

    Parameters
    ----------
    leaves
        Colours that leaves turn to, each tree to one of them.
    turned
        How far they have, in [0, 1], on the average.
    bare
        Share of the deciduous trees without leaves.
    ground
        What grass turns to.
    withered
        How far it has, in [0, 1].
    """

    leaves: tuple[Colour, ...]
    turned: float
    bare: float
    ground: Colour
    withered: float


DRY: Colour = (0.58, 0.49, 0.32)
STRAW: Colour = (0.62, 0.56, 0.36)
LUSH: Colour = (0.26, 0.42, 0.14)
BROWN: Colour = (0.42, 0.35, 0.26)
AUTUMN: tuple[Colour, ...] = (
    (0.62, 0.30, 0.10), (0.66, 0.48, 0.14), (0.52, 0.16, 0.10), (0.45, 0.36, 0.16),
    (0.34, 0.38, 0.16),
)  # fmt: skip
SPRING: tuple[Colour, ...] = ((0.42, 0.52, 0.18), (0.36, 0.48, 0.16), (0.66, 0.56, 0.56))
SUMMER: tuple[Colour, ...] = ((0.28, 0.36, 0.17), (0.38, 0.38, 0.22))


def draw_season(rng: np.random.Generator) -> Season:
    """Draw a season and how far it has gone."""
    kind = rng.choice(5, p=[0.34, 0.2, 0.2, 0.12, 0.14])
    much = float(rng.uniform(0.2, 1.0))
    if kind == 0:
        return Season(SUMMER, 0.3 * much, 0.0, LUSH, much)
    if kind == 1:
        return Season(SUMMER, 0.6 * much, 0.0, DRY, much)
    if kind == 2:
        return Season(AUTUMN, much, 0.3 * much, STRAW, 0.7 * much)
    if kind == 3:
        return Season(AUTUMN, 0.8, 0.4 + 0.6 * much, BROWN, much)
    return Season(SPRING, much, 0.1, LUSH, much)


def dress(city: City, season: Season, rng: np.random.Generator) -> City:
    """Give a city its colours in a season; a tree turns alike whenever it does."""
    draws = rng.random((len(city.trees), 3))
    trees = tuple(_turn(tree, season, *draw) for tree, draw in zip(city.trees, draws, strict=True))
    areas = tuple(_wither(area, season) for area in city.areas)
    style = replace(city.style, grass=_mix(city.style.grass, season.ground, season.withered))
    return replace(city, trees=trees, areas=areas, style=style)


def _turn(tree: Tree, season: Season, which: float, early: float, falls: float) -> Tree:
    if tree.conifer or tree.species in EVERGREEN:
        return tree
    if falls < season.bare and tree.species in ("broad", "wood", "sparse"):
        return replace(tree, species="bare")
    colour = season.leaves[int(which * len(season.leaves))]
    return replace(tree, colour=_mix(tree.colour, colour, min(1.0, season.turned * 1.6 * early)))


def _wither(area: Area, season: Season) -> Area:
    if area.kind not in GREEN_GROUND:
        return area
    return replace(area, colour=_mix(area.colour, season.ground, 0.8 * season.withered))


def _mix(a: Colour, b: Colour, share: float) -> Colour:
    red, green, blue = (float((1 - share) * p + share * q) for p, q in zip(a, b, strict=True))
    return red, green, blue
