"""The one reader of images: aerial tiles, ground images, and pictures to draw on."""

import functools
import logging
import warnings
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

from slicemask.errors import ImageError

Picture = str | Path | Image.Image | NDArray[Any]

# Plain raster formats only: Pillow hands some others to outside programs.
FORMATS = ("JPEG", "PNG", "WEBP", "BMP", "TIFF")
_FORMATS_TEXT = "JPEG, PNG, WebP, BMP or TIFF"
# Ten times a 4096x2048 panorama. A small file can claim far more and fill the memory.
MAX_PIXELS = 80_000_000
# By how much proportions may differ from those expected, as after rounding a size.
ASPECT_TOLERANCE = 0.02
# How files of other formats begin, from which byte on.
_OTHER_FORMATS = (
    (0, b"\0\0\0\x0cjP  ", "JPEG 2000"),
    (0, b"\xff\x4f\xff\x51", "JPEG 2000"),
    (4, b"ftypavi", "AVIF"),
    (4, b"ftyphei", "HEIC"),
    (4, b"ftyphev", "HEIC"),
    (4, b"ftypmif1", "HEIC"),
    (0, b"GIF8", "GIF"),
    *((0, b"P%d" % number, "PPM") for number in range(1, 8)),
    (0, b"Pf", "PFM"),
    (0, b"PF", "PFM"),
    (0, b"8BPS", "Photoshop"),
    (0, b"%!PS", "PostScript"),
    (0, b"%PDF", "PDF"),
    (0, b"\x89HDF", "HDF5"),
    (0, b"v/1\x01", "OpenEXR"),
    (0, b"\xff\x0a", "JPEG XL"),
    (0, b"\0\0\0\x0cJXL ", "JPEG XL"),
)
log = logging.getLogger(__name__)


def read_image(source: Picture) -> Image.Image:
    """Read an image whole, upright, as RGB with 8 bits a channel.

    Images of 16 bits a channel are read at full depth and scaled to 8: by the bits that their
    values use, or, where that would be dark, from the 2nd to the 98th percentile of their values.
    The first one is logged.

    Parameters
    ----------
    source : path, PIL image or array [height, width, 3]
        A JPEG, PNG, WebP, BMP or TIFF file, or what is in memory: a PIL image of any mode but
        32-bit and float ones, or uint8, uint16 or float (in [0, 1]) red, green, blue. At most
        `MAX_PIXELS` pixels.

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
    """
    if isinstance(source, str | Path):
        return _read_file(Path(source))
    if isinstance(source, Image.Image):
        return _upright_rgb(source, lambda: _reopen(source), "the image")
    return _from_array(np.asarray(source))


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
    width, height = image.size
    if not width * height or abs(width / height / aspect - 1) > ASPECT_TOLERANCE:
        shape = "square" if aspect == 1 else f"{aspect:.4g} times as wide as high"
        raise ImageError(
            f"{name}: {width}x{height} pixels; {kind} must be {shape}: crop it, or name another"
        )


def resize(image: Image.Image, size: tuple[int, int]) -> Image.Image:
    """Resize to (height, width), bilinear, averaging over what shrinks."""
    return image.resize(size[::-1], Image.Resampling.BILINEAR)


def name_of(source: Picture) -> str:
    """What a message calls an image: its path, if it has one."""
    return str(source) if isinstance(source, str | Path) else "the image"


def _read_file(path: Path) -> Image.Image:
    try:
        if not path.is_file():
            raise ImageError(_why_no_file(path))

        with _open(path) as image:
            return _upright_rgb(image, lambda: _open(path), str(path))
    except ImageError:
        raise
    except PermissionError:
        raise ImageError(f"{path}: permission denied; change the file's permissions") from None
    # A broken file makes the decoders raise nearly anything; each such error means the same here.
    except Exception as error:
        if other := _other_format(path):
            raise ImageError(
                f"{path}: is a {other} file, which is not read; convert it to {_FORMATS_TEXT}"
            ) from None
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ImageError(
            f"{path}: is unreadable as an image ({reason}); it may be cut short or altered, or no "
            f"{_FORMATS_TEXT} file"
        ) from error


def _open(file: Path | BytesIO) -> Image.Image:
    with warnings.catch_warnings():
        # The size is checked by `_upright_rgb`, before anything is decoded.
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        return Image.open(file, formats=FORMATS)


def _reopen(image: Image.Image) -> Image.Image:
    """Another image of the same file as one that was opened and not decoded yet."""
    file = image.fp  # type: ignore[attr-defined]
    place = file.tell()
    file.seek(0)
    content = BytesIO(file.read())
    file.seek(place)
    return _open(content)


def _why_no_file(path: Path) -> str:
    if path.is_dir():
        return f"{path}: is a folder; name one image in it"
    if any(sign in path.name for sign in "*?["):
        return f"{path}: there is no such image; name one image, since patterns are not expanded"
    return f"{path}: there is no such image; check the name"


def _other_format(path: Path) -> str | None:
    try:
        with path.open("rb") as file:
            head = file.read(16)
    except OSError:
        return None
    return next((name for at, mark, name in _OTHER_FORMATS if head[at:].startswith(mark)), None)


def _upright_rgb(image: Image.Image, reopen: Callable[[], Image.Image], name: str) -> Image.Image:
    """Check an image before it is decoded, and turn it into upright 8-bit RGB."""
    _check_pixels(*image.size, name)
    if image.mode in ("I", "F"):
        raise ImageError(
            f"{name}: its pixels are of mode {image.mode}, 32 bits a channel, which is not "
            "read; convert it to 8 or 16 bits a channel"
        )
    xmp = image.info.get("xmp")
    low_mode = _low_byte_mode(image)
    if image.mode.startswith("I;16"):
        values = np.asarray(ImageOps.exif_transpose(image)).astype(np.uint16)
        upright = _from_16_bits(np.repeat(values[..., None], 3, axis=2), name)
    elif low_mode is None:
        upright = ImageOps.exif_transpose(image).convert("RGB")
    else:
        with reopen() as again:
            low = _decode_as(again, low_mode)
        high = np.asarray(ImageOps.exif_transpose(image).convert("RGB")).astype(np.uint16)
        upright = _from_16_bits(high * np.uint16(256) + low, name)
    upright.info = {} if xmp is None else {"xmp": xmp}
    return upright


def _check_pixels(width: int, height: int, name: str) -> None:
    if width * height > MAX_PIXELS:
        raise ImageError(
            f"{name}: {width}x{height} pixels are more than the {MAX_PIXELS:,} allowed; make the "
            "image smaller"
        )


def _low_byte_mode(image: Image.Image) -> str | None:
    """Pillow's name for the low bytes of a colour image of 16 bits, None for other images.

    Pillow decodes such an image to its high bytes. Told that the bytes come in the other order, it
    decodes the low ones.
    """
    tiles = getattr(image, "tile", None)
    if not tiles:
        return None
    args = tiles[0][3]
    raw = args if isinstance(args, str) else args[0] if args else ""
    mode, sign, order = raw.partition(";16") if isinstance(raw, str) else ("", "", "")
    if not sign or mode.startswith("I"):
        return None
    native_is_little = np.little_endian
    other = {"B": "L", "L": "B", "N": "B" if native_is_little else "L"}.get(order[:1], "")
    return f"{mode};16{other}"


def _decode_as(image: Image.Image, mode: str) -> NDArray[np.uint16]:
    """Decode a file under another order of bytes: uint16 [height, width, 3], below 256."""

    def swapped(args: Any) -> Any:
        return mode if isinstance(args, str) else (mode, *args[1:])

    image.tile = [  # type: ignore[attr-defined]
        tile._replace(args=swapped(tile.args))
        for tile in image.tile  # type: ignore[attr-defined]
    ]
    return np.asarray(ImageOps.exif_transpose(image).convert("RGB")).astype(np.uint16)


def _from_array(array: NDArray[Any]) -> Image.Image:
    fault = None
    if array.ndim != 3 or array.shape[2] != 3 or 0 in array.shape:
        fault = "it must be [height, width, 3]: red, green, blue"
    elif array.dtype.kind == "f":
        if not (np.isfinite(array).all() and array.min() >= 0 and array.max() <= 1):
            fault = "floating-point values must be in [0, 1]"
    elif array.dtype not in (np.uint8, np.uint16):
        fault = "it must be uint8, uint16 or floating point in [0, 1]"
    if fault:
        raise ImageError(
            f"the image is an array {array.dtype} with shape {list(array.shape)}; {fault}"
        )
    _check_pixels(array.shape[1], array.shape[0], "the image")
    if array.dtype == np.uint16:
        return _from_16_bits(array, "the image")
    if array.dtype.kind == "f":
        array = np.rint(array * 255.0).astype(np.uint8)
    return Image.fromarray(np.ascontiguousarray(array))


def _from_16_bits(values: NDArray[np.uint16], name: str) -> Image.Image:
    """An 8-bit image of uint16 [height, width, 3]."""
    bits = max(8, int(values.max()).bit_length())
    low, high = np.percentile(values, (2, 98))
    if high >= 2 ** (bits - 1) or high <= low:
        how = f"as values of {bits} bits"
        shown = values >> (bits - 8)
    else:
        # A few bright pixels would make the rest dark.
        how = f"from the 2nd to the 98th percentile, {low:.0f} to {high:.0f}"
        shown = np.rint(np.clip((values - low) / (high - low), 0.0, 1.0) * 255.0)
    _log_once(name, how)
    return Image.fromarray(shown.astype(np.uint8))


@functools.cache
def _said() -> list[str]:
    """Holds the first image of 16 bits that was met in this process."""
    return []


def _log_once(name: str, how: str) -> None:
    if not _said():
        _said().append(name)
        log.warning(
            "%s: has 16 bits a channel; scaled to 8 bits %s; others likewise, unsaid", name, how
        )
