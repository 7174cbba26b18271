"""Triangles of the city's elements: prisms, pitched roofs, trees, cars, lamps and landmarks.

Everything is a "soup": float64 [T, 3, 3], T triangles of three corners x, y, z.
"""

from functools import cache

import numpy as np
import shapely
import trimesh
from numpy.typing import ArrayLike, NDArray
from shapely.geometry import Polygon

from slicemask.synth.layout.elements import CAR_BODIES, Building

Soup = NDArray[np.float64]


def prisms(
    polygons: NDArray[np.object_], bottom_m: ArrayLike, top_m: ArrayLike
) -> tuple[Soup, NDArray[np.intp], NDArray[np.bool_]]:
    """Upright prisms over polygons, without bottoms.

    Parameters
    ----------
    polygons : object [n]
        Shapely polygons, holes allowed.
    bottom_m, top_m : float [n]
        Heights.

    Returns
    -------
    soup : float64 [T, 3, 3]
        On a side, corner 0 is the lower end of the wall's start and corner 1 lies at its end, so
        that lengths along the wall can be measured from corner 0.
    owner : int [T]
        The polygon that each triangle belongs to.
    side : bool [T]
        Whether a triangle is part of a side.
    """
    bottom = np.broadcast_to(np.asarray(bottom_m, dtype=float), len(polygons))
    top = np.broadcast_to(np.asarray(top_m, dtype=float), len(polygons))
    caps, cap_owner = triangulate(polygons)
    cap_soup = np.concatenate(
        [caps, np.broadcast_to(top[cap_owner][:, None, None], (*caps.shape[:2], 1))], axis=2
    )
    rings, ring_owner = shapely.get_rings(shapely.orient_polygons(polygons), return_index=True)
    points, ring = shapely.get_coordinates(rings, return_index=True)
    joined = ring[:-1] == ring[1:]
    a, b, owner = points[:-1][joined], points[1:][joined], ring_owner[ring[:-1][joined]]

    def lift(flat: NDArray[np.float64], height: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.column_stack([flat, height])

    low, high = bottom[owner], top[owner]
    walls = np.stack(
        [
            np.stack([lift(a, low), lift(b, low), lift(b, high)], axis=1),
            np.stack([lift(a, low), lift(b, high), lift(a, high)], axis=1),
        ],
        axis=1,
    ).reshape(-1, 3, 3)
    soup = np.concatenate([cap_soup, walls])
    owners = np.concatenate([cap_owner, np.repeat(owner, 2)])
    return soup, owners, np.arange(len(soup)) >= len(cap_soup)


def triangulate(polygons: NDArray[np.object_]) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Cut polygons into triangles: float64 [T, 3, 2], counter-clockwise, and owners int [T]."""
    cut = shapely.constrained_delaunay_triangles(polygons)
    parts, owner = shapely.get_parts(cut, return_index=True)
    triangles = shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3]
    (ax, ay), (bx, by) = np.moveaxis(triangles[:, 1:] - triangles[:, :1], 0, -1)
    clockwise = ax * by - ay * bx < 0
    triangles[clockwise] = triangles[clockwise][:, ::-1]
    return triangles, owner


def pitched_roof(
    building: Building, slope: float = 0.55, eaves_m: float = 0.5
) -> tuple[Soup, Soup]:
    """The sloping sides of a gable or hip roof, and the gable walls, over four corners."""
    corners = shapely.get_coordinates(shapely.orient_polygons(building.footprint))[:4]
    if np.hypot(*(corners[1] - corners[0])) < np.hypot(*(corners[2] - corners[1])):
        corners = np.roll(corners, -1, axis=0)
    along = (corners[1] - corners[0]) / np.hypot(*(corners[1] - corners[0]))
    left = np.array([-along[1], along[0]])
    width = float(np.hypot(*(corners[2] - corners[1])))
    rise = slope * width / 2
    hip = building.roof == "hip"
    inward = along * (width / 2 * 0.9 if hip else 0.0)
    ends = (corners[0] + corners[3]) / 2 + inward, (corners[1] + corners[2]) / 2 - inward
    out = along * eaves_m
    wide = left * eaves_m
    rim = np.array(
        [
            corners[0] - out - wide,
            corners[1] + out - wide,
            corners[2] + out + wide,
            corners[3] - out + wide,
        ]
    )
    low = building.top_m - slope * eaves_m
    a, b, c, d = np.column_stack([rim, np.full(4, low)])
    ridge = ends if hip else (ends[0] - out, ends[1] + out)
    e, f = (np.append(end, building.top_m + rise) for end in ridge)
    slopes = [[a, b, f], [a, f, e], [c, d, e], [c, e, f]]
    if hip:
        return np.array([*slopes, [d, a, e], [b, c, f]]), np.empty((0, 3, 3))
    k0, k1, k2, k3 = np.column_stack([corners, np.full(4, building.top_m)])
    tops = [np.append(end, building.top_m + rise) for end in ends]
    return np.array(slopes), np.array([[k3, k0, tops[0]], [k1, k2, tops[1]]])


@cache
def crown(kind: int) -> Soup:
    """A tree's crown of unit radius and height, standing on z = 0: a lumpy ball or cones."""
    if kind == 0:
        cones = [
            np.add(
                trimesh.creation.cone(radius=radius, height=height, sections=10).triangles,
                (0, 0, base),
            )
            for radius, height, base in ((1.0, 0.45, 0.0), (0.78, 0.4, 0.28), (0.5, 0.4, 0.6))
        ]
        return np.concatenate(cones)
    ball = trimesh.creation.icosphere(subdivisions=2)
    rng = np.random.default_rng(kind)
    vertices = np.asarray(ball.vertices)
    waves = rng.normal(0, 2.2, (5, 3))
    lumps = 1.0 + 0.11 * np.sin(vertices @ waves.T + rng.uniform(0, 6.3, 5)).sum(axis=1)
    lumps *= rng.uniform(0.93, 1.05, len(vertices))
    vertices = vertices * lumps[:, None] / 1.12
    vertices[:, 2] = np.maximum(vertices[:, 2], -0.75)
    return np.asarray((vertices * [1, 1, 0.5] + [0, 0, 0.4])[ball.faces])


@cache
def tube(sides: int) -> Soup:
    """An upright cylinder of unit radius from z = 0 to z = 1."""
    cylinder = trimesh.creation.cylinder(radius=1.0, height=1.0, sections=sides)
    return np.asarray(np.add(cylinder.triangles, (0.0, 0.0, 0.5)))


@cache
def dome() -> Soup:
    """Half a ball of unit radius on z = 0."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    return np.asarray(np.maximum(ball.triangles, (-2.0, -2.0, 0.0)))


def hexahedron(
    x0: float, x1: float, half_width: float, z0: float, z1: float, taper: float, lean: float
) -> tuple[Soup, NDArray[np.bool_]]:
    """A box whose top is narrower; the second result says which triangles make the top."""
    low = [(x0, -1), (x1, -1), (x1, 1), (x0, 1)]
    high = [(x0 + lean, -1), (x1 - lean, -1), (x1 - lean, 1), (x0 + lean, 1)]
    b = np.array([(x, side * half_width, z0) for x, side in low])
    t = np.array([(x, side * (half_width - taper), z1) for x, side in high])
    faces = [[t[0], t[1], t[2]], [t[0], t[2], t[3]]]
    for k in range(4):
        n = (k + 1) % 4
        faces += [[b[k], b[n], t[n]], [b[k], t[n], t[k]]]
    return np.array(faces), np.arange(10) < 2


@cache
def car(body: int) -> tuple[Soup, NDArray[np.intp]]:
    """A car that drives towards +y, its middle on the origin, and what each triangle is.

    Parts: 0 paint, 1 glass, 2 tyre.
    """
    length, width, waist, height, front, back = CAR_BODIES[body]
    half = length / 2
    lorry = body == 3
    lower, _ = hexahedron(-half, half, width / 2, 0.32, waist, 0.05, 0.08)
    cabin, roof = hexahedron(
        half - back, half - front, width / 2 - 0.08, waist, height, 0.16, 0.1 if lorry else 0.45
    )
    parts = [lower, cabin]
    kinds = [np.zeros(len(lower), dtype=np.intp), np.where(roof, 0, 1)]
    if lorry:
        box, _ = hexahedron(-half, half - back - 0.1, width / 2, 0.7, height + 0.2, 0.0, 0.0)
        parts.append(box)
        kinds.append(np.zeros(len(box), dtype=np.intp))
    wheel = tube(8) * [0.34, 0.34, 0.24]
    for x in (-half * 0.62, half * 0.62):
        for side in (-1, 1):
            upright = wheel[..., [0, 2, 1]] * [1, side, 1]
            parts.append(np.add(upright, (x, side * (width / 2 - 0.22), 0.34)))
            kinds.append(np.full(len(wheel), 2))
    soup = np.concatenate(parts)[..., [1, 0, 2]] * [-1, 1, 1]
    return soup, np.concatenate(kinds)


def instances(
    soup: Soup, x: ArrayLike, y: ArrayLike, z: ArrayLike, scale: ArrayLike, heading_deg: ArrayLike
) -> Soup:
    """Copies of a soup, float64 [n * T, 3, 3]: scaled [n, 3], rotated clockwise, and moved [n]."""
    angle = np.radians(-np.atleast_1d(np.asarray(heading_deg, dtype=float)))
    cos, sin = (part[:, None, None] for part in (np.cos(angle), np.sin(angle)))
    sized = soup[None] * np.atleast_2d(np.asarray(scale, dtype=float))[:, None, None, :]
    rotated = np.stack(
        [
            cos * sized[..., 0] - sin * sized[..., 1],
            sin * sized[..., 0] + cos * sized[..., 1],
            np.broadcast_to(sized[..., 2], (len(angle), *soup.shape[:2])),
        ],
        axis=-1,
    )
    where = np.stack(np.broadcast_arrays(*map(np.atleast_1d, (x, y, z))), axis=-1)
    return np.asarray((rotated + where[:, None, None, :]).reshape(-1, 3, 3))


def as_polygons(polygons: list[Polygon]) -> NDArray[np.object_]:
    """A list of polygons as an array that Shapely works on at once."""
    array = np.empty(len(polygons), dtype=object)
    array[:] = polygons
    return array
