"""Pictures of a scene: one ray a pixel, sun and sky, and more rays where neighbours differ."""

import numpy as np
from numpy.typing import NDArray

from slicemask.synth.layout.elements import Kind
from slicemask.synth.render.cameras import Camera
from slicemask.synth.render.light import Light
from slicemask.synth.render.materials import albedo
from slicemask.synth.render.patterns import Floats, as_float32
from slicemask.synth.render.scene import Scene

# Rays that are shaded at once: as many as stay in the processor's cache.
CHUNK = 1 << 16
# Where else in a pixel to look when it lies on an edge.
SUBPIXELS = ((-0.375, -0.125), (-0.125, 0.375), (0.125, -0.375), (0.375, 0.125))
# Brightness, in [0, 1], by which neighbours must differ to be an edge.
EDGE = 0.08


def render(scene: Scene, camera: Camera, light: Light) -> Floats:
    """Light that reaches each pixel, float32 [H, W, 3], about 0 to 1.

    Each pixel gets one ray; those that differ from a neighbour in surface or brightness get four
    more.
    """
    rows, columns = camera.shape
    colour = np.empty((rows * columns, 3), dtype=np.float32)
    surface = np.empty(rows * columns, dtype=np.int32)
    for start in range(0, rows * columns, CHUNK):
        chunk = np.arange(start, min(start + CHUNK, rows * columns))
        row, column = np.divmod(chunk, columns)
        colour[chunk], surface[chunk] = _shade(scene, camera, light, row + 0.5, column + 0.5)
    edge = np.flatnonzero(_edges(colour.reshape(rows, columns, 3), surface.reshape(rows, columns)))
    for start in range(0, len(edge), CHUNK // len(SUBPIXELS)):
        part = edge[start : start + CHUNK // len(SUBPIXELS)]
        total = np.zeros((len(part), 3), dtype=np.float32)
        row, column = np.divmod(part, columns)
        for down, right in SUBPIXELS:
            more, _ = _shade(scene, camera, light, row + 0.5 + down, column + 0.5 + right)
            total += more
        colour[part] = total / len(SUBPIXELS)
    return colour.reshape(rows, columns, 3)


def _edges(colour: Floats, surface: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Pixels that differ from a neighbour to their right or below, or from which one does."""
    edge = np.zeros(surface.shape, dtype=bool)
    grey = np.clip(colour, 0, 1).mean(axis=-1)
    for axis in (0, 1):
        changes = np.diff(surface, axis=axis) != 0
        # Unlike surfaces of like brightness, such as roof and parapet, can do without.
        step = np.abs(np.diff(grey, axis=axis))
        changes = (changes & (step > EDGE / 2)) | (step > EDGE)
        before = [slice(None), slice(None)]
        after = [slice(None), slice(None)]
        before[axis], after[axis] = slice(None, -1), slice(1, None)
        edge[tuple(before)] |= changes
        edge[tuple(after)] |= changes
    return edge


def _shade(
    scene: Scene,
    camera: Camera,
    light: Light,
    row: NDArray[np.float64],
    column: NDArray[np.float64],
) -> tuple[Floats, NDArray[np.int32]]:
    """Light float32 [n, 3] and surfaces int32 [n] (-1 is the sky) at places in the image."""
    origins, directions = (part.astype(np.float32) for part in camera.rays(row, column))
    hits = scene.trace(origins, directions)
    met = np.flatnonzero(hits.face >= 0)
    colour = np.empty((len(row), 3), dtype=np.float32)
    surface = np.full(len(row), -1, dtype=np.int32)
    missed = hits.face < 0
    colour[missed] = light.sky(directions[missed])
    if not len(met):
        return colour, surface
    face, distance, ray = hits.face[met], hits.distance_m[met], directions[met]
    surface[met] = scene.surface[face]
    point = origins[met] + distance[:, None] * ray
    normal = scene.normals[face]
    facing = (normal * ray).sum(axis=1)
    normal = np.where(facing[:, None] > 0, -normal, normal)
    facing = np.abs(facing)
    # On a slanting surface a pixel is longer than wide; patterns see the mean of both.
    across = camera.footprint_m(distance)
    footprint = across * np.sqrt(1.0 / np.maximum(facing, 0.05))
    base = albedo(scene, face, point, footprint)

    sun = light.towards_sun
    slope = normal @ sun
    leaves = scene.surfaces.kind[surface[met]] == Kind.LEAVES
    # Light goes some way round and through a crown.
    slope = np.where(leaves, 0.35 + 0.65 * slope, slope)
    # A single leaf shines on both sides.
    single = scene.surfaces.kind[surface[met]] == Kind.FOLIAGE
    slope = np.where(single, 0.25 + 0.65 * np.abs(slope), slope)
    lit = (slope > 0) & (light.sun > 0.02)
    shine = np.zeros(len(met), dtype=np.float32)
    start = point[lit] + normal[lit] * 0.03
    start += sun * np.where(leaves[lit], 0.25, 0)[:, None]
    free = ~scene.blocked(start, np.broadcast_to(sun, start.shape))
    # Some light comes through leaves, whichever are in its way.
    shine[lit] = slope[lit] * np.where(single[lit], 0.25 + 0.75 * free, free) * light.sun
    # The sky lights what looks up most; walls and crowns are darker near the ground.
    sky = light.ambient * (0.72 + 0.28 * normal[:, 2])
    upright = np.abs(normal[:, 2]) < 0.7
    sky = sky * np.where(upright, 0.85 + 0.15 * np.clip(point[:, 2] / 4.0, 0, 1), 1.0)
    sky = np.where(single, light.ambient * 0.85, sky)
    tint = sky[:, None] * as_float32([0.95, 1.0, 1.06]) + shine[:, None] * as_float32(
        [1.06, 1.0, 0.9]
    )
    shaded = base * tint

    kind = scene.surfaces.kind[surface[met]]
    for which, strength in ((Kind.PAINT, 0.12), (Kind.GLASS, 0.14), (Kind.WATER, 0.30)):
        chosen = np.flatnonzero(kind == which)
        if len(chosen):
            bounce = (
                ray[chosen]
                - 2 * (ray[chosen] * normal[chosen]).sum(axis=1)[:, None] * (normal[chosen])
            )
            gleam = strength + (1 - strength) * (1 - facing[chosen]) ** 5
            mirrored = light.sky(bounce)
            # Seen from below, a mirror shows the street instead of the sky.
            mirrored = np.where((bounce[:, 2] > 0.05)[:, None], mirrored, 0.35 * mirrored)
            shaded[chosen] += gleam[:, None] * (mirrored - shaded[chosen])
    near_horizon = as_float32(light.horizon)
    haze = 1 - np.exp(-distance / light.haze_m)
    colour[met] = shaded + haze[:, None] * (near_horizon - shaded)
    return colour, surface
