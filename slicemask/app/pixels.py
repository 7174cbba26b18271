"""Masks and tiles as pixels for Bokeh's images: one uint32 a pixel, red in the lowest byte."""

from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from slicemask.plot.colours import band_colours, slice_colours

Palette = Literal["hues", "two tones"]
PALETTES = get_args(Palette)

# Okabe and Ito's blue and orange, which are told apart whatever the kind of colour blindness, and
# their green for the last of an odd number of slices, a neighbour of the first.
_TWO_TONES = np.array([[0, 114, 178], [230, 159, 0], [0, 158, 115]]) / 255.0


def shades(slices: int, bands: int, palette: Palette = "hues") -> NDArray[np.float64]:
    """Colours of bands of slices, float64 [N, B, 3]: red, green, blue in [0, 1].

    Parameters
    ----------
    slices, bands : int
        N and B, at least 1.
    palette : {"hues", "two tones"}
        A wheel of hues, or blue and orange in turn.
    """
    if palette == "hues":
        return band_colours(slice_colours(slices), bands)
    tones = np.arange(slices) % 2
    if slices % 2 == 1 and slices > 1:
        tones[-1] = 2
    return band_colours(_TWO_TONES[tones], bands)


def blend(
    masks: NDArray[Any], colours: NDArray[np.float64], opacity: float = 1.0
) -> NDArray[np.uint32]:
    """Cells in the colours of what covers them, uint32 [L, L].

    Parameters
    ----------
    masks : float [P, L, L]
        Fractions of the cells.
    colours : float64 [P, 3] or [P, 4]
        Red, green, blue in [0, 1], and an opacity where there is a fourth.
    opacity : float
        Of a cell that is covered completely.
    """
    covered = masks.sum(axis=0)
    mixed = np.tensordot(colours.T, masks, axes=1) / np.maximum(covered, 1e-12)  # [3 or 4, L, L]
    alpha = opacity * np.clip(covered, 0.0, 1.0)
    if len(mixed) == 4:
        alpha = alpha * mixed[3]
    return pack(np.dstack([*np.clip(mixed[:3], 0.0, 1.0), np.clip(alpha, 0.0, 1.0)]))


def pack(colours: NDArray[np.float64]) -> NDArray[np.uint32]:
    """Red, green, blue, opacity in [0, 1] as pixels: float64 [rows, columns, 4] to uint32."""
    return _as_uint32(np.rint(colours * 255.0).astype(np.uint8))


def picture_pixels(picture: Image.Image, most: int) -> NDArray[np.uint32]:
    """A picture as opaque pixels, no more than `most` along a side."""
    smaller = picture.convert("RGBA")
    smaller.thumbnail((most, most))
    return _as_uint32(np.asarray(smaller))


def _as_uint32(channels: NDArray[np.uint8]) -> NDArray[np.uint32]:
    return np.ascontiguousarray(channels).view("<u4")[..., 0]
