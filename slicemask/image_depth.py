"""Images of 16 bits a channel: reading both bytes, and scaling to 8 bits."""

import functools
import logging
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

log = logging.getLogger(__name__)

# Tags of TIFF.
_BITS_PER_SAMPLE, _PLANAR_CONFIGURATION = 258, 284
# What pixels without data often hold, and what is overexposed: it says nothing of the depth.
_SATURATED = 2**16 - 1


def upright(image: Image.Image) -> Image.Image:
    """An image turned as its EXIF data or, of a TIFF, its tags say."""
    if (
        image.format == "TIFF"
    ):  # turned by its decoder; older versions of Pillow would turn it twice
        image.load()
        return image
    return ImageOps.exif_transpose(image)


def has_16_bits(image: Image.Image) -> bool:
    """Whether an image holds 16 bits a channel, or its file does and it is not decoded yet."""
    raw = _raw_mode(image)
    # Pillow before 11 decodes grey images of 16 bits to mode I.
    return image.mode.startswith("I;16") or (";16" in raw and not raw.endswith("S"))


def is_planar(image: Image.Image) -> bool:
    """Whether an image is of a TIFF file of 16 bits a channel that is stored band by band.

    Pillow decodes such files to something else than they show.
    """
    tags = getattr(image, "tag_v2", {})
    bits = tags.get(_BITS_PER_SAMPLE, (8,))
    return len(bits) > 1 and max(bits) > 8 and tags.get(_PLANAR_CONFIGURATION) == 2


def values_of_16_bits(image: Image.Image, reopen: Callable[[], Image.Image]) -> NDArray[np.uint16]:
    """Read an image of 16 bits a channel at its full depth.

    Pillow decodes colour images of 16 bits to their high bytes. Told that the bytes come in the
    other order, it decodes the low ones.

    Parameters
    ----------
    image : PIL.Image.Image
        For which `has_16_bits` holds.
    reopen : callable
        Opens another image of the same file, not decoded yet.

    Returns
    -------
    uint16 [height, width, 3]
        Red, green, blue, upright; grey three times. Alpha is left out.
    """
    if image.mode.startswith("I"):
        grey = np.asarray(upright(image)).astype(np.uint16)
        return np.repeat(grey[..., None], 3, axis=2)
    bands, _, order = _raw_mode(image).partition(";16")
    # "N" is the machine's own order.
    little = order[:1] == "L" or (order[:1] == "N" and np.little_endian)
    if bands == "LA":
        # Four bytes a pixel, which is what RGBA of 8 bits has: grey, then alpha.
        with reopen() as again:
            pixels = _decode_as(again, "RGBA").astype(np.uint16)
        first, second = pixels[..., 0], pixels[..., 1]
        grey = first + second * 256 if little else first * 256 + second
        return np.repeat(grey[..., None], 3, axis=2)
    # Premultiplied colours (RGBa) stay so: dividing low bytes by low bytes of alpha is no sense.
    bands = bands.replace("a", "A")
    high_order, low_order = ("L", "B") if little else ("B", "L")
    with reopen() as again:
        high = _decode_as(again, f"{bands};16{high_order}").astype(np.uint16)
    with reopen() as again:
        low = _decode_as(again, f"{bands};16{low_order}")
    return high[..., :3] * np.uint16(256) + low[..., :3]


def scale_to_8_bits(values: NDArray[np.uint16], name: str) -> Image.Image:
    """Scale 16 bits a channel to 8, and log how, of the first image in this process.

    The values' own range of bits becomes 0 to 255, or, where that would be dark, their 2nd to 98th
    percentile. Values of 65535 do not count for either.

    Parameters
    ----------
    values : uint16 [height, width, 3]
        Red, green, blue.
    name : str
        What the log calls the image.

    Returns
    -------
    PIL.Image.Image
        Mode RGB.
    """
    counted = values[values < _SATURATED]
    if not counted.size:
        counted = values
    bits = max(8, int(counted.max()).bit_length())
    low, high = np.percentile(counted, (2, 98))
    if high >= 2 ** (bits - 1) or high <= low:
        how = f"as values of {bits} bits"
        shown = np.minimum(values, 2**bits - 1) >> (bits - 8)
    else:
        # A few bright pixels would make the rest dark.
        how = f"from the 2nd to the 98th percentile, {low:.0f} to {high:.0f}"
        shown = np.rint(np.clip((values - low) / (high - low), 0.0, 1.0) * 255.0)
    _log_once(name, how)
    return Image.fromarray(shown.astype(np.uint8))


def _raw_mode(image: Image.Image) -> str:
    """Pillow's name for the pixels in the file, such as RGB;16B; empty once they are decoded."""
    tiles = getattr(image, "tile", None)
    if not tiles:
        return ""
    args = tiles[0][3]
    raw = args if isinstance(args, str) else args[0] if args else ""
    # Colours of printing inks are no sums of bytes; eight bits do for them.
    return raw if isinstance(raw, str) and not raw.startswith("CMYK") else ""


def _decode_as(image: Image.Image, raw_mode: str) -> NDArray[np.uint8]:
    """Decode an image as if its file held pixels of another kind: uint8 [height, width, bands]."""

    def swapped(tile: Any) -> Any:
        args = tile[3]
        args = raw_mode if isinstance(args, str) else (raw_mode, *args[1:])
        # Tiles are plain tuples in older versions of Pillow.
        return tile._replace(args=args) if hasattr(tile, "_replace") else (*tile[:3], args)

    image.tile = [swapped(tile) for tile in image.tile]  # type: ignore[attr-defined]
    return np.asarray(upright(image))


@functools.cache
def _first_image() -> list[str]:
    """Holds the first image of 16 bits that was met in this process."""
    return []


def _log_once(name: str, how: str) -> None:
    if not _first_image():
        _first_image().append(name)
        log.warning(
            "%s: has 16 bits a channel; scaled to 8 bits %s; said once, done for all", name, how
        )
