"""What pictures lose on their way: JPEG blocks, blur, sharpening, coarser pixels."""

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFilter

Pixels = NDArray[np.uint8]


def compress(pixels: Pixels, quality: int) -> Pixels:
    """Give what is left of uint8 [H, W, 3] after JPEG."""
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "JPEG", quality=quality)
    return np.asarray(Image.open(file))


def resample(pixels: Pixels, scale: float, smooth: bool = True) -> Pixels:
    """Give what a picture of `scale` times as many pixels a side shows of it."""
    rows, columns = pixels.shape[:2]
    size = max(8, round(columns * scale)), max(8, round(rows * scale))
    kind = Image.Resampling.BICUBIC if smooth else Image.Resampling.BILINEAR
    small = Image.fromarray(pixels).resize(size, Image.Resampling.BOX)
    return np.asarray(small.resize((columns, rows), kind))


def blur(pixels: Pixels, radius: float) -> Pixels:
    """Blur with a Gaussian of so many pixels' deviation."""
    return np.asarray(Image.fromarray(pixels).filter(ImageFilter.GaussianBlur(radius)))


def sharpen(pixels: Pixels, percent: int) -> Pixels:
    """Sharpen, as processing for viewing does, with halos."""
    return np.asarray(Image.fromarray(pixels).filter(ImageFilter.UnsharpMask(1.2, percent, 0)))
