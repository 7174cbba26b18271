"""What the library says while it works, on stderr."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

import click


class _OnStderr(logging.Handler):
    """Writes each message as a line, and none twice."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self._written: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record's message, if it is new."""
        message = self.format(record)
        if message not in self._written:
            self._written.add(message)
            click.echo(message, err=True)


@contextmanager
def messages_on_stderr(logger: str) -> Iterator[None]:
    """Write what a logger says on stderr: notes on progress too, and nothing twice.

    Parameters
    ----------
    logger : str
        Its name, such as "slicematch".
    """
    handler, chosen = _OnStderr(), logging.getLogger(logger)
    level = chosen.level
    chosen.addHandler(handler)
    chosen.setLevel(logging.INFO)
    try:
        yield
    finally:
        chosen.setLevel(level)
        chosen.removeHandler(handler)
