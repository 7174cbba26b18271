"""What a generated city is made of. Metres, x east, y north, z up; colours are RGB in [0, 1]."""

from dataclasses import dataclass, field
from enum import IntEnum

from shapely.geometry import Polygon

Colour = tuple[float, float, float]

# Length, width, height of the waist and of the roof, and where the cabin starts and ends behind the
# nose, metres: saloon, hatchback, van, lorry.
CAR_BODIES = (
    (4.5, 1.80, 0.85, 1.45, 1.3, 3.9),
    (3.9, 1.75, 0.90, 1.50, 1.0, 3.8),
    (4.9, 1.95, 1.10, 2.00, 0.7, 4.8),
    (7.2, 2.30, 1.20, 2.90, 0.2, 2.0),
)


class Kind(IntEnum):
    """The kinds of surface, each with a texture of its own (see `materials`)."""

    PLAIN = 0
    ASPHALT = 1
    PAVING = 2
    GRASS = 3
    WALL = 4
    ROOF = 5
    TILES = 6
    LEAVES = 7
    PAINT = 8
    GLASS = 9
    WATER = 10
    GRAVEL = 11
    CONCRETE = 12
    SOIL = 13
    CROP = 14
    MEADOW = 15
    LITTER = 16
    TAR = 17
    DIRT = 18
    FOLIAGE = 19


@dataclass(frozen=True)
class Area:
    """A piece of ground whose top lies at `top_m`, with sides down to the street.

    Patterns that have a direction, such as rows of crops, run at `angle_deg`.
    """

    polygon: Polygon
    kind: Kind
    colour: Colour
    top_m: float
    angle_deg: float = 0.0


@dataclass(frozen=True)
class Facade:
    """The look of walls: windows of a size on a grid, and the ground floor.

    Parameters
    ----------
    colour, window, shop
        Of the wall, of the glass, and of the band above the ground floor.
    pitch_m, storey_m
        The grid of windows.
    width, height
        Shares of the grid that a window takes; 0 leaves the wall blank, a width of 1 makes bands.
    shops
        Whether the ground floor is glass with a coloured band above.
    bricks
        Strength of the brick courses.
    """

    colour: Colour
    window: Colour
    shop: Colour
    pitch_m: float = 2.6
    storey_m: float = 3.1
    width: float = 0.45
    height: float = 0.5
    shops: bool = False
    bricks: float = 0.0


@dataclass(frozen=True)
class Building:
    """A building: a footprint from `base_m` up to `top_m`, and its roof.

    A pitched roof needs a footprint of four corners; its ridge runs along the first side.
    """

    footprint: Polygon
    top_m: float
    facade: Facade
    roof_colour: Colour
    roof: str = "flat"  # or "gable", "hip"
    base_m: float = 0.0
    roof_kind: Kind = Kind.ROOF


@dataclass(frozen=True)
class Tree:
    """A tree: its trunk's place, its height and the radius of its crown.

    A species is one of `slicemask.synth.render.foliage.SPECIES`, whose crowns are made of leaves;
    without one, crowns are lumps.
    """

    x: float
    y: float
    height_m: float
    radius_m: float
    conifer: bool
    colour: Colour
    species: str = ""


@dataclass(frozen=True)
class Slot:
    """A place where a car may stand, and how likely one does."""

    x: float
    y: float
    heading_deg: float
    chance: float


@dataclass(frozen=True)
class Car:
    """A car: its middle, where it heads, its body (an index into `CAR_BODIES`), paint."""

    x: float
    y: float
    heading_deg: float
    body: int
    colour: Colour


@dataclass(frozen=True)
class Landmark:
    """A thing that is found once: a coloured column, dome, pylon or kiosk."""

    x: float
    y: float
    shape: str  # "column", "dome", "pylon" or "kiosk"
    height_m: float
    radius_m: float
    colour: Colour


@dataclass(frozen=True)
class Backdrop:
    """What stands around a place, far off: heights at even azimuths from north, at a radius."""

    radius_m: float
    heights_m: tuple[float, ...]
    colour: Colour


@dataclass
class Plan:
    """Elements as they are laid out."""

    areas: list[Area] = field(default_factory=list)
    buildings: list[Building] = field(default_factory=list)
    trees: list[Tree] = field(default_factory=list)
    slots: list[Slot] = field(default_factory=list)
    landmarks: list[Landmark] = field(default_factory=list)
