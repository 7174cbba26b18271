"""Images of 16 bits a channel: reading both bytes, and scaling to 8 bits."""

import functools
import logging
from collections.abc import Callable
from dataclasses import dataclass
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


@dataclass(frozen=True)
class Stretch:
    """How 16 bits a channel become 8: made by `stretch_for`, applied to any number of images.

    Attributes
    ----------
    low, high : float
        The values that become 0 and 255, if they come from percentiles.
    bits : int or None
        The bits that the values use, if their high bits are taken instead.
    """

    low: float = 0.0
    high: float = 0.0
    bits: int | None = None

    def __str__(self) -> str:
        if self.bits is not None:
            return f"as values of {self.bits} bits"
        return f"from the 2nd to the 98th percentile, {self.low:.0f} to {self.high:.0f}"

    def apply(self, values: NDArray[np.uint16]) -> NDArray[np.uint8]:
        """Values uint16 of any shape as uint8 of that shape."""
        if self.bits is not None:
            shown = np.minimum(values, 2**self.bits - 1) >> (self.bits - 8)
        else:
            shown = np.rint(np.clip((values - self.low) / (self.high - self.low), 0.0, 1.0) * 255.0)
        scaled: NDArray[np.uint8] = shown.astype(np.uint8)
        return scaled


def stretch_for(values: NDArray[np.uint16]) -> Stretch:
    """How to scale values of 16 bits to 8.

    Their own range of bits becomes 0 to 255, or, where that would be dark, their 2nd to 98th
    percentile. Values of 65535 do not count for either.

    Parameters
    ----------
    values : uint16 of any shape
        At least one.

    Returns
    -------
    Stretch
    """
    counted = values[values < _SATURATED]
    if not counted.size:
        counted = values
    bits = max(8, int(counted.max()).bit_length())
    low, high = (float(value) for value in np.percentile(counted, (2, 98)))
    if high >= 2 ** (bits - 1) or high <= low:
        return Stretch(bits=bits)
    # A few bright pixels would make the rest dark.
    return Stretch(low, high)


def scale_to_8_bits(values: NDArray[np.uint16], name: str) -> Image.Image:
    """Scale 16 bits a channel to 8 (`stretch_for`), and log how, of the first image in a process.

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
    stretch = stretch_for(values)
    _log_once(name, str(stretch))
    return Image.fromarray(stretch.apply(values))


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
