"""Textures of roads and open ground: gravel, dirt, concrete, soil, crops, meadows, litter."""

from collections.abc import Callable

import numpy as np

from slicemask.synth.layout.elements import Kind
from slicemask.synth.render.patterns import Floats, as_float32, noise, pulse

Texture = Callable[[Floats, Floats, Floats], Floats]


def _octaves(x: Floats, y: Floats, footprint: Floats, *layers: tuple[float, float]) -> Floats:
    """Noise of several (wavelength in metres, strength)."""
    total = np.zeros_like(x)
    for wavelength, strength in layers:
        total += strength * noise(x + 13 * wavelength, y, wavelength, footprint)
    return total


def _tinted(light: Floats, tint: Floats, towards: tuple[float, float, float]) -> Floats:
    """Factors [n, 3] of a brightness [n], with a tint [n] of a colour."""
    return as_float32(light[:, None] * (1 + tint[:, None] * as_float32(towards)))


def _gravel(point: Floats, footprint: Floats, angle_deg: Floats) -> Floats:
    x, y, _ = point.T
    stones = _octaves(x, y, footprint, (0.05, 0.16), (0.12, 0.08), (0.35, 0.03))
    wear = _octaves(x, y, footprint, (1.6, 0.06), (5.0, 0.08), (17.0, 0.08))
    return _tinted(1 + stones + wear, noise(x, y + 70, 4.0, footprint), (0.05, 0.0, -0.08))


def _dirt(point: Floats, footprint: Floats, angle_deg: Floats) -> Floats:
    x, y, _ = point.T
    stones = _octaves(x, y, footprint, (0.05, 0.14), (0.15, 0.12), (0.5, 0.08))
    wear = _octaves(x, y, footprint, (1.6, 0.10), (5.0, 0.12), (19.0, 0.10))
    damp = np.clip(2 * (_octaves(x, y + 33, footprint, (2.7, 0.5), (9.0, 0.6)) - 0.3), 0, 1)
    return _tinted(1 + stones + wear - 0.15 * damp, damp, (-0.06, 0.0, 0.04))


def _concrete(point: Floats, footprint: Floats, angle_deg: Floats) -> Floats:
    x, y, _ = point.T
    stains = _octaves(x, y, footprint, (0.08, 0.06), (0.7, 0.06), (3.0, 0.10), (11.0, 0.08))
    cracks = (np.abs(noise(x, y + 91, 5.0, footprint)) < 0.008) * (footprint < 0.15)
    light = 1 + stains - 0.25 * cracks
    return _tinted(light, noise(x, y + 70, 6.0, footprint), (0.03, 0.0, -0.05))


def _tar(point: Floats, footprint: Floats, angle_deg: Floats) -> Floats:
    """Asphalt that has been worn, patched and sealed."""
    x, y, _ = point.T
    grain = _octaves(x, y, footprint, (0.06, 0.14), (0.2, 0.06), (1.3, 0.07), (4.5, 0.08))
    patches = np.clip(5 * (noise(x, y, 14.0, footprint) - 0.35), 0, 1)
    bleached = noise(x, y + 55, 31.0, footprint)
    lines = np.minimum(
        np.abs(noise(x, y + 91, 6.0, footprint)), np.abs(noise(x + 23, y, 9.0, footprint))
    )
    cracks = np.clip(1 - lines / (0.008 + 0.02 * footprint), 0, 1)
    light = 1 + grain - 0.14 * patches + 0.14 * bleached - 0.22 * cracks
    return _tinted(light, noise(x, y + 70, 8.0, footprint), (0.03, 0.0, -0.04))


def _soil(point: Floats, footprint: Floats, angle_deg: Floats) -> Floats:
    x, y, _ = point.T
    across = _across(x, y, angle_deg)
    furrows = pulse(across, 0.75, 0.5, footprint) - 0.5
    clods = _octaves(x, y, footprint, (0.12, 0.20), (0.4, 0.14), (2.5, 0.08), (9.0, 0.10))
    wet = np.clip(noise(x, y, 37.0, footprint), 0, 1)
    return _tinted(1 + clods + 0.25 * furrows - 0.30 * wet, wet, (-0.05, 0.0, 0.04))


def _crop(point: Floats, footprint: Floats, angle_deg: Floats) -> Floats:
    x, y, _ = point.T
    across = _across(x, y, angle_deg)
    rows = pulse(across + 0.08 * noise(x, y, 1.7, footprint), 0.76, 0.55, footprint) - 0.55
    passes = pulse(across, 18.0, 0.06, footprint)
    leaves = _octaves(x, y, footprint, (0.09, 0.25), (0.3, 0.15), (2.0, 0.06), (13.0, 0.10))
    dry = _octaves(x, y, footprint, (7.0, 0.5), (29.0, 0.6))
    return _tinted(1 + leaves + 0.35 * rows - 0.18 * passes, dry, (0.18, 0.02, -0.05))


def _meadow(point: Floats, footprint: Floats, angle_deg: Floats) -> Floats:
    """Grass that nobody mows: tufts, bare spots, dry and lush parts."""
    x, y, _ = point.T
    blades = _octaves(x, y, footprint, (0.07, 0.26), (0.2, 0.20), (0.6, 0.16), (1.9, 0.10))
    wide = _octaves(x, y, footprint, (5.0, 0.10), (14.0, 0.10))
    dry = _octaves(x + 40, y, footprint, (1.1, 0.5), (4.0, 0.7), (19.0, 0.7))
    bare = np.clip(2.5 * (_octaves(x, y + 33, footprint, (2.3, 0.5), (8.0, 0.6)) - 0.45), 0, 1)
    light = 1 + blades + wide + 0.2 * bare
    return _tinted(light, np.clip(dry, -0.6, 0.9) + bare, (0.30, 0.08, 0.06))


def _litter(point: Floats, footprint: Floats, angle_deg: Floats) -> Floats:
    """The floor of a wood: leaves, twigs, moss."""
    x, y, _ = point.T
    leaves = _octaves(x, y, footprint, (0.1, 0.35), (0.3, 0.25), (1.1, 0.2), (6.0, 0.12))
    moss = np.clip(_octaves(x, y + 9, footprint, (1.7, 0.6), (7.0, 0.6)), 0, 1)
    return _tinted(1 + leaves, moss, (-0.30, 0.15, -0.10))


def _across(x: Floats, y: Floats, angle_deg: Floats) -> Floats:
    angle = np.radians(angle_deg)
    return as_float32(y * np.cos(angle) - x * np.sin(angle))


GROUNDS: dict[Kind, Texture] = {
    Kind.GRAVEL: _gravel,
    Kind.DIRT: _dirt,
    Kind.CONCRETE: _concrete,
    Kind.TAR: _tar,
    Kind.SOIL: _soil,
    Kind.CROP: _crop,
    Kind.MEADOW: _meadow,
    Kind.LITTER: _litter,
}
