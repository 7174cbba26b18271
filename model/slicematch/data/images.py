"""Images as tensors: what the encoders take."""

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from slicematch.normalisation import IMAGENET_MEAN, IMAGENET_STD, Triple


def normalise(
    image: Image.Image, mean: Triple = IMAGENET_MEAN, std: Triple = IMAGENET_STD
) -> torch.Tensor:
    """Turn an image into what an encoder takes.

    Parameters
    ----------
    image : PIL.Image.Image
        Mode RGB.
    mean, std : (red, green, blue)
        Of the images that the encoder was trained with, in [0, 1]; ImageNet's by default.

    Returns
    -------
    float32 [3, H, W]
        (image / 255 - mean) / std.
    """
    pixels: NDArray[np.float32] = np.asarray(image, dtype=np.float32) / np.float32(255)
    normalised = (pixels - np.array(mean, np.float32)) / np.array(std, np.float32)
    return torch.from_numpy(np.ascontiguousarray(normalised.transpose(2, 0, 1)))


def denormalise(
    pixels: torch.Tensor, mean: Triple = IMAGENET_MEAN, std: Triple = IMAGENET_STD
) -> NDArray[np.uint8]:
    """Turn what `normalise` gives back into a picture.

    Parameters
    ----------
    pixels : float [3, H, W]
        A normalised image.
    mean, std : (red, green, blue)
        That it was normalised with.

    Returns
    -------
    uint8 [H, W, 3]
        Red, green, blue.
    """
    shown = pixels.detach().cpu().float().numpy().transpose(1, 2, 0)
    shown = shown * np.array(std, np.float32) + np.array(mean, np.float32)
    return np.clip(np.rint(shown * 255), 0, 255).astype(np.uint8)
