"""Training images in other styles, so that a model does not learn how they were made.

A model that learns from rendered places can tell by their textures, their colours and their
sharpness what is where; photographs have others. Whatever it goes by has to outlast these changes.
"""

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812  the name torch's own documents use

from slicematch import _torchvision  # noqa: F401  before torchvision: see there
from slicematch.normalisation import IMAGENET_MEAN, IMAGENET_STD, Triple

from torchvision.transforms.v2 import functional  # isort: skip


def restyle(
    image: Tensor,
    random: np.random.Generator,
    mean: Triple = IMAGENET_MEAN,
    std: Triple = IMAGENET_STD,
) -> Tensor:
    """Change what an image looks like, but not what it shows (ours).

    Gamma and a colour cast; now and then grey, a random convolution (Xu and others, *Robust and
    Generalizable Visual Representation Learning via Random Convolutions*, ICLR 2021), shading,
    coarse texture, blur or sharpening, noise; and up to three rectangles that hide what is behind
    them (random erasing: Zhong and others, AAAI 2020).

    Parameters
    ----------
    image : float32 [3, H, W]
        As `slicematch.data.images.normalise` gives it.
    random : numpy.random.Generator
        What the changes are drawn from.
    mean, std : (red, green, blue)
        That the image was normalised with.

    Returns
    -------
    image : float32 [3, H, W]
        Normalised likewise.
    """
    middle, spread = (torch.tensor(values)[:, None, None] for values in (mean, std))
    pixels = (image * spread + middle).clamp(0.0, 1.0)
    pixels = pixels ** float(np.exp(random.uniform(-0.5, 0.5)))
    pixels = pixels * _drawn(random.uniform(0.8, 1.2, (3, 1, 1)))
    if random.random() < 0.15:
        pixels = pixels.mean(dim=0, keepdim=True).expand(3, -1, -1)
    if random.random() < 0.35:
        pixels = _convolved(pixels, random)
    if random.random() < 0.5:
        coarse = random.normal(0.0, 0.25, (1, *random.integers(2, 7, 2)))
        pixels = pixels * _enlarged(coarse, pixels, "bicubic").exp()
    if random.random() < 0.5:
        size = np.array(pixels.shape[1:]) // random.choice([2, 4, 8], 2)
        pixels = pixels + _enlarged(random.normal(0.0, 0.06, (3, *np.maximum(size, 1))), pixels)
    if random.random() < 0.3:
        sigma = float(random.uniform(0.3, 1.5))
        pixels = functional.gaussian_blur(pixels, [5, 5], [sigma, sigma])
    elif random.random() < 0.3:
        sharper = float(random.uniform(1.5, 4.0))
        pixels = functional.adjust_sharpness(pixels.clamp(0.0, 1.0), sharper)
    if random.random() < 0.5:
        noise = random.normal(0.0, random.uniform(0.01, 0.06), pixels.shape)
        pixels = pixels + _drawn(noise)
    return (_hidden(pixels, random).clamp(0.0, 1.0) - middle) / spread


def _convolved(pixels: Tensor, random: np.random.Generator) -> Tensor:
    """Mixed with a random convolution of itself, of the same mean and contrast in each channel."""
    size = int(random.choice([1, 3, 3, 5]))
    kernel = _drawn(random.normal(0.0, 1.0 / (size * 3**0.5), (3, 3, size, size)))
    padded = F.pad(pixels[None], [size // 2] * 4, mode="replicate")
    other = F.conv2d(padded, kernel)[0]
    other = (other - _mean(other)) / (_deviation(other) + 1e-3)
    share = float(random.uniform(0.1, 0.6))
    return (1.0 - share) * pixels + share * (other * _deviation(pixels) + _mean(pixels))


def _mean(pixels: Tensor) -> Tensor:
    return pixels.mean(dim=(1, 2), keepdim=True)


def _deviation(pixels: Tensor) -> Tensor:
    return pixels.std(dim=(1, 2), keepdim=True, correction=0)


def _enlarged(coarse: np.ndarray, pixels: Tensor, mode: str = "bilinear") -> Tensor:
    """Values [channels, rows, columns] in the size of an image."""
    size = list(pixels.shape[1:])
    return F.interpolate(_drawn(coarse)[None], size, mode=mode, align_corners=False)[0]


def _hidden(pixels: Tensor, random: np.random.Generator) -> Tensor:
    """Up to three noisy rectangles in front of an image."""
    pixels = pixels.clone()
    height, width = pixels.shape[1:]
    for _ in range(int(random.integers(0, 4))):
        sides = np.maximum(height * random.uniform(0.05, 0.3, 2), 2.0).astype(int)
        rows, columns = np.minimum(sides, (height, width))
        top, left = random.integers(0, (height - rows + 1, width - columns + 1))
        patch = random.uniform(0.0, 1.0, (3, 1, 1)) + random.normal(0.0, 0.1, (3, rows, columns))
        pixels[:, top : top + rows, left : left + columns] = _drawn(patch)
    return pixels


def _drawn(values: np.ndarray) -> Tensor:
    return torch.from_numpy(values).float()
