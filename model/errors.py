"""Errors of the model: configurations, weights and runs that cannot be used."""

import re

from slicemask.errors import SlicemaskError


class ConfigError(SlicemaskError, ValueError):
    """A setting of training, evaluation or prediction that cannot be."""


class WeightsError(SlicemaskError, OSError):
    """Encoder weights that cannot be had or do not fit the encoder."""


class RunError(SlicemaskError, OSError):
    """A run folder or checkpoint that cannot be written, read or used."""


def is_out_of_memory(error: Exception) -> bool:
    """Whether an error says that memory is short: Python's, or one of torch's, on any device.

    Torch need not be imported to ask.
    """
    # torch.OutOfMemoryError is CUDA's; on the CPU only the text tells.
    return isinstance(error, MemoryError) or (
        isinstance(error, RuntimeError)
        and (
            type(error).__name__ == "OutOfMemoryError"
            or re.search(
                "can(no|')t allocate memory|CUDA out of memory|bad_alloc", str(error), re.IGNORECASE
            )
            is not None
        )
    )
