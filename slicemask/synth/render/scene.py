"""A city as one triangle mesh, with what each triangle is made of, and rays through it."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
import shapely
import trimesh
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import ArrayLike, NDArray

from slicemask.synth.layout.city import City
from slicemask.synth.layout.elements import (
    CAR_BODIES,
    Backdrop,
    Building,
    Car,
    Colour,
    Facade,
    Kind,
    Landmark,
    Tree,
)
from slicemask.synth.render import meshes
from slicemask.synth.render.foliage import foliage

View = Literal["ground", "aerial"]
# Numbers that describe a facade: pitch, storey, width, height, shops, bricks, top.
FACADE_NUMBERS = 7
NEAR_M = 16.0  # from a street, within which trees have finer leaves
FIELD_M = 1500.0  # of fields around the city
DARK: Colour = (0.06, 0.06, 0.065)


@dataclass(frozen=True)
class Surfaces:
    """What the surfaces are made of: S of them, each of one or more triangles.

    Parameters
    ----------
    kind : uint8 [S]
        See `Kind`.
    colour, window, shop : float32 [S, 3]
        The surface's colour; of walls also that of the glass and of the band above shops.
    facade : float32 [S, 7]
        Of walls: pitch_m, storey_m, width, height, shops, bricks, and the wall's top in metres; of
        grounds: the angle of their pattern in degrees, and zeros.
    """

    kind: NDArray[np.uint8]
    colour: NDArray[np.float32]
    window: NDArray[np.float32]
    shop: NDArray[np.float32]
    facade: NDArray[np.float32]


@dataclass(frozen=True)
class Hits:
    """What n rays meet first.

    Parameters
    ----------
    face : int32 [n]
        The triangle, or -1.
    distance_m : float32 [n]
        Along the ray, infinite where it meets nothing.
    """

    face: NDArray[np.int32]
    distance_m: NDArray[np.float32]


@dataclass(frozen=True)
class Scene:
    """A mesh that rays can be sent through.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        T triangles, no corner shared. Metres, x east, y north, z up.
    surface : int32 [T]
        The surface of each triangle.
    surfaces : Surfaces
        What they are made of.
    """

    mesh: trimesh.Trimesh
    surface: NDArray[np.int32]
    surfaces: Surfaces

    @cached_property
    def corners(self) -> NDArray[np.float32]:
        """Corners of the triangles, float32 [T, 3, 3]."""
        return np.ascontiguousarray(self.mesh.triangles, dtype=np.float32)

    @cached_property
    def normals(self) -> NDArray[np.float32]:
        """Unit normals of the triangles, float32 [T, 3]; either side may be the outer one."""
        a, b, c = np.moveaxis(np.asarray(self.mesh.triangles), 1, 0)
        normals = np.cross(b - a, c - a)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return np.asarray(normals / np.maximum(length, 1e-12), dtype=np.float32)

    @cached_property
    def _embree(self) -> Any:
        tree = EmbreeScene()
        # The tree does not keep its meshes alive by itself.
        return tree, TriangleMesh(tree, self.corners)

    def trace(self, origins: ArrayLike, directions: ArrayLike) -> Hits:
        """Send rays: origins and unit directions [n, 3]."""
        found = self._embree[0].run(*_rays(origins, directions), output=1)
        face = found["primID"]
        return Hits(face, np.where(face >= 0, found["tfar"], np.float32(np.inf)))

    def blocked(self, origins: ArrayLike, directions: ArrayLike) -> NDArray[np.bool_]:
        """Whether rays meet anything: bool [n]."""
        found = self._embree[0].run(*_rays(origins, directions), query="OCCLUDED")
        return np.asarray(found == 0)


def _rays(
    origins: ArrayLike, directions: ArrayLike
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    rays = np.broadcast_arrays(
        np.asarray(origins, dtype=np.float32), np.asarray(directions, dtype=np.float32)
    )
    return np.ascontiguousarray(rays[0]), np.ascontiguousarray(rays[1])


class SceneBuilder:
    """Collects triangles and their surfaces."""

    def __init__(self) -> None:
        self._soups: list[meshes.Soup] = []
        self._owners: list[NDArray[np.intp]] = []
        self._kinds: list[NDArray[np.uint8]] = []
        self._colours: list[NDArray[np.float32]] = []
        self._facades: list[NDArray[np.float32]] = []
        self._count = 0

    def add(
        self,
        soup: meshes.Soup,
        owner: NDArray[np.intp],
        kinds: Sequence[Kind] | NDArray[np.uint8],
        colours: Sequence[Colour],
        facades: Sequence[tuple[Facade, float]] | None = None,
        angles_deg: Sequence[float] | None = None,
    ) -> None:
        """Add triangles [T, 3, 3] whose `owner` [T] says which of the given surfaces is theirs.

        Walls come with a facade and the height of their top each, grounds with the angle of their
        pattern.
        """
        surfaces = len(colours)
        triple = np.zeros((surfaces, 3, 3), dtype=np.float32)
        triple[:, 0] = colours
        numbers = np.zeros((surfaces, FACADE_NUMBERS), dtype=np.float32)
        for row, (look, top) in enumerate(facades or ()):
            triple[row, 1:] = look.window, look.shop
            numbers[row] = (
                look.pitch_m,
                look.storey_m,
                look.width,
                look.height,
                look.shops,
                look.bricks,
                top,
            )
        if angles_deg is not None:
            numbers[:, 0] = angles_deg
        self._soups.append(soup)
        self._owners.append(np.asarray(owner) + self._count)
        self._kinds.append(np.asarray(kinds, dtype=np.uint8))
        self._colours.append(triple)
        self._facades.append(numbers)
        self._count += surfaces

    def build(self) -> Scene:
        """The scene of all that was added."""
        soup = np.concatenate(self._soups)
        colours = np.concatenate(self._colours)
        mesh = trimesh.Trimesh(
            vertices=soup.reshape(-1, 3),
            faces=np.arange(3 * len(soup)).reshape(-1, 3),
            process=False,
        )
        return Scene(
            mesh,
            np.concatenate(self._owners).astype(np.int32),
            Surfaces(
                np.concatenate(self._kinds),
                np.ascontiguousarray(colours[:, 0]),
                np.ascontiguousarray(colours[:, 1]),
                np.ascontiguousarray(colours[:, 2]),
                np.concatenate(self._facades),
            ),
        )


def build_scene(city: City, view: View) -> Scene:
    """Build the scene of a city with the cars of one of the views."""
    builder = SceneBuilder()
    _add_base(builder, city)
    _add_areas(builder, city)
    for building in city.buildings:
        _add_roof(builder, building)
    _add_walls(builder, city.buildings)
    _add_trees(builder, [tree for tree in city.trees if not tree.species])
    leafy = [tree for tree in city.trees if tree.species]
    for part in foliage(leafy, _near_streets(city, leafy)):
        builder.add(*part)
    _add_lamps(builder, city.lamps)
    for backdrop in city.backdrops:
        _add_backdrop(builder, backdrop)
    for landmark in city.landmarks:
        add_landmark(builder, landmark)
    _add_cars(builder, city.cars_ground if view == "ground" else city.cars_aerial)
    return builder.build()


def _near_streets(city: City, trees: Sequence[Tree]) -> NDArray[np.bool_]:
    """Whether trees stand so near to a street that their leaves show, bool [n]."""
    near = np.zeros(len(trees), dtype=bool)
    points = shapely.points([(tree.x, tree.y) for tree in trees] or np.empty((0, 2)))
    lines = shapely.STRtree([street.line for street in city.streets])
    near[lines.query(points, predicate="dwithin", distance=NEAR_M)[0]] = True
    return near


def _flat(x0: float, y0: float, x1: float, y1: float, z: float) -> meshes.Soup:
    a, b, c, d = (x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)
    return np.array([[a, b, c], [a, c, d]])


def _add_base(builder: SceneBuilder, city: City) -> None:
    """The base that all else lies on, asphalt by default, and fields around it."""
    e = city.half_extent_m
    soup = np.concatenate(
        [_flat(-e, -e, e, e, 0.0), _flat(-FIELD_M, -FIELD_M, FIELD_M, FIELD_M, -0.3)]
    )
    builder.add(
        soup,
        np.array([0, 0, 1, 1]),
        (city.base[0], Kind.GRASS),
        (city.base[1], city.style.grass),
    )


def _add_areas(builder: SceneBuilder, city: City) -> None:
    """Grounds, one on another, each with sides so that no ray slips in below it."""
    if not city.areas:
        return
    polygons = meshes.as_polygons([area.polygon for area in city.areas])
    top = np.array([area.top_m for area in city.areas])
    soup, owner, _ = meshes.prisms(polygons, 0.0, top)
    builder.add(
        soup,
        owner,
        [area.kind for area in city.areas],
        [area.colour for area in city.areas],
        angles_deg=[area.angle_deg for area in city.areas],
    )


def _add_walls(builder: SceneBuilder, buildings: Sequence[Building]) -> None:
    if not buildings:
        return
    polygons = meshes.as_polygons([building.footprint for building in buildings])
    base = [building.base_m for building in buildings]
    soup, owner, side = meshes.prisms(polygons, base, [building.top_m for building in buildings])
    builder.add(
        soup[side],
        owner[side],
        [Kind.WALL] * len(buildings),
        [building.facade.colour for building in buildings],
        [(building.facade, building.top_m) for building in buildings],
    )


def _add_roof(builder: SceneBuilder, building: Building) -> None:
    """A pitched roof, or a flat one with a parapet and machines on it."""
    colour, facade = building.roof_colour, building.facade
    if building.roof != "flat":
        slopes, gables = meshes.pitched_roof(building)
        soup = np.concatenate([slopes, gables])
        owner = np.repeat([0, 1], [len(slopes), len(gables)])
        builder.add(soup, owner, (building.roof_kind, Kind.PLAIN), (colour, facade.colour))
        if building.footprint.area > 60.0:  # a chimney
            x, y = building.footprint.exterior.interpolate(0.3, normalized=True).coords[0]
            centre = building.footprint.centroid
            x, y = 0.6 * x + 0.4 * centre.x, 0.6 * y + 0.4 * centre.y
            _add_box(builder, x, y, building.top_m, (0.45, 0.35, 2.6), 0.0, (0.42, 0.28, 0.24))
        return
    footprint, top = building.footprint, building.top_m
    inside = footprint.buffer(-0.35, join_style="mitre")
    if building.base_m > 0 or inside.is_empty or footprint.area < 30.0:
        soup, _, side = meshes.prisms(meshes.as_polygons([footprint]), 0.0, top)
        soup = soup[~side]
        builder.add(soup, np.zeros(len(soup), dtype=np.intp), (building.roof_kind,), (colour,))
        return
    rim = meshes.as_polygons([footprint.difference(inside)])
    soup, _, side = meshes.prisms(rim, top - 0.45, top)
    lid, _, edge = meshes.prisms(meshes.as_polygons([footprint]), 0.0, top - 0.45)
    owner = np.concatenate([np.where(side, 1, 0), np.full(int((~edge).sum()), 2)])
    light = (min(colour[0] * 1.2, 0.9), min(colour[1] * 1.2, 0.9), min(colour[2] * 1.2, 0.9))
    builder.add(
        np.concatenate([soup, lid[~edge]]),
        owner,
        (Kind.PLAIN, Kind.PLAIN, building.roof_kind),
        (light, facade.colour, colour),
    )
    # Machines, stair heads: where and how large follows from the footprint, not from a draw.
    rng = np.random.default_rng(np.abs(np.array(footprint.bounds) * 100).astype(np.uint64))
    room = footprint.buffer(-2.2)
    if room.is_empty or top < 4.0:
        return
    west, south, east, north = room.bounds
    ring = np.asarray(footprint.exterior.coords)
    heading = float(np.degrees(np.arctan2(*(ring[1] - ring[0]))))
    for _ in range(int(rng.poisson(1.0 + footprint.area / 220.0))):
        x, y = rng.uniform((west, south), (east, north))
        if shapely.contains_xy(room, x, y):
            size = rng.uniform((0.6, 0.6, 0.5), (2.0, 1.6, 1.8))
            grey = rng.uniform(0.4, 0.85)
            _add_box(builder, x, y, top - 0.45, tuple(size), heading, (grey, grey, grey * 0.98))


def _add_box(
    builder: SceneBuilder,
    x: float,
    y: float,
    z: float,
    size: tuple[float, ...],
    heading_deg: float,
    colour: Colour,
) -> None:
    half_x, half_y, height = size
    box, _ = meshes.hexahedron(-half_x, half_x, half_y, 0.0, height, 0.0, 0.0)
    soup = meshes.instances(box, x, y, z, (1, 1, 1), heading_deg)
    builder.add(soup, np.zeros(len(soup), dtype=np.intp), (Kind.PLAIN,), (colour,))


def _add_trees(builder: SceneBuilder, trees: Sequence[Tree]) -> None:
    kinds = np.array([0 if tree.conifer else 1 + number % 5 for number, tree in enumerate(trees)])
    for kind in np.unique(kinds):
        chosen = [tree for tree, k in zip(trees, kinds, strict=True) if k == kind]
        x, y, height, radius = (
            np.array([getattr(tree, name) for tree in chosen])
            for name in ("x", "y", "height_m", "radius_m")
        )
        bare = height * (0.12 if kind == 0 else 0.32)  # of the trunk, below the crown
        template = meshes.crown(int(kind))
        # A crown of unit height reaches from 0.03 to 0.9 of it.
        tall = (height - bare) * (1.0 if kind == 0 else 1.15)
        rotation_deg = 137.5 * np.arange(len(chosen))
        crowns = meshes.instances(
            template, x, y, bare, np.column_stack([radius, radius, tall]), rotation_deg
        )
        owner = np.repeat(np.arange(len(chosen)), len(template))
        colours = [tree.colour for tree in chosen]
        builder.add(crowns, owner, [Kind.LEAVES] * len(chosen), colours)
        trunk = meshes.tube(6)
        width = 0.05 * radius + 0.07
        scale = np.column_stack([width, width, bare + 0.45 * (height - bare)])
        trunks = meshes.instances(trunk, x, y, np.zeros(len(x)), scale, rotation_deg)
        builder.add(
            trunks, np.zeros(len(trunks), dtype=np.intp), (Kind.PLAIN,), ((0.28, 0.22, 0.17),)
        )


def _add_backdrop(builder: SceneBuilder, backdrop: Backdrop) -> None:
    """A curtain around the place."""
    heights = np.asarray(backdrop.heights_m)
    angle = np.linspace(0, 2 * np.pi, len(heights), endpoint=False)
    ring = np.stack([np.sin(angle), np.cos(angle)], axis=1) * backdrop.radius_m
    low = np.column_stack([ring, np.full(len(ring), -1.0)])
    high = np.column_stack([ring, heights - 0.9])
    after = np.roll(np.arange(len(ring)), -1)
    soup = np.concatenate(
        [
            np.stack([low, low[after], high[after]], axis=1),
            np.stack([low, high[after], high], axis=1),
        ]
    )
    builder.add(soup, np.zeros(len(soup), dtype=np.intp), (Kind.LEAVES,), (backdrop.colour,))


def _add_lamps(builder: SceneBuilder, lamps: Sequence[tuple[float, float, float]]) -> None:
    if not lamps:
        return
    x, y, heading = np.array(lamps).T
    pole = meshes.tube(6) * [0.07, 0.07, 7.0]
    arm = meshes.tube(6)[..., [0, 2, 1]] * [0.05, 1.8, 0.05] + [0, 0, 6.9]
    lamp, _ = meshes.hexahedron(-0.14, 0.14, 0.35, 6.8, 6.95, 0.0, 0.0)
    soup = meshes.instances(
        np.concatenate([pole, arm, np.add(lamp, (0, 1.7, 0))]),
        x, y, np.zeros(len(x)), (1, 1, 1), heading,
    )  # fmt: skip
    builder.add(soup, np.zeros(len(soup), dtype=np.intp), (Kind.PLAIN,), ((0.3, 0.31, 0.32),))


def add_landmark(builder: SceneBuilder, landmark: Landmark) -> None:
    """Add a landmark to a scene."""
    r, h = landmark.radius_m, landmark.height_m
    pale: Colour = (0.72, 0.70, 0.66)
    if landmark.shape == "column":
        parts = [
            (meshes.tube(14) * [1.35 * r, 1.35 * r, 0.15 * h], pale),
            (meshes.tube(14) * [r, r, h], landmark.colour),
        ]
    elif landmark.shape == "dome":
        drum = meshes.tube(20) * [r, r, 0.4 * h]
        parts = [(drum, pale), (meshes.dome() * [1.1 * r, 1.1 * r, 0.6 * h] + [0, 0, 0.4 * h],
                                landmark.colour)]  # fmt: skip
    elif landmark.shape == "pylon":
        mast, _ = meshes.hexahedron(-r, r, r, 0.0, h, 0.8 * r, 0.8 * r)
        parts = [(mast, landmark.colour), (meshes.tube(14) * [1.8 * r, 1.8 * r, 0.5], pale)]
    else:
        hut, _ = meshes.hexahedron(-r, r, r, 0.0, 0.8 * h, 0.0, 0.0)
        roof, _ = meshes.hexahedron(-1.3 * r, 1.3 * r, 1.3 * r, 0.8 * h, h, r, r)
        parts = [(hut, pale), (roof, landmark.colour)]
    for part, colour in parts:
        soup = meshes.instances(part, landmark.x, landmark.y, 0.0, (1, 1, 1), 0.0)
        builder.add(soup, np.zeros(len(soup), dtype=np.intp), (Kind.PAINT,), (colour,))


def _add_cars(builder: SceneBuilder, cars: Iterable[Car]) -> None:
    cars = list(cars)
    for body in range(len(CAR_BODIES)):
        chosen = [car for car in cars if car.body == body]
        if not chosen:
            continue
        template, parts = meshes.car(body)
        x, y, heading = np.array([(car.x, car.y, car.heading_deg) for car in chosen]).T
        soup = meshes.instances(template, x, y, np.zeros(len(x)), (1, 1, 1), heading)
        owner = (3 * np.arange(len(chosen))[:, None] + parts).reshape(-1)
        colours = [colour for car in chosen for colour in (car.colour, DARK, DARK)]
        builder.add(soup, owner, [Kind.PAINT, Kind.GLASS, Kind.PLAIN] * len(chosen), colours)
