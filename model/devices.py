"""Where a trained model runs."""

import torch

from model.errors import ConfigError


def choose_device(device: str) -> torch.device:
    """The device of a name: "cpu", "cuda" or "cuda:1"; "auto" is CUDA where it is, else the CPU.

    Raises
    ------
    ConfigError
        If it is another, or is not there.
    """
    if device == "auto":
        device = "cuda" if torch.cuda.is_available() else "cpu"
    try:
        chosen = torch.device(device)
        if chosen.type not in ("cpu", "cuda"):
            raise RuntimeError(f"slicemask does not run on {chosen.type}")
        torch.empty(0, device=chosen)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).strip().split("\n")[0]
        raise ConfigError(
            f"device {device!r} cannot be used ({reason}); choose auto, cpu, cuda or cuda:N"
        ) from error
    return chosen
