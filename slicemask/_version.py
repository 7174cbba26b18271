"""The one place of the version, which the build reads as text."""

__version__ = "0.2.0"
