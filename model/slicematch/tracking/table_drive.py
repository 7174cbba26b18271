"""Drives from a table of frames: as a table of photographs, with times and odometry."""

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slicematch.data.cameras import Camera
from slicematch.data.errors import DatasetError
from slicematch.data.photographs import DRIVE_COLUMNS, Photographs, read_photographs, wrong_cell
from slicematch.data.positions import Fix
from slicematch.data.table_cameras import table_cameras
from slicematch.data.text import parse_number
from slicematch.data.views import is_whole
from slicematch.localization.on_map import PlaceOnGlobe
from slicematch.runs.config import TrainConfig
from slicematch.tracking.drive import Frame, frame_image, mean_odometry, start_at_first_fix


class TableDrive:
    """A drive in a table.

    Parameters
    ----------
    photographs : Photographs
        Its rows; ``lat``, ``lon`` and ``heading_deg`` are the truth, where it is known.
    columns : dict of str to float64 [n]
        Of `DRIVE_COLUMNS`; NaN where a cell is empty.
    cameras : list of Camera or None
        Of each row; None for a whole panorama.
    config : TrainConfig
        Of the run that images are for.
    """

    def __init__(
        self,
        photographs: Photographs,
        columns: dict[str, NDArray[np.float64]],
        cameras: list[Camera | None],
        config: TrainConfig,
    ) -> None:
        self.photographs, self.columns = photographs, columns
        self.cameras, self.config = cameras, config

    def __len__(self) -> int:
        return len(self.photographs)

    def __iter__(self) -> Iterator[Frame]:
        columns = self.columns
        names = ("speed_mps", "yaw_rate_dps")
        before: tuple[float, ...] = ()
        for row in range(len(self)):
            said = tuple(float(columns[name][row]) for name in names)
            ground = self.photographs.ground[row]
            image, note = frame_image(ground, self.cameras[row], self.config)
            yield Frame(
                float(columns["time_s"][row]),
                image,
                mean_odometry(before or said, said),
                self._fix(row),
                self._truth(row),
                note,
            )
            before = said

    def start(self, fixes: bool) -> PlaceOnGlobe | None:
        """At its first fix, if it has one."""
        return start_at_first_fix(self, fixes)

    def _fix(self, row: int) -> Fix | None:
        lat, lon, accuracy_m = (
            float(self.columns[f"gnss_{name}"][row]) for name in ("lat", "lon", "accuracy_m")
        )
        if math.isnan(lat) or math.isnan(lon):
            return None
        return Fix(lat, lon, None if math.isnan(accuracy_m) else accuracy_m)

    def _truth(self, row: int) -> tuple[float, float, float] | None:
        known = [self.photographs.number(name, row) for name in ("lat", "lon", "heading_deg")]
        if known[0] is None or known[1] is None:
            return None
        return known[0], known[1], math.nan if known[2] is None else known[2]


def open_drive(path: Path, config: TrainConfig) -> TableDrive:
    """Open a table of frames.

    Raises
    ------
    DatasetError
        If it is no such table, a time is missing, or a camera is of another projection.
    """
    photographs = read_photographs(path)
    file = photographs.file
    if "time_s" not in file.columns:
        raise DatasetError(
            f"{file.path}: has no column time_s, the frames' times in seconds; its columns are "
            f"{', '.join(file.columns)}"
        )
    columns = {name: _numbers(photographs, name) for name in DRIVE_COLUMNS}
    for row, time_s in enumerate(columns["time_s"]):
        if not math.isfinite(time_s):
            raise wrong_cell(file, row, "time_s", "the frame's time in seconds")
    cameras = table_cameras(photographs)
    used = [cameras.by_name[name] for name in cameras.of_rows]
    for row, camera in enumerate(used):
        if camera.projection != config.projection:
            raise DatasetError(
                f"{file.where(row)}: its camera is {camera.projection}, and the run was trained "
                f"with {config.projection} images; name a run of such cameras"
            )
    of_rows = [None if is_whole(camera) else camera for camera in used]
    return TableDrive(photographs, columns, of_rows, config)


def _numbers(photographs: Photographs, name: str) -> NDArray[np.float64]:
    """A column as float64 [n]; NaN where a cell is empty or says nan, as a broken sensor does."""
    cells = photographs.file.columns.get(name, [None] * len(photographs))
    values = np.full(len(cells), math.nan)
    for row, cell in enumerate(cells):
        if cell is None or str(cell).strip().lower() in ("", "nan", "inf", "-inf"):
            continue
        number = parse_number(str(cell))
        if number is None:
            raise wrong_cell(photographs.file, row, name, "a number, or nothing")
        values[row] = number
    return values
