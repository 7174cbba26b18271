"""Aerial tiles that overlap: rendered in one picture, then cut out of it."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slicemask.synth.formats.files import is_complete, write_picture
from slicemask.synth.render.cameras import Aerial
from slicemask.synth.render.render import render
from slicemask.synth.render.scene import Scene
from slicemask.synth.vary.pictures import AerialLook


def missing_tiles(paths: Sequence[Path], pixels: int) -> list[int]:
    """Which of the tiles are missing or incomplete."""
    return [k for k, path in enumerate(paths) if not is_complete(path, (pixels, pixels))]


def write_tiles(
    scene: Scene,
    centres: NDArray[np.float64],
    metres_per_pixel: float,
    pixels: int,
    look: AerialLook,
    wanted: dict[int, tuple[Path, np.random.Generator]],
) -> None:
    """Render the square tiles around centres, and write those that are wanted.

    The picture covers all tiles whichever are wanted, since which pixels get more rays depends on
    their neighbours; so a tile is the same whether or not others exist already.

    Parameters
    ----------
    scene : Scene
    centres : float64 [n, 2]
        Metres east and north; whole pixels apart.
    metres_per_pixel, pixels
        Of the tiles.
    look
        Light and sensor.
    wanted
        The path of each tile to write, by its number, and random numbers for its noise.
    """
    west, north = centres[:, 0].min(), centres[:, 1].max()
    right = np.rint((centres[:, 0] - west) / metres_per_pixel).astype(int)
    down = np.rint((north - centres[:, 1]) / metres_per_pixel).astype(int)
    half = pixels / 2 * metres_per_pixel
    shape = int(down.max()) + pixels, int(right.max()) + pixels
    camera = look.aim(Aerial((west - half, north + half), metres_per_pixel, shape))
    image = render(scene, camera, look.varied_light())
    for number, (path, rng) in wanted.items():
        top, left = down[number], right[number]
        tile = image[top : top + pixels, left : left + pixels]
        write_picture(path, look.pixels(tile, metres_per_pixel, number, rng))
