"""The one reader of images: aerial tiles, ground images, and pictures to draw on."""

import logging
import warnings
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from slicemask.errors import ImageError, is_out_of_resources
from slicemask.image_depth import (
    has_16_bits,
    is_planar,
    scale_to_8_bits,
    upright,
    values_of_16_bits,
)
from slicemask.image_formats import FORMATS, why_no_file, why_no_image

Picture = str | Path | Image.Image | NDArray[Any]

# Ten times a 4096x2048 panorama. A small file can claim far more and fill the memory.
MAX_PIXELS = 80_000_000
# By how much proportions may differ from those expected, as after rounding a size.
ASPECT_TOLERANCE = 0.02
# Of 255. An image in memory with no brighter pixel was most likely cut down from 16 bits.
_DARK = 15
_UNREAD_MODES = {"I": "numbers with a sign or of 32 bits", "F": "floating-point numbers"}
_XMP_TAG = 700  # of TIFF
log = logging.getLogger(__name__)


def read_image(source: Picture) -> Image.Image:
    """Read an image whole, upright, as RGB with 8 bits a channel.

    Images of 16 bits a channel are read at full depth and scaled to 8: by the bits that their
    values use, or, where that would be dark, from the 2nd to the 98th percentile of their values.
    The first one is logged. So is an image in memory that is nearly black throughout, since its
    low bytes may be lost.

    Parameters
    ----------
    source : path, PIL image or array
        A JPEG, PNG, WebP, BMP or TIFF file, or what is in memory: a PIL image of any mode but
        32-bit and float ones, or an array [height, width, 3] of red, green, blue, with alpha
        [height, width, 4], which is left out, or grey [height, width]; uint8, uint16 or float in
        [0, 1]. At most `MAX_PIXELS` pixels.

    Returns
    -------
    PIL.Image.Image
        Mode RGB, decoded to the last row; turned upright if its EXIF data say so. A file's XMP data
        are in its ``info``.

    Raises
    ------
    ImageError
        If the file is missing, of another format, cut short, corrupt, too large or of another
        depth; the text names the path.
    OSError, MemoryError
        If open files or memory ran out, which is no fault of the image.
    """
    if isinstance(source, str | Path):
        return _read_file(Path(source))
    if isinstance(source, Image.Image):
        return _read_pil(source)
    return _from_array(source)


def read_aerial(source: Picture) -> Image.Image:
    """Read an aerial tile, north up: a square image.

    Parameters
    ----------
    source : path, PIL image or array [S, S, 3]
        As `read_image` takes it.

    Returns
    -------
    PIL.Image.Image
        Mode RGB, as wide as high within `ASPECT_TOLERANCE`.

    Raises
    ------
    ImageError
        If it is unreadable or no square.
    """
    image = read_image(source)
    check_aspect(image, name_of(source), 1.0, "an aerial tile")
    return image


def check_aspect(image: Image.Image, name: str | Path, aspect: float, kind: str) -> None:
    """Refuse an image whose width is not `aspect` times its height, within `ASPECT_TOLERANCE`.

    Sizes may differ from the original's, as after shrinking a data set; proportions may not,
    because then the image shows something else than the labels assume.

    Parameters
    ----------
    image : PIL.Image.Image
        The image.
    name, kind : str
        Which image, and what it should be, for the message.
    aspect : float
        Width over height.

    Raises
    ------
    ImageError
        If the proportions differ.
    """
    if not has_aspect(image, aspect):
        width, height = image.size
        shape = "square" if aspect == 1 else f"{aspect:.4g} times as wide as high"
        raise ImageError(
            f"{name}: {width}x{height} pixels; {kind} must be {shape}: crop it, or name another"
        )


def has_aspect(image: Image.Image, aspect: float) -> bool:
    """Whether an image's width is `aspect` times its height, within `ASPECT_TOLERANCE`."""
    width, expected = image.width, aspect * image.height
    # The same for a quarter turn: 100x98 and 98x100 are both square, or neither is.
    return width > 0 and abs(width - expected) <= ASPECT_TOLERANCE * max(width, expected)


def resize(image: Image.Image, size: tuple[int, int]) -> Image.Image:
    """Resize to (height, width), bilinear, averaging over what shrinks."""
    return image.resize(size[::-1], Image.Resampling.BILINEAR)


def name_of(source: Picture) -> str:
    """What a message calls an image: its path, if it has one."""
    return str(source) if isinstance(source, str | Path) else "the image"


def _read_file(path: Path) -> Image.Image:
    try:
        if not path.is_file():
            raise ImageError(why_no_file(path))
        with _open(path) as image:
            return _upright_rgb(image, lambda: _open(path), str(path))
    # A broken file makes the decoders raise nearly anything; each such error means the same here.
    except Exception as error:
        _raise_if_known(error, str(path))
        unidentified = isinstance(error, UnidentifiedImageError)
        raise ImageError(why_no_image(path, _reason(error), unidentified)) from error


def _read_pil(image: Image.Image) -> Image.Image:
    try:
        if not getattr(image, "tile", None):
            image = _undecoded(image)
        elif image.format == "TIFF":
            image = _reopen(image)
        rgb = _upright_rgb(image, lambda: _reopen(image), "the image")
    except Exception as error:
        _raise_if_known(error, "the image")
        raise ImageError(
            f"the image, a PIL image of mode {image.mode}, is unreadable ({_reason(error)}); "
            "convert it to mode RGB"
        ) from error
    _warn_if_dark(rgb)
    return rgb


def _raise_if_known(error: Exception, name: str) -> None:
    """Raise what is no fault of the image's content as what it is, or in its own words."""
    if isinstance(error, ImageError) or is_out_of_resources(error):
        raise error
    if isinstance(error, PermissionError):
        raise ImageError(f"{name}: permission denied; change the file's permissions") from None
    if isinstance(error, Image.DecompressionBombError):
        raise ImageError(
            f"{name}: has more than the {MAX_PIXELS:,} pixels allowed; make the image smaller"
        ) from None
    if isinstance(error, OSError):
        if "out of memory" in str(error):  # from Pillow's decoders, without a number
            raise MemoryError(f"{name}: memory ran out while it was decoded") from error
        if error.errno is not None:
            shown = name if len(name) <= 300 else f"{name[:100]}..."
            raise ImageError(
                f"{shown}: is unreadable ({error.strerror}); check the name and the disk"
            ) from error


def _reason(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _open(file: Path | BytesIO) -> Image.Image:
    with warnings.catch_warnings():
        # The size is checked by `_upright_rgb`, before anything is decoded.
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        image = Image.open(file, formats=FORMATS)
    # Without a name, Pillow does not map the file into memory, which scrambles a TIFF that its
    # orientation turns by 90 degrees.
    image.filename = ""
    return image


def _reopen(image: Image.Image) -> Image.Image:
    """Another image of the same file as one that was opened and not decoded yet."""
    file = image.fp  # type: ignore[attr-defined]
    position = file.tell()
    file.seek(0)
    content = BytesIO(file.read())
    file.seek(position)
    return _open(content)


def _undecoded(image: Image.Image) -> Image.Image:
    """The file of 16 bits that an image was decoded from, if it is there and shows the same.

    Else the image itself: of colours of 16 bits, decoding keeps the high bytes alone.
    """
    path = getattr(image, "filename", "")
    if image.format not in ("PNG", "TIFF") or not path or not Path(path).is_file():
        return image
    with _open(Path(path)) as again:
        if not has_16_bits(again) or again.mode != image.mode or again.size != image.size:
            return image
        if again.tobytes() != image.tobytes():
            return image
    return _open(Path(path))


def _upright_rgb(image: Image.Image, reopen: Callable[[], Image.Image], name: str) -> Image.Image:
    """Check an image before it is decoded, and turn it into upright 8-bit RGB."""
    _check_pixels(*image.size, name)
    xmp = xmp_of(image)
    if is_planar(image):
        raise ImageError(
            f"{name}: has 16 bits a channel and is stored band by band, which is not read; store "
            "it pixel by pixel (gdal_translate -co INTERLEAVE=PIXEL)"
        )
    if has_16_bits(image):
        rgb = scale_to_8_bits(values_of_16_bits(image, reopen), name)
    elif image.mode in _UNREAD_MODES:
        raise ImageError(
            f"{name}: its pixels are of mode {image.mode}, {_UNREAD_MODES[image.mode]}, which are "
            "not read; convert it to 8 or 16 unsigned bits a channel"
        )
    else:
        rgb = upright(image).convert("RGB")
    rgb.info = {} if xmp is None else {"xmp": xmp}
    return rgb


def xmp_of(image: Image.Image) -> bytes | str | None:
    """The XMP data of an image, wherever this version of Pillow keeps them for its format."""
    for key in ("xmp", "XML:com.adobe.xmp"):
        if key in image.info:
            found: bytes | str = image.info[key]
            return found
    segments: list[tuple[str, bytes]] = getattr(image, "applist", [])
    for marker, content in segments:
        head, _, rest = content.partition(b"\0")
        if marker == "APP1" and head == b"http://ns.adobe.com/xap/1.0/":
            return rest
    tagged: bytes | None = getattr(image, "tag_v2", {}).get(_XMP_TAG)
    return tagged


def _check_pixels(width: int, height: int, name: str) -> None:
    if width * height > MAX_PIXELS:
        raise ImageError(
            f"{name}: {width}x{height} pixels are more than the {MAX_PIXELS:,} allowed; make the "
            "image smaller"
        )


def _from_array(source: Any) -> Image.Image:
    array = np.asarray(source)
    if array.dtype.kind not in "biufc":
        raise ImageError(
            f"the image is of type {type(source).__name__}; it must be a path, a PIL image or an "
            "array [height, width, 3]: red, green, blue"
        )
    fault = None
    if array.ndim not in (2, 3) or array.shape[2:] not in ((), (1,), (3,), (4,)):
        fault = "it must be [height, width, 3]: red, green, blue"
    elif 0 in array.shape:
        fault = "it must hold a pixel at least"
    elif array.dtype.kind == "f":
        if not (np.isfinite(array).all() and array.min() >= 0 and array.max() <= 1):
            fault = "floating-point values must be in [0, 1]"
    elif array.dtype.kind != "u" or array.dtype.itemsize > 2:
        fault = "it must be uint8, uint16 or floating point in [0, 1]"
    if fault:
        raise ImageError(
            f"the image is an array {array.dtype} with shape {list(array.shape)}; {fault}"
        )
    _check_pixels(array.shape[1], array.shape[0], "the image")
    colours = np.broadcast_to(np.atleast_3d(array)[..., :3], (*array.shape[:2], 3))
    if array.dtype.kind == "u" and array.dtype.itemsize == 2:
        return scale_to_8_bits(colours.astype(np.uint16), "the image")
    if array.dtype.kind == "f":
        colours = np.rint(colours * 255.0).astype(np.uint8)
    image = Image.fromarray(np.ascontiguousarray(colours))
    _warn_if_dark(image)
    return image


def _warn_if_dark(image: Image.Image) -> None:
    brightest = int(np.asarray(image).max())
    if 0 < brightest <= _DARK:
        log.warning(
            "the image is nearly black: no value exceeds %d of 255; if it had 16 bits a channel, "
            "hand over its path or a uint16 array",
            brightest,
        )
