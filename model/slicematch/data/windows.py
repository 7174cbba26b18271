"""Square windows of one size on the ground, cut out of aerial tiles of any size around a camera."""

import functools

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from slicematch.data.errors import SampleError

Metres = NDArray[np.float64]
# How much of a window's side a tile may lack; the rest gets the tile's mean colour.
MOST_MISSING = 0.1


@functools.lru_cache(maxsize=100_000)
def tile_pixels(path: str) -> int:
    """The width of a tile in pixels, from the head of its file; 0 if it is unreadable."""
    try:
        with Image.open(path) as image:
            return image.width
    except (OSError, ValueError, Image.DecompressionBombError):
        return 0


def check_tile_side(tile_side_m: float, side_m: float, name: str) -> None:
    """Refuse a tile that is more than `MOST_MISSING` smaller than a window, metres.

    Raises
    ------
    SampleError
        If it is; the text begins with the name.
    """
    if tile_side_m < (1.0 - MOST_MISSING) * side_m:
        raise SampleError(
            f"{name}: is {tile_side_m:.4g} m wide and the run's tiles are {side_m:.4g} m; name a "
            "larger tile, the right metres_per_pixel or a smaller --side-m"
        )


def place_window(tile_side_m: float, side_m: float, camera_m: Metres, shift_m: Metres) -> Metres:
    """Where a window lies in a tile: about the camera, moved, and within the tile.

    Parameters
    ----------
    tile_side_m, side_m : float
        Sides of the tile and of the window on the ground.
    camera_m : float64 [2]
        The camera, metres east and north of the tile's centre.
    shift_m : float64 [2]
        By how much the window's centre lies east and north of the camera where the tile has room;
        nearer to the tile's centre where it has not.

    Returns
    -------
    float64 [2]
        The window's centre, metres east and north of the tile's.

    Examples
    --------
    >>> place_window(100.0, 60.0, np.array([10.0, 0.0]), np.array([15.0, 5.0])).tolist()
    [20.0, 5.0]
    """
    room = max(0.0, (tile_side_m - side_m) / 2.0)
    return np.clip(camera_m + shift_m, -room, room)


def cut_window(
    tile: Image.Image, tile_side_m: float, side_m: float, centre_m: Metres, size: int
) -> Image.Image:
    """Cut a window out of a tile and resample it.

    Parameters
    ----------
    tile : PIL.Image.Image
        Square, RGB, north up.
    tile_side_m, side_m : float
        Sides of the tile and of the window on the ground.
    centre_m : float64 [2]
        The window's centre, metres east and north of the tile's.
    size : int
        Side of the result, in pixels.

    Returns
    -------
    PIL.Image.Image
        RGB. What lies off the tile has the tile's mean colour.
    """
    scale = tile.width / tile_side_m  # pixels a metre
    half = side_m / 2.0
    left, top = tile.width / 2.0 + scale * (centre_m * [1.0, -1.0] - half)
    box = np.array([left, top, left + scale * side_m, top + scale * side_m])
    margin = max(0, int(np.ceil(max(-box.min(), box.max() - min(tile.size)) - 1e-6)))
    if margin:
        pixels = np.asarray(tile)
        around = np.empty([n + 2 * margin for n in pixels.shape[:2]] + [3], np.uint8)
        around[:] = pixels.mean(axis=(0, 1)).round()
        around[margin:-margin, margin:-margin] = pixels
        tile = Image.fromarray(around)
        box += margin
    # A window of the whole tile may miss it by a rounding error.
    within = np.clip(box, 0.0, np.tile(tile.size, 2))
    return tile.resize((size, size), Image.Resampling.BILINEAR, box=tuple(within.tolist()))
