"""Colours of surfaces where rays meet them: procedural textures, filtered over a pixel's width.

A pattern that is finer than a pixel fades into its mean, so that pictures of any size show no
moire: stripes and windows are averaged over the pixel in closed form, noise is left out.
"""

import numpy as np
from numpy.typing import NDArray

from slicemask.synth.layout.elements import Kind
from slicemask.synth.render.grounds import GROUNDS
from slicemask.synth.render.patterns import Floats, as_float32, noise, pulse
from slicemask.synth.render.scene import Scene


def albedo(scene: Scene, face: NDArray[np.int32], point: Floats, footprint_m: Floats) -> Floats:
    """Colours of surfaces, float32 [n, 3].

    Parameters
    ----------
    scene : Scene
    face : int32 [n]
        Triangles that are met, none of them -1.
    point : float32 [n, 3]
        Where they are met, metres.
    footprint_m : float32 [n]
        Width of a pixel there.
    """
    surface = scene.surface[face]
    kind = scene.surfaces.kind[surface]
    colour = scene.surfaces.colour[surface]
    textures = {
        Kind.PLAIN: _plain,
        Kind.ASPHALT: _asphalt,
        Kind.PAVING: _paving,
        Kind.GRASS: _grass,
        Kind.ROOF: _roof,
        Kind.TILES: _tiles,
        Kind.LEAVES: _leaves,
        Kind.FOLIAGE: _foliage,
        Kind.WATER: _water,
    }
    for number in np.unique(kind):
        chosen = kind == number
        if number == Kind.WALL:
            colour[chosen] = _wall(
                scene, face[chosen], surface[chosen], point[chosen], footprint_m[chosen]
            )
        elif number in GROUNDS:
            angle_deg = scene.surfaces.facade[surface[chosen], 0]
            colour[chosen] *= GROUNDS[Kind(number)](point[chosen], footprint_m[chosen], angle_deg)
        elif number in textures:
            brightness = textures[Kind(number)](point[chosen], footprint_m[chosen])
            colour[chosen] *= brightness if brightness.ndim == 2 else brightness[:, None]
    return colour


def _plain(point: Floats, footprint: Floats) -> Floats:
    x, y, z = point.T
    worn = noise(x, y + z, 0.13, footprint) + noise(x + z, y, 0.7, footprint)
    return as_float32(1.0 - 0.10 * np.clip(worn, -0.5, 1))


def _asphalt(point: Floats, footprint: Floats) -> Floats:
    x, y, _ = point.T
    patches = noise(x, y, 9.0, footprint)
    return as_float32(
        1.0
        + 0.10 * noise(x + 31, y, 2.3, footprint)
        + 0.07 * noise(x, y + 17, 0.09, footprint)
        - 0.20 * np.clip(4 * (patches - 0.45), 0, 1)
        - 0.30 * (np.abs(noise(x, y + 91, 6.0, footprint)) < 0.006) * (footprint < 0.12)
    )


def _paving(point: Floats, footprint: Floats) -> Floats:
    x, y, _ = point.T
    joints = np.maximum(pulse(x, 1.5, 0.02, footprint), pulse(y, 1.5, 0.02, footprint))
    slab = noise(np.floor(x / 1.5) * 7.3, np.floor(y / 1.5) * 5.1, 1.0, footprint)
    return as_float32(1.0 - 0.35 * joints + 0.07 * noise(x, y, 3.1, footprint) + 0.05 * slab)


def _grass(point: Floats, footprint: Floats) -> Floats:
    x, y, _ = point.T
    worn = np.clip(noise(x, y, 11.0, footprint) * 1.5 - 0.4, 0, 1)
    light = (
        1.0
        + 0.16 * noise(x + 5, y, 3.0, footprint)
        + 0.18 * noise(x, y, 0.45, footprint)
        + 0.22 * noise(x, y, 0.08, footprint)
    )
    return as_float32(light[:, None] * (1 + worn[:, None] * as_float32([0.28, 0.08, 0.12])))


def _roof(point: Floats, footprint: Floats) -> Floats:
    x, y, _ = point.T
    seams = pulse(x + 0.37 * y, 3.4, 0.03, footprint)
    stains = noise(x, y, 5.0, footprint) + 0.6 * noise(x, y + 40, 1.4, footprint)
    return as_float32(1.0 - 0.12 * seams + 0.10 * stains + 0.06 * noise(x, y, 0.2, footprint))


def _tiles(point: Floats, footprint: Floats) -> Floats:
    x, y, z = point.T
    courses = pulse(z, 0.17, 0.3, footprint * 0.5)
    return as_float32(
        1.06
        - 0.22 * courses
        + 0.10 * noise(x, y, 1.7, footprint)
        + 0.10 * noise(x * 3, y * 3, 0.6, footprint)
    )


def _leaves(point: Floats, footprint: Floats) -> Floats:
    x, y, z = point.T
    light = np.ones_like(x)
    for wavelength, strength in ((0.8, 0.25), (0.33, 0.4), (0.12, 0.6)):
        # Noise in three planes, so that no side of a crown shows streaks.
        for a, b in ((x, y), (y + 50, z), (z + 90, x)):
            light += 0.6 * strength * noise(a, b, wavelength, footprint)
    return as_float32(np.clip(light, 0.25, 1.8))


def _foliage(point: Floats, footprint: Floats) -> Floats:
    x, y, z = point.T
    tufts = noise(x + z, y - z, 0.9, footprint) + noise(x - z, y + z, 0.25, footprint)
    return as_float32(1.0 + 0.22 * tufts)


def _water(point: Floats, footprint: Floats) -> Floats:
    x, y, _ = point.T
    return as_float32(
        1.0 + 0.10 * noise(x, 2 * y, 0.9, footprint) + 0.06 * noise(x, y, 6.0, footprint)
    )


def _wall(
    scene: Scene,
    face: NDArray[np.int32],
    surface: NDArray[np.int32],
    point: Floats,
    footprint: Floats,
) -> Floats:
    """Windows on a grid, shops below, bricks, a cornice."""
    start, end = scene.corners[face, 0], scene.corners[face, 1]
    run = end[:, :2] - start[:, :2]
    length = np.maximum(np.hypot(run[:, 0], run[:, 1]), 1e-3)
    along = ((point[:, :2] - start[:, :2]) * run).sum(axis=1) / length
    z = point[:, 2]
    pitch, storey, width, height, shops, bricks, top = scene.surfaces.facade[surface].T
    # A whole number of windows fits each wall; walls too short for one have none.
    pitch = np.maximum(pitch, 0.5)
    count = np.floor(length / pitch)
    pitch = np.where(count > 0, length / np.maximum(count, 1), pitch)
    storey = np.maximum(storey, 1.0)
    ground = z < storey
    across = np.where(width > 0.99, 1, pulse(
        along - pitch * (1 - width) / 2, pitch, np.minimum(width, 0.98), footprint
    ))  # fmt: skip
    up = pulse(z - storey * 0.28, storey, height, footprint)
    frame_across = pulse(along - pitch * (1 - width) / 2 + 0.09, pitch,
                         np.minimum(width + 0.18 / pitch, 0.99), footprint)  # fmt: skip
    frame_up = pulse(z - storey * 0.28 + 0.10, storey, height + 0.2 / storey, footprint)
    usable = (count > 0) & (width > 0) & (z < top - 0.5) & ~(ground & (shops > 0))
    glazed = np.where(usable, across * up, 0)
    frame = np.where(usable & (width < 0.8), np.maximum(frame_across * frame_up - glazed, 0), 0)

    wall = scene.surfaces.colour[surface]
    dirt = 1.0 + 0.07 * noise(along + 3.7 * surface, z, 2.6, footprint)
    dirt -= 0.12 * np.clip(1 - z / 1.2, 0, 1)
    courses = np.maximum(pulse(z, 0.24, 0.16, footprint), 0.5 * pulse(along, 0.5, 0.08, footprint))
    dirt -= 0.22 * bricks * courses
    cornice = np.clip((z - (top - 0.55)) / np.maximum(footprint, 0.02), 0, 1)
    wall = wall * (dirt + 0.10 * cornice)[:, None]

    # Every pane reflects another piece of sky, and some have curtains.
    pane = noise(
        np.floor(along / pitch) * 3.7 + surface % 977, np.floor(z / storey) * 5.3, 1.0,
        np.zeros_like(z),
    )  # fmt: skip
    glass = scene.surfaces.window[surface] * (1.0 + 0.5 * pane)[:, None]
    glass = np.where((pane > 0.55)[:, None], 0.5 * glass + 0.32, glass)
    colour = wall * (1 - glazed - frame)[:, None] + glass * glazed[:, None]
    colour += frame[:, None] * as_float32([0.80, 0.79, 0.76])

    # Shop fronts: piers, glass, and a band of the shop's colour above.
    front = ground & (shops > 0) & (length > 3.0)
    if front.any():
        band = (z > storey - 0.85) & (z < storey - 0.15)
        pier = pulse(along, np.maximum(length / np.maximum(np.floor(length / 4), 1), 1), 0.08,
                     footprint)  # fmt: skip
        open_ = np.where((z > 0.5) & ~band & (z < storey - 0.15), 1 - pier, 0)
        shop = wall * (1 - open_)[:, None] + glass * 0.9 * open_[:, None]
        shop = np.where(band[:, None], scene.surfaces.shop[surface], shop)
        colour = np.where(front[:, None], shop, colour)
    return as_float32(colour)
