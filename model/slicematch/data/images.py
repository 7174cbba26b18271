"""Reading images with care, and turning them into what the encoders take."""

import math
import warnings
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageOps

from slicematch.data.errors import ImageError

IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)
# Plain raster formats only: Pillow hands some others to outside programs.
FORMATS = ("JPEG", "PNG", "WEBP", "BMP", "TIFF")
# Ten times a 4096x2048 panorama. A small file can claim far more and fill the memory.
MAX_PIXELS = 80_000_000


def read_image(path: str | Path) -> Image.Image:
    """Read an image whole, upright and as RGB.

    Parameters
    ----------
    path : path
        A JPEG, PNG, WebP, BMP or TIFF file with 8 bits a channel and at most `MAX_PIXELS` pixels.

    Returns
    -------
    PIL.Image.Image
        Mode RGB, decoded to the last row; turned upright if its EXIF data say so.

    Raises
    ------
    ImageError
        If the file is missing, no such image, cut short, corrupt, too large or of another depth.
        The text names the path.
    """
    path = Path(path)
    try:
        if not path.is_file():
            raise ImageError(f"{path}: no such image; check the data tree and the image's name")
        with warnings.catch_warnings():
            # The size is checked below, before anything is decoded.
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            image = Image.open(path, formats=FORMATS)
        with image:
            width, height = image.size
            if width * height > MAX_PIXELS:
                raise ImageError(
                    f"{path}: {width}x{height} pixels are more than the {MAX_PIXELS} allowed; "
                    "make the image smaller"
                )
            if image.mode.startswith(("I", "F")):
                raise ImageError(
                    f"{path}: its pixels are of mode {image.mode}; expected 8 bits a channel, "
                    "so convert the image"
                )
            return ImageOps.exif_transpose(image).convert("RGB")
    except ImageError:
        raise
    # A broken file makes the decoders raise nearly anything; each such error means the same here.
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ImageError(
            f"{path}: cannot be read as an image ({reason}); fetch the file anew"
        ) from error


def check_shape(image: Image.Image, path: str | Path, aspect: float, kind: str) -> None:
    """Refuse an image whose width is not `aspect` times its height, within 2 per cent.

    Sizes may differ from the original's, as after shrinking a data set; proportions may not,
    because then the image shows something else than the labels assume.

    Raises
    ------
    ImageError
        If the proportions differ; the text names the path.
    """
    width, height = image.size
    if not width * height or abs(width / height / aspect - 1) > 0.02:
        shape = "square" if aspect == 1 else f"{aspect:.4g} times as wide as high"
        raise ImageError(
            f"{path}: {width}x{height} pixels; {kind} must be {shape}: fetch the file anew, or "
            "name another"
        )


def resize(image: Image.Image, size: tuple[int, int]) -> Image.Image:
    """Resize to (height, width), bilinear, averaging over what shrinks."""
    return image.resize(size[::-1], Image.Resampling.BILINEAR)


def turn_panorama(image: Image.Image, heading_deg: float, size: tuple[int, int]) -> Image.Image:
    """Turn a panorama with north at its centre so that it faces a heading, and resize it.

    The image rolls **left** by W * heading_deg / 360 columns of its own width W. Whole columns are
    rolled and the rest goes into the resampling, so that the centre of the result faces the very
    heading asked for, whatever W is. Columns wrap round at both edges.

    Parameters
    ----------
    image : PIL.Image.Image
        Equirectangular, 360 degrees wide, north at the centre column, east at 3/4 of the width.
    heading_deg : float
        Degrees clockwise from north.
    size : (height, width)
        Of the result, in pixels.
    """
    width, height = image.size
    whole, rest = divmod(width * heading_deg / 360.0, 1.0)
    # What the resampling filter may reach beyond either edge.
    margin = math.ceil(width / size[1]) + 2
    pixels = np.roll(np.asarray(image), -int(whole), axis=1)
    wrapped = np.pad(pixels, ((0, 0), (margin, margin), (0, 0)), mode="wrap")
    box = (margin + rest, 0, margin + rest + width, height)
    return Image.fromarray(wrapped).resize(size[::-1], Image.Resampling.BILINEAR, box=box)


def normalise(image: Image.Image) -> torch.Tensor:
    """Turn an RGB image into float32 [3, H, W] with ImageNet's mean and deviation taken out."""
    pixels = np.asarray(image, dtype=np.float32) / 255
    pixels = (pixels - np.float32(IMAGENET_MEAN)) / np.float32(IMAGENET_STD)
    return torch.from_numpy(np.ascontiguousarray(pixels.transpose(2, 0, 1)))


def denormalise(pixels: torch.Tensor) -> np.ndarray:
    """Turn float [3, H, W] of `normalise` back into a picture, uint8 [H, W, 3]."""
    shown = pixels.detach().cpu().float().numpy().transpose(1, 2, 0)
    shown = shown * np.float32(IMAGENET_STD) + np.float32(IMAGENET_MEAN)
    return np.clip(np.rint(shown * 255), 0, 255).astype(np.uint8)
