"""Street cameras of other makes: mounting, tilt, stitching, bonnet, cropped bands, blur."""

from dataclasses import replace

import numpy as np

from slicemask.synth.render.cameras import Panorama
from slicemask.synth.vary.artefacts import Pixels, blur, compress, resample

HEIGHTS_M = (1.5, 3.2)
MOST_TILT_DEG = 3.0
# Elevations of the band that a well-known rural set is cropped to, degrees.
BAND_DEG = (39.4, -26.1)


def mount(camera: Panorama, rng: np.random.Generator) -> Panorama:
    """Set a camera up at another height, not quite level."""
    x, y, _ = camera.position
    pitch, roll = np.clip(rng.normal(0, 1.0, 2), -MOST_TILT_DEG, MOST_TILT_DEG).tolist()
    height = float(rng.uniform(*HEIGHTS_M))
    return replace(camera, position=(x, y, height), pitch_deg=pitch, roll_deg=roll)


def develop(pixels: Pixels, heading_deg: float, rng: np.random.Generator) -> Pixels:
    """Give a panorama, uint8 [H, W, 3], the traces of its camera.

    Parameters
    ----------
    heading_deg
        Of the car, clockwise from north.
    """
    steps = (
        (0.45, _stitch), (0.45, _cover_nadir), (0.5, _soften), (0.3, crop_elevations)
    )  # fmt: skip
    for chance, step in steps:
        if rng.random() < chance:
            pixels = step(pixels, heading_deg, rng)
    return compress(pixels, int(rng.integers(35, 93)))


def _azimuth_deg(columns: int) -> np.ndarray:
    return (np.arange(columns) + 0.5) / columns * 360.0 - 180.0


def _elevation_deg(rows: int) -> np.ndarray:
    return 90.0 - (np.arange(rows) + 0.5) / rows * 180.0


def _stitch(pixels: Pixels, heading_deg: float, rng: np.random.Generator) -> Pixels:
    """Sectors of several lenses: each a little brighter or darker, and not quite aligned."""
    rows, columns = pixels.shape[:2]
    lenses = int(rng.integers(3, 9))
    gains = np.exp(rng.normal(0, 0.09, (lenses, 1)) + rng.normal(0, 0.02, (lenses, 3)))
    shifts = np.rint(rng.normal(0, rows / 400, (lenses, 2))).astype(int)
    position = (_azimuth_deg(columns) - heading_deg + rng.uniform(0, 360)) % 360.0 / 360.0 * lenses
    lens = position.astype(int) % lenses
    moved = np.empty_like(pixels)
    for number, (down, right) in enumerate(shifts):
        own = lens == number
        moved[:, own] = np.roll(pixels, (down, right), axis=(0, 1))[:, own]
    # Gains blend into each other over a part of the sector.
    blend = np.clip((position % 1.0 - 0.5) / rng.uniform(0.05, 0.9) + 0.5, 0, 1)[:, None]
    gain = gains[lens] * (1 - blend) + gains[(lens + 1) % lenses] * blend
    return np.asarray(np.clip(moved * gain[None], 0, 255), dtype=np.uint8)


def _cover_nadir(pixels: Pixels, heading_deg: float, rng: np.random.Generator) -> Pixels:
    """The car's bonnet and roof, or a patch with which they are hidden."""
    rows, columns = pixels.shape[:2]
    elevation = _elevation_deg(rows)[:, None]
    ahead = np.cos(np.radians(_azimuth_deg(columns) - heading_deg))[None]
    kind = rng.random()
    rim = np.full((1, columns), rng.uniform(-75, -38))
    if kind < 0.45:  # a bonnet ahead, a boot behind, narrower aside
        rim = rim + 12 * np.abs(ahead) ** rng.uniform(2, 8) * rng.uniform(0.3, 1.3)
    below = elevation < rim
    out = pixels.copy()
    if kind < 0.45:
        paint = rng.choice([0.08, 0.2, 0.5, 0.8]) * (1 + rng.normal(0, 0.06, 3))
        depth = np.clip((rim - elevation) / 30, 0, 1)
        shine = 1 - 0.5 * depth + 0.25 * np.cos(np.radians(4 * elevation)) * ahead
        car = np.clip(paint[None, None] * shine[..., None] * 255, 0, 255).astype(np.uint8)
        out[below] = car[below]
    elif kind < 0.8:  # smeared down from the rim
        first = int(np.argmax(below[:, 0]))
        ring = pixels[first].astype(float)
        width = max(3, columns // 16)
        padded = np.concatenate([ring[-width:], ring, ring[:width]])
        sums = np.cumsum(padded, axis=0)
        mean = (sums[2 * width :] - sums[: -2 * width]) / (2 * width)
        depth = np.linspace(0, 1, rows - first)[:, None, None]
        smear = ring * (1 - depth) + mean[:columns] * depth
        out[first:] = smear.astype(np.uint8)
    else:
        out[np.broadcast_to(below, (rows, columns))] = int(rng.choice([0, 30, 128]))
    return out


def _soften(pixels: Pixels, heading_deg: float, rng: np.random.Generator) -> Pixels:
    """A soft lens, or fewer pixels."""
    if rng.random() < 0.5:
        return blur(pixels, float(rng.uniform(0.3, 1.2)) * pixels.shape[0] / 512 + 0.2)
    return resample(pixels, float(rng.uniform(0.35, 0.9)))


def crop_elevations(pixels: Pixels, heading_deg: float, rng: np.random.Generator) -> Pixels:
    """A band of elevations; the rest of the sphere is black, grey or the band's last rows."""
    top, bottom = BAND_DEG
    if rng.random() < 0.4:
        top, bottom = rng.uniform(25, 65), rng.uniform(-65, -24)
    elevation = _elevation_deg(len(pixels))
    outside = np.flatnonzero((elevation > top) | (elevation < bottom))
    inside = np.flatnonzero((elevation <= top) & (elevation >= bottom))
    out = pixels.copy()
    if rng.random() < 0.2:
        out[outside] = pixels[np.clip(outside, inside[0], inside[-1])]
    else:
        out[outside] = int(rng.choice([0, 0, 0, 0, 0, 0, 0, 114, 255]))
    return out
