"""A track that was written as a table, read back."""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slicematch.data.errors import DatasetError

Floats = NDArray[np.float64]

_NUMBERS = (
    "time_s", "lat", "lon", "heading_deg", "probability", "ellipse_major_m", "ellipse_minor_m",
    "ellipse_azimuth_deg",
)  # fmt: skip


@dataclass(frozen=True)
class RecordedTrack:
    """Poses over time with their ellipses of 95 %, as `write_track` writes them to a ``.csv``.

    Attributes
    ----------
    time_s, lat, lon, heading_deg, probability : float64 [T]
    ellipse_major_m, ellipse_minor_m, ellipse_azimuth_deg : float64 [T]
        Semi-axes, and the larger one's azimuth.
    notes : tuple of str [T]
        What went wrong.
    """

    time_s: Floats
    lat: Floats
    lon: Floats
    heading_deg: Floats
    probability: Floats
    ellipse_major_m: Floats
    ellipse_minor_m: Floats
    ellipse_azimuth_deg: Floats
    notes: tuple[str, ...]

    @classmethod
    def read(cls, path: str | Path) -> "RecordedTrack":
        """Read a track.

        Raises
        ------
        DatasetError
            If the file is unreadable, or is no such table.
        """
        try:
            with open(path, newline="", encoding="utf-8") as file:
                rows = list(csv.DictReader(file))
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise DatasetError(
                f"{path}: cannot be read ({error}); name a .csv that slicemask track wrote"
            ) from error
        wanted = (*_NUMBERS, "notes")
        missing = [name for name in wanted if not rows or rows[0].get(name) is None]
        if missing:
            what = f"has no column {missing[0]}" if rows else "holds no pose"
            raise DatasetError(f"{path}: {what}; name a .csv that slicemask track wrote")
        columns = {}
        for name in _NUMBERS:
            values = np.empty(len(rows))
            for number, row in enumerate(rows):
                try:
                    values[number] = float(row[name])
                except (TypeError, ValueError):
                    values[number] = np.nan
                if not np.isfinite(values[number]):
                    raise DatasetError(
                        f"{path}: row {number + 1}: {name} is {row[name]!r}; expected a number"
                    )
            columns[name] = values
        return cls(**columns, notes=tuple(row["notes"] or "" for row in rows))
