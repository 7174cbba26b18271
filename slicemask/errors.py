"""The errors of slicemask. Each is also the built-in a caller would expect to catch."""


class SlicemaskError(Exception):
    """Base of every error that slicemask raises on purpose; its text is one sentence to read."""


class SpecError(SlicemaskError, ValueError):
    """A grid, frustum, cell count, extent or engine that cannot be."""


class PoseError(SlicemaskError, ValueError):
    """A pose outside the tile or not finite, or a pose file that cannot be read as poses."""


class BankError(SlicemaskError, OSError):
    """A bank that cannot be written or read."""


class BankFormatError(BankError):
    """A file that is no bank, or one that is cut short, altered or of another version."""


class BankExistsError(BankError):
    """The output exists already and holds something else."""


class PlotError(SlicemaskError, OSError):
    """A picture that cannot be read or written."""


class OutputError(SlicemaskError, OSError):
    """A file of results that cannot be written where it should go."""


class SynthError(SlicemaskError, OSError):
    """A generated city that cannot be asked for, or that cannot be written where it should go."""
