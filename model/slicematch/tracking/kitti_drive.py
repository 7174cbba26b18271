"""Drives in KITTI's raw format: image_02, and oxts for odometry."""

from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

import numpy as np

from slicematch.data.cameras import Camera
from slicematch.data.errors import DatasetError
from slicematch.data.text import parse_number
from slicematch.localization.on_map import PlaceOnGlobe
from slicematch.runs.config import TrainConfig
from slicematch.tracking.drive import Frame, frame_image, mean_odometry
from slicematch.tracking.fixes import ACCURACY_M

# Fields of an oxts line: latitude, longitude and yaw; speed forward; yaw rate.
LAT, LON, YAW, FORWARD, YAW_RATE = 0, 1, 5, 8, 19
FIELDS = 30
RATE_HZ = 10.0  # where a drive has no times


class KittiDrive:
    """A KITTI raw drive.

    The receiver's places are the truth where errors are reported, so that only the first is a fix:
    where the drive begins. Its speeds and yaw rates are the odometry.

    Parameters
    ----------
    folder : Path
        That holds ``image_02`` and ``oxts``.
    config : TrainConfig
        Of the run that images are for.
    """

    def __init__(self, folder: Path, config: TrainConfig) -> None:
        self.folder, self.config = folder, config
        self.camera = _camera(folder.resolve().parent / "calib_cam_to_cam.txt")
        self.records = sorted((folder / "oxts" / "data").glob("*.txt"))
        if not self.records:
            raise DatasetError(f"{folder / 'oxts' / 'data'}: holds no record; name a raw drive")
        self.times_s = _times(folder / "oxts" / "timestamps.txt", self.records)

    def __len__(self) -> int:
        return len(self.records)

    def start(self, fixes: bool) -> PlaceOnGlobe:
        """About where its first record is, which is the truth: as a fix of 20 m would say it."""
        fields = _fields(self.records[0])
        return PlaceOnGlobe(fields[LAT], fields[LON], ACCURACY_M)

    def __iter__(self) -> Iterator[Frame]:
        before: tuple[float, float] | None = None
        for path, time_s in zip(self.records, self.times_s, strict=True):
            fields = _fields(path)
            # Headings grow clockwise, yaw grows counter-clockwise.
            said = fields[FORWARD], -float(np.degrees(fields[YAW_RATE]))
            image = self.folder / "image_02" / "data" / f"{path.stem}.png"
            picture, note = frame_image(image, self.camera, self.config)
            heading_deg = (90.0 - float(np.degrees(fields[YAW]))) % 360.0
            yield Frame(
                time_s,
                picture,
                mean_odometry(before or said, said),
                None,  # its records are the truth
                (fields[LAT], fields[LON], heading_deg),
                note,
            )
            before = said


def open_drive(path: Path, config: TrainConfig) -> KittiDrive:
    """Open a KITTI raw drive.

    Raises
    ------
    DatasetError
        If the run takes panoramas, or the drive has no records.
    """
    if config.projection != "pinhole":
        raise DatasetError(
            f"{path}: is a KITTI drive, of a pinhole camera, and the run was trained with "
            f"{config.projection} images; name a run of such cameras"
        )
    return KittiDrive(path, config)


def _fields(path: Path) -> list[float]:
    values = [parse_number(word) for word in _read(path).split()]
    if len(values) < FIELDS or any(value is None for value in values):
        raise DatasetError(f"{path}: is no oxts record of {FIELDS} numbers")
    return [float(value) for value in values if value is not None]


def _times(path: Path, records: list[Path]) -> list[float]:
    """Seconds of the records from ``timestamps.txt``; by their numbers at 10 Hz without it."""
    numbers = [int(record.stem) for record in records]
    if not path.exists():
        return [number / RATE_HZ for number in numbers]
    lines = path.read_text(encoding="utf-8").splitlines()
    try:
        # Nanoseconds are more than Python reads.
        times = [datetime.fromisoformat(line[:26]).timestamp() for line in lines if line.strip()]
        return [times[number] - times[0] for number in numbers]
    except (ValueError, IndexError) as error:
        raise DatasetError(
            f"{path}: has no time for each of {len(records)} records ({error})"
        ) from error


def _camera(path: Path) -> Camera:
    """The left colour camera, from the day's calibration file."""
    lines = dict(
        line.split(":", 1) for line in _read(path).splitlines() if line.startswith("P_rect_02:")
    )
    values = [parse_number(word) for word in lines.get("P_rect_02", "").split()]
    sizes = [line.split()[1:] for line in _read(path).splitlines() if line.startswith("S_rect_02:")]
    if len(values) != 12 or not sizes or any(value is None for value in values):
        raise DatasetError(f"{path}: has no usable P_rect_02 and S_rect_02; fetch it again")
    width, height = (round(float(number)) for number in sizes[0])
    fx, cx, fy, cy = (values[k] for k in (0, 2, 5, 6))
    return Camera(projection="pinhole", width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy)


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(f"{path}: is unreadable ({error})") from error
