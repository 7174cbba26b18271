"""Streets of a generated city: a bent, broken grid of lines, and what is painted on them.

The frame of all of `slicemask.synth`: metres, x east, y north, z up, the city's centre at (0, 0).
Headings stay degrees clockwise from north.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString, Polygon
from shapely.geometry.base import BaseGeometry
from shapely.ops import substring

LANE_M = 3.2
PARKING_M = 2.2
WHITE, YELLOW = (0.74, 0.74, 0.71), (0.74, 0.58, 0.18)


@dataclass(frozen=True)
class Style:
    """What the streets and blocks of one city have in common.

    Parameters
    ----------
    angle_deg
        The grid's rotation against the tiles, counter-clockwise.
    block_m
        Typical length and depth of a block, metres.
    stagger
        Chance that a cross street is shifted, so that it ends in T-junctions.
    bend_m
        How far streets bend from straight lines, metres.
    diagonals
        Number of avenues that cut across the grid.
    centre_line
        Colour of the centre line.
    zones
        Weights of houses, rows, towers, retail, parks and mixed blocks.
    downtown
        Where towers are highest, metres.
    wall_hue, pavement, grass, tree_density
        Palette and greenery.
    """

    angle_deg: float
    block_m: tuple[float, float]
    stagger: float
    bend_m: float
    diagonals: int
    centre_line: tuple[float, float, float]
    zones: tuple[float, ...]
    downtown: tuple[float, float]
    wall_hue: float
    pavement: tuple[float, float, float]
    grass: tuple[float, float, float]
    tree_density: float

    @classmethod
    def draw(cls, rng: np.random.Generator, half_extent_m: float) -> "Style":
        """Draw a city's style."""
        grey = rng.uniform(0.50, 0.66)
        return cls(
            angle_deg=float(rng.uniform(-45, 45)),
            block_m=(float(rng.uniform(75, 120)), float(rng.uniform(55, 80))),
            stagger=float(rng.uniform(0.1, 0.8)),
            bend_m=float(rng.uniform(1, 9)),
            diagonals=int(rng.integers(0, 3)),
            centre_line=YELLOW if rng.random() < 0.5 else WHITE,
            zones=tuple(rng.dirichlet([5.0, 5.0, 3.0, 2.0, 1.6, 5.0]).tolist()),
            downtown=tuple(rng.uniform(-0.5, 0.5, 2) * half_extent_m),
            wall_hue=float(rng.uniform(-0.04, 0.04)),
            pavement=(grey, grey * rng.uniform(0.95, 1.0), grey * rng.uniform(0.85, 0.98)),
            grass=(rng.uniform(0.25, 0.38), rng.uniform(0.36, 0.44), rng.uniform(0.16, 0.22)),
            tree_density=float(rng.uniform(0.5, 1.3)),
        )


@dataclass(frozen=True)
class Street:
    """A street: its centre line, number of lanes (even, half of them each way) and parking."""

    line: LineString
    lanes: int
    parking: bool
    lane_m: float = LANE_M

    @property
    def width_m(self) -> float:
        """Width of the carriageway from kerb to kerb."""
        return self.lanes * self.lane_m + (2 * PARKING_M if self.parking else 0.0) + 0.4

    @property
    def carriageway(self) -> BaseGeometry:
        """The ground between the kerbs."""
        return self.line.buffer(self.width_m / 2, cap_style="flat")

    def drive(self, lane: int) -> LineString:
        """The middle of a lane, in the direction of travel (traffic keeps to the right).

        Lanes 0 to lanes/2 - 1 run along the line, from the centre outwards, the others against it.
        """
        half = self.lanes // 2
        forward = lane < half
        offset_m = (lane % half + 0.5) * self.lane_m
        line = beside(self.line, -offset_m if forward else offset_m)
        return line if forward else line.reverse()


def beside(line: LineString, left_m: float) -> LineString:
    """The line that runs beside another, to its left; where it breaks up, the longest part."""
    parts = shapely.get_parts(line.offset_curve(left_m))
    longest: LineString = max(parts, key=lambda part: part.length)
    return longest


def lay_streets(style: Style, half_extent_m: float, rng: np.random.Generator) -> list[Street]:
    """Lay the streets of a square city that reaches `half_extent_m` from its centre."""
    reach = half_extent_m * 1.5 + 60.0
    length, depth = style.block_m
    rows = np.cumsum(rng.uniform(0.75, 1.3, int(2.6 * reach / depth)) * depth) - reach
    columns = np.cumsum(rng.uniform(0.75, 1.3, int(2.6 * reach / length)) * length) - reach
    bend = _Bend(style, rng)
    square = shapely.box(-half_extent_m, -half_extent_m, half_extent_m, half_extent_m)
    streets: list[Street] = []

    def add(start: tuple[float, float], end: tuple[float, float], lanes: int) -> None:
        line = bend.line(start, end)
        parking = bool(lanes == 2 and rng.random() < 0.75)
        inside = shapely.intersection(line, square)
        streets.extend(
            Street(part, lanes, parking)
            for part in shapely.get_parts(inside)
            if isinstance(part, LineString) and part.length > 15.0
        )

    avenue_rows = rng.random(len(rows)) < 0.22
    avenue_columns = rng.random(len(columns)) < 0.18
    for y, avenue in zip(rows, avenue_rows, strict=True):
        add((-reach, y), (reach, y), 4 if avenue else 2)
    for x in columns[avenue_columns]:
        add((x, -reach), (x, reach), 4)
    for south, north in pairwise(rows):
        for x in columns[~avenue_columns]:
            shift = rng.uniform(-0.3, 0.3) * length if rng.random() < style.stagger else 0.0
            if rng.random() > 0.1:
                add((x + shift, south), (x + shift, north), 2)
    for _ in range(style.diagonals):
        x, y = rng.uniform(-0.6, 0.6, 2) * half_extent_m
        angle = np.radians(rng.uniform(25, 65) * rng.choice([-1, 1]))
        dx, dy = 2 * reach * np.cos(angle), 2 * reach * np.sin(angle)
        add((x - dx, y - dy), (x + dx, y + dy), 4)
    return streets


class _Bend:
    """A smooth map of the plane that bends straight streets, then rotates the grid."""

    def __init__(self, style: Style, rng: np.random.Generator):
        self._waves = rng.uniform(-1, 1, (3, 2)) * 2 * np.pi / 320.0
        self._phases = rng.uniform(0, 2 * np.pi, 3)
        self._sides = rng.uniform(-1, 1, (3, 2)) * style.bend_m
        angle = np.radians(style.angle_deg)
        self._rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    def line(self, start: tuple[float, float], end: tuple[float, float]) -> LineString:
        """Bend the straight line between two points."""
        a, b = np.array(start), np.array(end)
        steps = max(2, int(np.hypot(*(b - a)) / 8.0) + 1)
        points = a + np.linspace(0, 1, steps)[:, None] * (b - a)
        bent = points + np.sin(points @ self._waves.T + self._phases) @ self._sides
        return LineString(bent @ self._rotation.T)


def free_pieces(streets: list[Street]) -> Iterator[tuple[Street, LineString]]:
    """Give each street's stretches between junctions, as pieces of its centre line."""
    carriageways = np.array([street.carriageway for street in streets], dtype=object)
    tree = shapely.STRtree(carriageways)
    for number, street in enumerate(streets):
        near = tree.query(carriageways[number], predicate="intersects")
        others = shapely.union_all(carriageways[near[near != number]])
        # Junctions have rounded corners, so a stretch ends a little before them.
        for piece in shapely.get_parts(shapely.difference(street.line, others.buffer(2.0))):
            if isinstance(piece, LineString) and piece.length > 14.0:
                yield street, piece


def point_and_direction(
    line: LineString, along_m: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The point at a length along a line and the direction there, both float64 [2]."""
    along_m = min(max(along_m, 0.0), line.length)
    a, b = shapely.get_coordinates(
        shapely.line_interpolate_point(
            line, [max(along_m - 0.5, 0), min(along_m + 0.5, line.length)]
        )
    )
    point = shapely.get_coordinates(shapely.line_interpolate_point(line, along_m))[0]
    return point, (b - a) / np.hypot(*(b - a))


def patch(
    centre: NDArray[np.float64], along: NDArray[np.float64], shape: NDArray[np.float64]
) -> Polygon:
    """Place a polygon given in metres (along, to the left) [n, 2] at a point."""
    left = np.array([-along[1], along[0]])
    return Polygon(centre + shape[:, :1] * along + shape[:, 1:] * left)


def rectangle(
    centre: NDArray[np.float64], along: NDArray[np.float64], length_m: float, width_m: float
) -> Polygon:
    """A rectangle around a point, its length along a direction."""
    half = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2.0
    return patch(centre, along, half * [length_m, width_m])


STRAIGHT = np.array(
    [[-2.2, -0.1], [0.4, -0.1], [0.4, -0.5], [2.2, 0.0], [0.4, 0.5], [0.4, 0.1], [-2.2, 0.1]]
)
TURN_LEFT = np.array(
    [[-2.2, -0.1], [0.9, -0.1], [0.9, 0.5], [1.35, 0.5], [0.75, 1.35], [0.15, 0.5], [0.6, 0.5],
     [0.6, 0.1], [-2.2, 0.1]]
)  # fmt: skip


def paint_markings(
    style: Style, street: Street, piece: LineString, rng: np.random.Generator
) -> Iterator[tuple[Polygon, tuple[float, float, float]]]:
    """Give the markings of a stretch between junctions: lines, crossings, stop lines, arrows."""
    clear = 7.0  # of the crossing and the stop line, at both ends
    middle = substring(piece, clear, piece.length - clear)
    if middle.length > 2.0:
        if street.lanes > 2:
            for side in (-0.15, 0.15):
                yield _stripe(beside(middle, side), 0.11), style.centre_line
            for lane in range(1, street.lanes // 2):
                for side in (-1, 1):
                    line = beside(middle, side * lane * LANE_M)
                    yield from ((dash, WHITE) for dash in _dashes(line, 3.0, 9.0, 0.13))
        else:
            yield from ((dash, style.centre_line) for dash in _dashes(middle, 3.0, 7.0, 0.13))
        if street.parking:
            for side in (-1, 1):
                yield _stripe(beside(middle, side * (LANE_M + 0.1)), 0.10), WHITE
    half = street.lanes // 2
    kind = rng.random()
    for line in (piece, piece.reverse()):  # each end, as its traffic reaches it
        end = line.length
        point, along = point_and_direction(line, end - 2.2)
        across = np.array([-along[1], along[0]])
        if kind < 0.7:
            offsets = np.arange(-street.width_m / 2 + 0.6, street.width_m / 2 - 0.3, 1.1)
            for offset in offsets:
                yield rectangle(point + offset * across, along, 3.2, 0.5), WHITE
        else:
            for offset in (-1.6, 1.6):
                yield rectangle(point + offset * along, across, street.width_m - 0.6, 0.3), WHITE
        point, along = point_and_direction(line, end - 5.0)
        right = -np.array([-along[1], along[0]])
        lanes_m = half * LANE_M
        yield rectangle(point + right * lanes_m / 2, right, lanes_m - 0.3, 0.4), WHITE
        if end > 30.0 and (half > 1 or kind < 0.35):
            point, along = point_and_direction(line, end - 10.0)
            for lane in range(half):
                centre = point + right * (lane + 0.5) * LANE_M
                shape = STRAIGHT if rng.random() < 0.5 else TURN_LEFT * [1, 1 if lane == 0 else -1]
                yield patch(centre, along, shape), WHITE


def _stripe(line: LineString, width_m: float) -> Polygon:
    return line.buffer(width_m / 2, cap_style="flat")


def _dashes(line: LineString, dash_m: float, every_m: float, width_m: float) -> list[Polygon]:
    starts = np.arange(0.5, line.length - dash_m, every_m)
    return [_stripe(substring(line, start, start + dash_m), width_m) for start in starts]
