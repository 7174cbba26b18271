"""Training samples in other colours, so that a model does not learn a city by its paint."""

import numpy as np
import torch

from slicematch import _torchvision  # noqa: F401  before torchvision: see there
from slicematch.normalisation import IMAGENET_MEAN, IMAGENET_STD, Triple

from torchvision.transforms.v2 import functional  # isort: skip

# How far around the colour circle (1) a pair goes together, and either image by itself.
_SHARED_HUE = 0.15
_OWN_HUE = 0.03
_OWN_FACTOR = 0.35


def recolour(
    ground: torch.Tensor,
    aerial: torch.Tensor,
    random: np.random.Generator,
    mean: Triple = IMAGENET_MEAN,
    std: Triple = IMAGENET_STD,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Change the colours of a pair (ours).

    Both are turned around the colour circle by one angle, up to 54 degrees, so that what looked
    alike still does but has no colour to be learnt by heart. On top, each image has its
    hue, saturation, contrast and brightness changed by itself.

    Parameters
    ----------
    ground, aerial : float32 [3, H, W]
        As `slicematch.data.images.normalise` gives them.
    random : numpy.random.Generator
        What the changes are drawn from.
    mean, std : (red, green, blue)
        That the images were normalised with.

    Returns
    -------
    ground, aerial : float32 [3, H, W]
        Normalised likewise.
    """
    hue = random.uniform(-_SHARED_HUE, _SHARED_HUE)
    columns = [torch.tensor(values)[:, None, None] for values in (mean, std)]
    return _recolour(ground, hue, random, *columns), _recolour(aerial, hue, random, *columns)


def _recolour(
    image: torch.Tensor,
    hue: float,
    random: np.random.Generator,
    mean: torch.Tensor,
    std: torch.Tensor,
) -> torch.Tensor:
    own = hue + random.uniform(-_OWN_HUE, _OWN_HUE)
    saturation, contrast, brightness = random.uniform(1 - _OWN_FACTOR, 1 + _OWN_FACTOR, 3)
    pixels: torch.Tensor = (image * std + mean).clamp(0.0, 1.0)
    pixels = functional.adjust_hue(pixels, own)
    pixels = functional.adjust_saturation(pixels, saturation)
    pixels = functional.adjust_contrast(pixels, contrast)
    pixels = functional.adjust_brightness(pixels, brightness)
    return (pixels - mean) / std
