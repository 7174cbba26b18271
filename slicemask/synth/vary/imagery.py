"""Aerial imagery of other makes: resolution, view off the nadir, seams, sharpening, JPEG."""

from dataclasses import replace

import numpy as np

from slicemask.synth.render.cameras import Aerial
from slicemask.synth.vary.artefacts import Pixels, blur, compress, resample, sharpen

MOST_OFF_NADIR_DEG = 10.0
RESOLUTIONS_M = (0.05, 0.6)


def lean(camera: Aerial, rng: np.random.Generator) -> Aerial:
    """Look from aside, so that what stands leans; the ground stays where it is."""
    slope = np.tan(np.radians(MOST_OFF_NADIR_DEG * np.sqrt(rng.random())))
    towards = rng.uniform(0, 2 * np.pi)
    return replace(camera, lean=(float(slope * np.cos(towards)), float(slope * np.sin(towards))))


def develop(pixels: Pixels, metres_per_pixel: float, rng: np.random.Generator) -> Pixels:
    """Give a tile, uint8 [H, W, 3], the traces of how it was taken and stored."""
    coarse, fine = np.log(RESOLUTIONS_M[::-1])
    # Most imagery lies in the finer half.
    resolution_m = float(np.exp(fine + (coarse - fine) * rng.random() ** 1.3))
    if rng.random() < 0.3:
        pixels = _seam(pixels, metres_per_pixel, rng)
    if resolution_m > metres_per_pixel:
        pixels = resample(pixels, metres_per_pixel / resolution_m, bool(rng.random() < 0.6))
    elif rng.random() < 0.5:
        pixels = blur(pixels, float(rng.uniform(0.2, 0.9)))
    if rng.random() < 0.4:
        pixels = sharpen(pixels, int(rng.uniform(40, 180)))
    if rng.random() < 0.7:
        pixels = compress(pixels, int(rng.integers(25, 93)))
    return pixels


def _seam(pixels: Pixels, metres_per_pixel: float, rng: np.random.Generator) -> Pixels:
    """Two pictures of a mosaic, of other colours, joined along a line and not quite aligned."""
    rows, columns = pixels.shape[:2]
    across = rng.uniform(0, 2 * np.pi)
    row, column = np.mgrid[:rows, :columns] + 0.5
    side = (column - columns * rng.uniform(0.1, 0.9)) * np.cos(across)
    side = side + (row - rows * rng.uniform(0.1, 0.9)) * np.sin(across)
    shift = np.rint(rng.normal(0, 0.5, 2) / metres_per_pixel).astype(int)
    gain = np.exp(rng.normal(0, 0.15) + rng.normal(0, 0.04, 3))
    other = np.clip(np.roll(pixels, shift, axis=(0, 1)) * gain, 0, 255)
    soft = np.clip(side / rng.uniform(1, 12) + 0.5, 0, 1)[..., None]
    return np.asarray(pixels * (1 - soft) + other * soft, dtype=np.uint8)
