"""Errors of the model: configurations, weights and runs that cannot be used."""

from slicemask.errors import SlicemaskError


class ConfigError(SlicemaskError, ValueError):
    """An invalid setting of training, evaluation or prediction."""


class WeightsError(SlicemaskError, OSError):
    """Encoder weights that are not available or do not fit the encoder."""


class RunError(SlicemaskError, OSError):
    """A run folder or checkpoint that cannot be written, read or used."""
