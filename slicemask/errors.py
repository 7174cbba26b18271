"""The errors of slicemask. Each is also the built-in a caller would expect to catch."""

import errno
import re


class SlicemaskError(Exception):
    """Base of every error that slicemask raises on purpose; its text is one sentence to read."""


class SpecError(SlicemaskError, ValueError):
    """An invalid grid, frustum, cell count, extent or engine."""


class PoseError(SlicemaskError, ValueError):
    """A pose outside the tile or not finite, or a pose file that cannot be read as poses."""


class BankError(SlicemaskError, OSError):
    """A bank that cannot be written or read."""


class BankFormatError(BankError):
    """A file that is not a bank, or one that is truncated, altered or of an unknown version."""


class BankExistsError(BankError):
    """The output exists already and holds something other than the bank asked for."""


class PlotError(SlicemaskError, OSError):
    """A picture that cannot be read or written."""


class ImageError(SlicemaskError, OSError):
    """An image that is missing, corrupt, cut short, too large or of the wrong shape or depth."""


class OutputError(SlicemaskError, OSError):
    """A file of results that cannot be written where it should go."""


class SynthError(SlicemaskError, OSError):
    """Invalid settings of a generated city, or one that cannot be written where it should go."""


class AppError(SlicemaskError, OSError):
    """A page that cannot be served where it was asked for."""


def is_out_of_memory(error: Exception) -> bool:
    """Whether an error says that memory ran out: Python's, or one of torch's, on any device.

    It is recognized without importing torch.

    Parameters
    ----------
    error : Exception
        Any error.

    Returns
    -------
    bool
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


def is_out_of_resources(error: BaseException) -> bool:
    """Whether an error says that memory or open files ran out, so that no file is to blame.

    Parameters
    ----------
    error : BaseException
        Any error of Python's own.

    Returns
    -------
    bool
    """
    return isinstance(error, MemoryError) or (
        isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE, errno.ENOMEM)
    )
