"""The errors of the data loaders."""

from slicemask.errors import SlicemaskError


class DataError(SlicemaskError):
    """Base of the loaders' errors; its text stays one sentence across processes.

    A torch loader raises a worker's error again in the main process, with the worker's whole
    traceback for a text. Its last line, ``module.Class: sentence``, is what there is to read.
    """

    def __init__(self, message: str):
        if message.startswith("Caught ") and "\n" in message:
            message = message.rstrip().rsplit("\n", 1)[1].split(": ", 1)[1]
        super().__init__(message)


class DatasetError(DataError, ValueError):
    """A data tree, a label file or a data setting that is unusable."""


class SampleError(DataError, OSError):
    """One sample that is unusable, because a file of it is missing or broken."""


class MapError(DataError, OSError):
    """A map that is unusable: missing, broken, without a place on the globe, or of other pixels."""


class PlaceError(SampleError):
    """A place that is none, or that a map does not show."""


class LoaderError(DataError, OSError):
    """Loading that ended because processes, shared memory or open files ran out."""
