"""A row of a table."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Figure:
    """One measured figure: what, the measurement, the target if there is one, and whether met."""

    what: str
    measured: str
    target: str = ""
    met: bool | None = None
