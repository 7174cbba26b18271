"""Houses of a suburb or the country: bungalows, two storeys, mobile homes; drives and sheds."""

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString, Polygon
from shapely.geometry.base import BaseGeometry

from slicemask.synth.layout.elements import Area, Building, Colour, Facade, Kind, Plan, Slot
from slicemask.synth.layout.palette import FLAT_ROOFS, TILED_ROOFS, draw_facade, vary_colour
from slicemask.synth.layout.streets import Style, rectangle

DRIVE_M = 0.08
BRICK: tuple[Colour, ...] = (
    (0.58, 0.34, 0.25), (0.66, 0.46, 0.34), (0.72, 0.60, 0.46), (0.50, 0.32, 0.27),
)  # fmt: skip
BOARDS: tuple[Colour, ...] = (
    (0.86, 0.85, 0.82), (0.74, 0.74, 0.68), (0.62, 0.68, 0.70), (0.80, 0.76, 0.64),
    (0.58, 0.60, 0.52), (0.70, 0.70, 0.72),
)  # fmt: skip
SHEET: tuple[Colour, ...] = (
    (0.72, 0.73, 0.74), (0.55, 0.57, 0.58), (0.50, 0.30, 0.26), (0.36, 0.44, 0.40),
    (0.85, 0.85, 0.84), (0.60, 0.50, 0.42),
)  # fmt: skip
SHINGLE: tuple[Colour, ...] = (
    (0.34, 0.33, 0.33), (0.44, 0.40, 0.36), (0.28, 0.28, 0.30), (0.50, 0.46, 0.42),
)  # fmt: skip
DRIVES: tuple[tuple[Kind, Colour], ...] = (
    (Kind.CONCRETE, (0.68, 0.66, 0.62)), (Kind.CONCRETE, (0.60, 0.52, 0.46)),
    (Kind.TAR, (0.36, 0.36, 0.36)), (Kind.GRAVEL, (0.62, 0.57, 0.49)),
    (Kind.DIRT, (0.52, 0.42, 0.32)),
)  # fmt: skip


@dataclass(frozen=True)
class Dwellings:
    """What the houses of a place have in common.

    Parameters
    ----------
    style
        Of the place.
    kinds
        Shares of bungalows, houses of two storeys, and mobile homes.
    walls, roofs
        Colours that neighbours share.
    sheet
        Whether roofs are metal sheets instead of tiles.
    drive
        Kind and colour of most drives.
    """

    style: Style
    kinds: tuple[float, ...]
    walls: tuple[Colour, ...]
    roofs: tuple[Colour, ...]
    sheet: bool
    drive: tuple[Kind, Colour]

    @classmethod
    def draw(cls, rng: np.random.Generator, style: Style) -> "Dwellings":
        """Draw a place's houses."""
        palette = (TILED_ROOFS, SHINGLE, SHEET)[rng.choice(3, p=[0.45, 0.3, 0.25])]
        walls = (*BRICK, *BOARDS)
        return cls(
            style=style,
            kinds=tuple(rng.dirichlet([2.0, 1.0, 0.4]).tolist()),
            walls=tuple(walls[k] for k in rng.choice(len(walls), 4, replace=False)),
            roofs=tuple(palette[k] for k in rng.choice(len(palette), 3, replace=False)),
            sheet=palette is SHEET,
            drive=DRIVES[rng.integers(len(DRIVES))],
        )

    def build(
        self,
        lot: Polygon,
        front: tuple[NDArray[np.float64], NDArray[np.float64]],
        setback_m: float,
        kerb: LineString,
        plan: Plan,
        rng: np.random.Generator,
    ) -> BaseGeometry:
        """Build a house on a lot, and give the ground that it and its drive take."""
        point, inward = front
        along = np.array([inward[1], -inward[0]])
        entry = _entry(lot, point, inward)
        kind = rng.choice(3, p=self.kinds)
        length, depth = (
            (rng.uniform(11, 19), rng.uniform(7.5, 11)),
            (rng.uniform(8, 14), rng.uniform(7.5, 10)),
            (rng.uniform(14, 20), rng.uniform(4, 5)),
        )[kind]
        if kind == 2 and rng.random() < 0.5:
            length, depth = depth, length
        room = lot.buffer(-0.8)
        for shrink in (1.0, 0.85, 0.7, 0.6):
            off = entry + (setback_m * rng.uniform(0.7, 1.3) * shrink + depth * shrink / 2) * inward
            house = rectangle(
                off + along * rng.normal(0, 1.2), along, length * shrink, depth * shrink
            )
            if room.contains(house):
                break
        else:
            return Polygon()
        taken: list[BaseGeometry] = [house]
        top = (2.7, 5.4, 2.9)[kind] + rng.uniform(0, 0.4)
        self._add(house, top, bool(kind == 2 and rng.random() < 0.7), plan, rng)
        side = rng.choice([-1, 1])
        middle = shapely.get_coordinates(house.centroid)[0]
        corner = middle + along * side * (length * shrink / 2 - 2.6)
        if kind != 2 and rng.random() < 0.65:  # a wing towards the street, often the garage
            depth_m = rng.uniform(3, 7)
            wide = rng.uniform(4.5, 7.0)
            wing = rectangle(
                corner - inward * (depth * shrink / 2 + depth_m / 2 - 1.0),
                inward,
                depth_m + 2.0,
                wide,
            )
            if room.contains(wing):
                self._add(wing, top - 0.15, False, plan, rng, plan.buildings[-1])
                taken.append(wing)
        elif rng.random() < 0.5:  # a garage or carport aside
            corner = middle + along * side * (length * shrink / 2 + 3.4)
        taken += self._drive(corner, kerb, shapely.union_all(taken), lot, plan, rng)
        if rng.random() < 0.45:
            taken += self._shed(middle + inward * rng.uniform(9, 18), along, room, taken, plan, rng)
        return shapely.union_all(taken)

    def _add(
        self,
        ground: Polygon,
        top_m: float,
        flat: bool,
        plan: Plan,
        rng: np.random.Generator,
        like: Building | None = None,
    ) -> None:
        facade = self.facade(rng) if like is None else like.facade
        roof = "flat" if flat else str(rng.choice(["gable", "hip"]))
        colour = vary_colour(rng, FLAT_ROOFS if flat else self.roofs, 0.08)
        if like is not None:
            roof, colour = like.roof, like.roof_colour
        kind = Kind.ROOF if flat or self.sheet else Kind.TILES
        plan.buildings.append(Building(ground, float(top_m), facade, colour, roof, 0.0, kind))

    def facade(self, rng: np.random.Generator) -> Facade:
        """Draw the look of a house."""
        colour = vary_colour(rng, self.walls, 0.08)
        drawn = draw_facade(self.style, "house", rng)
        return Facade(
            colour, drawn.window, drawn.shop, float(rng.uniform(2.6, 4.6)), 2.8,
            float(rng.uniform(0.3, 0.6)), float(rng.uniform(0.35, 0.5)), False,
            float(colour[0] > 1.25 * colour[2]),
        )  # fmt: skip

    def _drive(
        self,
        corner: NDArray[np.float64],
        kerb: LineString,
        houses: BaseGeometry,
        lot: Polygon,
        plan: Plan,
        rng: np.random.Generator,
    ) -> list[BaseGeometry]:
        """A drive to the street, with cars on it."""
        if rng.random() < 0.08:
            return []
        end = shapely.get_coordinates(kerb.interpolate(kerb.project(shapely.Point(corner))))[0]
        length = float(np.hypot(*(end - corner)))
        if not 3.0 < length < 45.0:
            return []
        along = (end - corner) / length
        width = rng.uniform(2.8, 5.5)
        path = rectangle((corner + end) / 2 + along * 0.3, along, length + 0.6, width)
        kind, colour = self.drive if rng.random() < 0.7 else DRIVES[rng.integers(len(DRIVES))]
        shape = path.difference(houses.buffer(0.05))
        for part in shapely.get_parts(shape):
            if isinstance(part, Polygon) and part.area > 1:
                plan.areas.append(Area(part, kind, vary_colour(rng, (colour,), 0.08), DRIVE_M))
        heading = float(np.degrees(np.arctan2(along[0], along[1])) % 360.0)
        for off in (0.45, 0.8):
            x, y = (corner + along * length * off).tolist()
            if length > 9 and lot.contains(shapely.Point(x, y)):
                plan.slots.append(Slot(x, y, heading, 0.35))
        return [path]

    def _shed(
        self,
        place: NDArray[np.float64],
        along: NDArray[np.float64],
        room: BaseGeometry,
        taken: list[BaseGeometry],
        plan: Plan,
        rng: np.random.Generator,
    ) -> list[BaseGeometry]:
        shed = rectangle(
            place + along * rng.uniform(-6, 6), along, rng.uniform(2.5, 7), rng.uniform(2.5, 5)
        )
        if not room.contains(shed) or shed.intersects(shapely.union_all(taken).buffer(1)):
            return []
        facade = Facade(vary_colour(rng, (*SHEET, *BOARDS)), (0.3, 0.3, 0.3), (0.3, 0.3, 0.3),
                        width=0.0)  # fmt: skip
        roof = "flat" if rng.random() < 0.5 else "gable"
        plan.buildings.append(Building(shed, 2.4, facade, vary_colour(rng, SHEET), roof))
        return [shed]


def _entry(
    lot: Polygon, point: NDArray[np.float64], inward: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Where the way from the street into a lot crosses the lot's border."""
    way = LineString([point, point + inward * 80.0]).intersection(lot)
    if way.is_empty:
        return point
    return point + inward * float(way.distance(shapely.Point(point)))
