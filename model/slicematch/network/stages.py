"""Which stages of a backbone are taken, and the shapes of what they give.

Both are found by trying the backbone on shapes alone. That takes a third of a second and 30 MB,
since torch brings its symbolic algebra for it; so a run keeps what was found, and need not try
again.
"""

import math
import re
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import torch
from torch import nn

from slicematch import _torchvision  # noqa: F401  before timm: see there
from slicematch.errors import ConfigError

import timm  # isort: skip
from timm.layers.format import Format  # isort: skip


@dataclass(frozen=True)
class Stages:
    """The stages of a timm backbone that an encoder takes, and what they give of an image.

    Attributes
    ----------
    name : str
        The backbone.
    image_size : (height, width)
        Pixels of the image.
    stride : int
        Of the first stage.
    deepest : int
        Stride that no stage is beyond.
    timm : str
        The version of timm that this is so with.
    sized : bool
        Whether the backbone is built for one image size.
    indices : tuple of int
        timm's numbers of the stages.
    shapes : tuple of (channels, height, width)
        Of the features of each.
    smallest_batch : int
        The smallest batch that the backbone trains on.
    """

    name: str
    image_size: tuple[int, int]
    stride: int
    deepest: int
    timm: str
    sized: bool
    indices: tuple[int, ...]
    shapes: tuple[tuple[int, int, int], ...]
    smallest_batch: int

    @property
    def options(self) -> dict[str, Any]:
        """What timm builds such a backbone from."""
        size = {"img_size": self.image_size} if self.sized else {}
        return {"features_only": True, **size, "out_indices": self.indices}

    def suit(self, name: str, image_size: tuple[int, int], stride: int, deepest: int) -> bool:
        """Whether they are what `find_stages` would find here."""
        asked = name, tuple(image_size), stride, deepest, timm.__version__
        return asked == (self.name, self.image_size, self.stride, self.deepest, self.timm)

    def are_of(self, backbone: Any) -> bool:
        """Whether a backbone that was built from `options` says the same of itself."""
        info = backbone.feature_info
        channels = [shape[0] for shape in self.shapes]
        return info.reduction()[0] == self.stride and info.channels() == channels

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for a file."""
        return asdict(self)

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> "Stages":
        """From `to_dict`'s values, read back from JSON.

        Raises
        ------
        KeyError, TypeError, ValueError
            If they are none.
        """
        numbers = {"stride", "deepest", "smallest_batch"}
        lists = {
            "image_size": tuple(content["image_size"]),
            "indices": tuple(content["indices"]),
            "shapes": tuple(tuple(shape) for shape in content["shapes"]),
        }
        found = cls(**{**content, **lists})
        whole = [
            *(getattr(found, name) for name in numbers),
            *found.image_size,
            *found.indices,
            *(size for shape in found.shapes for size in shape),
        ]
        if not all(type(number) is int and 0 <= number < 2**20 for number in whole):
            raise ValueError(f"{whole} are not whole numbers of such a size")
        if not found.shapes or any(len(shape) != 3 for shape in found.shapes):
            raise ValueError(f"shapes are {found.shapes}")
        in_order = sorted(set(found.indices)) == [*found.indices]
        if not in_order or len(found.indices) != len(found.shapes):
            raise ValueError(f"stages are {found.indices}")
        if (type(found.name), type(found.sized), len(found.image_size)) != (str, bool, 2):
            raise ValueError(f"{found.name}, {found.image_size} and {found.sized} are no question")
        # However a backbone pads, a stride leaves about so much of an image.
        for pixels, size in zip(found.image_size, found.shapes[0][1:], strict=True):
            if size < 1 or abs(size * found.stride - pixels) >= 2 * found.stride:
                raise ValueError(f"{size} steps of {found.stride} pixels are not {pixels}")
        return found


def find_stages(name: str, image_size: tuple[int, int], stride: int, deepest: int) -> Stages:
    """The last stage of a stride, and those after it up to a deepest stride, found by trial.

    Parameters
    ----------
    name : str
        A timm model that gives feature maps.
    image_size : (height, width)
        Pixels of the images.
    stride, deepest : int
        Pixels of the image for one step in the feature maps.

    Raises
    ------
    ConfigError
        If timm has no such model, or the model has no stage of that stride or cannot take images of
        that size.
    """
    # timm also takes addresses on a hub; a run's settings may not send anyone there.
    if not timm.is_model(name.split(".")[0]):
        raise ConfigError(
            f"encoder {name!r} is no timm model; name one that timm.list_models() lists, such as "
            "vgg16 or resnet50"
        )
    try:
        # Transformers are built for one image size.
        sized = hasattr(_trial(name), "set_input_size")
        size = {"img_size": image_size} if sized else {}
        net: Any = _trial(name, features_only=True, **size)
        strides: list[int] = net.feature_info.reduction()
    except Exception as error:  # each backbone refuses in its own way
        raise ConfigError(
            f"encoder {name!r} cannot be made for images of {_size(image_size)} "
            f"({first_line(error)}); name one that gives feature maps of such images, such as "
            "vgg16 or resnet50"
        ) from error
    if stride not in strides:
        raise ConfigError(
            f"encoder {name!r} has no stage of stride {stride}; it has "
            f"{', '.join(str(s) for s in sorted(set(strides)))}"
        )
    last = {found: stage for stage, found in enumerate(strides)}
    wanted = sorted(found for found in last if found == stride or stride < found <= deepest)
    indices = tuple(last[found] for found in wanted)
    shapes, smallest = _try_images(name, {**size, "out_indices": indices}, image_size)
    return Stages(
        name, image_size, stride, deepest, timm.__version__, sized, indices, shapes, smallest
    )


def gives_channels_last(backbone: Any) -> bool:
    """Whether a backbone's features are [B, H, W, C]."""
    return bool(getattr(backbone, "output_fmt", None) == Format.NHWC)


def cut_unused(backbone: Any) -> None:
    """Drop blocks that lie deeper than all features, which some backbones go through regardless.

    Of an EfficientNet at stride 16 that is a quarter of the time and most of the weights.
    """
    info = backbone.feature_info
    deepest = re.fullmatch(r"blocks\.(\d+)", info.module_name(info.out_indices[-1]))
    if deepest and isinstance(getattr(backbone, "blocks", None), nn.Sequential):
        del backbone.blocks[int(deepest[1]) + 1 :]


@lru_cache(maxsize=8)  # ground and aerial encoder are mostly alike
def _trial(name: str, **options: Any) -> Any:
    """A model to try things on, of shapes alone: no memory, no random numbers."""
    with torch.device("meta"):
        return timm.create_model(name, **options)


def _try_images(
    name: str, options: dict[str, Any], image_size: tuple[int, int]
) -> tuple[tuple[tuple[int, int, int], ...], int]:
    """The shapes of one image's features, and the smallest batch that the backbone trains on."""
    multiple = 32
    try:
        with torch.device("meta"):
            net: Any = _trial(name, features_only=True, **options)
            cut_unused(net)
            multiple = math.lcm(multiple, *net.feature_info.reduction())
            image = torch.zeros(1, 3, *image_size)
            # Batch normalisation takes a single value of a channel only where it does not train.
            stages = net.eval()(image)
            if gives_channels_last(net):
                stages = [stage.permute(0, 3, 1, 2) for stage in stages]
            shapes = tuple(tuple(stage.shape[1:]) for stage in stages)
            smallest = 1 if _trains_on(net.train(), image) else 2
    except Exception as error:  # each backbone refuses in its own way
        raise ConfigError(
            f"encoder {name!r} does not take images of {_size(image_size)} "
            f"({first_line(error)}); try sides that are multiples of {multiple}"
        ) from error
    return shapes, smallest


def _trains_on(net: nn.Module, image: torch.Tensor) -> bool:
    """Whether a network in training takes a batch of one image [1, 3, height, width]."""
    try:
        net(image)
    except ValueError as error:
        if "more than 1 value per channel" not in str(error):
            raise
        return False
    return True


def first_line(error: BaseException) -> str:
    """The first line of what an error of another library says, for a sentence of ours."""
    lines = str(error).strip().splitlines()
    return lines[0].rstrip(".") if lines else type(error).__name__


def _size(image_size: tuple[int, int]) -> str:
    return f"{image_size[0]}x{image_size[1]} pixels (height x width)"
