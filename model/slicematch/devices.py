"""Where a model is trained, where it runs, and in how many bits."""

import logging
from contextlib import AbstractContextManager, nullcontext
from typing import cast, get_args

import torch

from slicematch.errors import ConfigError
from slicematch.precision import Precision

log = logging.getLogger(__name__)

_AUTOCAST = {"16-mixed": torch.float16, "bf16-mixed": torch.bfloat16}


def check_precision(precision: str, device: torch.device) -> Precision:
    """Return the name of a precision; warn if the device computes in it, but slowly.

    Raises
    ------
    ConfigError
        If there is none of that name, or the device takes for ever to compute in it.
    """
    if precision not in get_args(Precision):
        raise ConfigError(
            f"precision is {precision!r}; it must be one of {', '.join(get_args(Precision))}"
        )
    if precision == "16-mixed" and device.type == "cpu":
        raise ConfigError(
            "precision '16-mixed' is for GPUs, a CPU takes hundreds of times longer; choose "
            "bf16-mixed"
        )
    if precision == "bf16-mixed" and device.type == "cpu" and not _has_bf16():
        log.warning(
            "precision bf16-mixed takes many times longer than 32-true on this processor, which "
            "has no instructions for it (AVX-512 or AMX); choose 32-true"
        )
    return cast(Precision, precision)


def _has_bf16() -> bool:
    """Whether this processor's kernels for bfloat16 are fast ones."""
    return bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())


def autocast(device: torch.device, precision: Precision) -> AbstractContextManager[object]:
    """Where torch computes in the bits of a mixed precision; nothing changes for "32-true"."""
    if precision == "32-true":
        return nullcontext()
    return torch.autocast(device.type, _AUTOCAST[precision])


def precision_note(precision: Precision) -> str:
    """What a report's line adds where the encoders do not compute in float32."""
    return "" if precision == "32-true" else f", encoders {precision}"


def device_name(name: str) -> str:
    """The kind of device that a name stands for: "auto" is CUDA where it is there, else the CPU.

    Raises
    ------
    ConfigError
        If it is another than the CPU and CUDA. Apple's mps, for one, has no float64, in which
        masks of exact poses are computed.
    """
    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    if name == "gpu":  # Lightning's, which may be an mps
        return "cuda"
    if name.split(":")[0] not in ("cpu", "cuda"):
        raise ConfigError(f"device {name!r} cannot be used; choose auto, cpu, cuda or cuda:N")
    return name


def choose_device(name: str) -> torch.device:
    """The device of a name, as in `device_name`; "cuda:1" is the second one.

    Raises
    ------
    ConfigError
        If there is no such device, or it cannot be used.
    """
    try:
        chosen = torch.device(device_name(name))
        torch.empty(0, device=chosen)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).strip().split("\n")[0]
        raise ConfigError(
            f"device {name!r} cannot be used ({reason}); choose auto, cpu, cuda or cuda:N"
        ) from error
    return chosen
