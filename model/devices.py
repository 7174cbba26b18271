"""Where a model is trained, and where it runs."""

import torch

from model.errors import ConfigError


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
    name = device_name(name)
    try:
        chosen = torch.device(name)
        torch.empty(0, device=chosen)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).strip().split("\n")[0]
        raise ConfigError(
            f"device {name!r} cannot be used ({reason}); choose auto, cpu, cuda or cuda:N"
        ) from error
    return chosen
