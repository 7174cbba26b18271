"""Drives as they come: frames with their times, odometry and fixes, from any kind of recording."""

import importlib
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from PIL import Image

from slicemask.errors import ImageError
from slicemask.images import Picture
from slicematch.data.cameras import Camera
from slicematch.data.errors import DatasetError
from slicematch.data.positions import Fix
from slicematch.data.views import View, cut_view
from slicematch.localization.on_map import PlaceOnGlobe
from slicematch.localization.photos import Photo
from slicematch.runs.config import TrainConfig
from slicematch.tracking.fixes import ACCURACY_M
from slicematch.tracking.odometry import Odometry


@dataclass(frozen=True)
class Frame:
    """One frame of a drive.

    Attributes
    ----------
    time_s : float
        By the recording's clock.
    image : path, image or None
        None where the frame is missing.
    odometry : Odometry or None
        The mean motion since the frame before.
    fix : Fix or None
        Its accuracy is a standard deviation, to the east and to the north.
    truth : (lat, lon, heading_deg) or None
        Where it was, if that is known; nothing is tracked by it.
    note : str
        Why there is no image, if there is none.
    """

    time_s: float
    image: Picture | None
    odometry: Odometry | None = None
    fix: Fix | None = None
    truth: tuple[float, float, float] | None = None
    note: str = ""


class Drive(Protocol):
    """A recording: how many frames it has, the frames in turn, and where it begins."""

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[Frame]: ...

    def start(self, fixes: bool) -> PlaceOnGlobe | None:
        """Where it begins, about, by the recording itself; None if that is not in it.

        ``fixes`` is whether those of its frames are counted along the way: the place then says no
        more than in which tile to begin, for the first fix is not to count twice.
        """
        ...


def start_at_first_fix(frames: Iterable[Frame], fixes: bool) -> PlaceOnGlobe | None:
    """`Drive.start` of a recording that begins at its first fix."""
    fix = next((frame.fix for frame in frames if frame.fix is not None), None)
    if fix is None:
        return None
    within_m = None if fixes else max(fix.accuracy_m or 0.0, ACCURACY_M)
    return PlaceOnGlobe(fix.lat, fix.lon, within_m)


def open_drive(path: str | Path, config: TrainConfig, **topics: Any) -> Drive:
    """Open a recording by what it is.

    Parameters
    ----------
    path : path
        A table of frames (``.csv``, ``.parquet``, ``.geojson``), a KITTI raw drive (the folder that
        holds ``image_02`` and ``oxts``), or a ROS bag (``.mcap``, ``.bag``, ``.db3``, or the folder
        of a ROS 2 bag).
    config : TrainConfig
        Of the run that images are for.
    **topics
        Names of a bag's topics.

    Raises
    ------
    DatasetError
        If it is none of these, or unreadable.
    """
    path = Path(path)
    if not path.exists():
        raise DatasetError(f"{path}: there is no such file or folder; name a drive")
    if (path / "oxts").is_dir():
        kind = "kitti_drive"
    elif path.suffix.lower() in (".mcap", ".bag", ".db3") or (path / "metadata.yaml").is_file():
        kind = "bag_drive"
    else:
        kind = "table_drive"
    if topics and kind != "bag_drive":
        raise DatasetError(f"{path}: is no bag, so that it has no topics; leave out {min(topics)}")
    module = importlib.import_module(f"slicematch.tracking.{kind}")
    opened: Drive = module.open_drive(path, config, **topics)
    return opened


def mean_odometry(before: Sequence[float | None], after: Sequence[float | None]) -> Odometry | None:
    """The mean of what odometry says at two frames, (speed, yaw rate) each; None if unknown."""
    values = []
    for first, second in zip(before, after, strict=True):
        known = [value for value in (first, second) if value is not None and math.isfinite(value)]
        if not known:
            return None
        values.append(sum(known) / len(known))
    return Odometry(*values)


def frame_image(
    path: str | Path, camera: Camera | None, config: TrainConfig
) -> tuple[Picture | None, str]:
    """An image as a run takes it, and why there is none."""
    if not Path(path).exists():
        return None, "the image is missing"
    if camera is None:
        return str(path), ""
    try:
        return Photo(0, str(path), str(path), camera=camera).image(config), ""
    except ImageError as error:
        return None, f"the image is not used: {error}"


def view_of(image: Image.Image, camera: Camera, config: TrainConfig) -> tuple[Picture | None, str]:
    """What a run takes of a camera's image, and why it cannot."""
    view, size = config.data_settings.get("view"), config.ground_size
    if view is None or size is None:
        return image, ""
    try:
        image = camera.undistort(image, "the image")
        return cut_view(image, camera, View(*view), None, size, "the image"), ""
    except ImageError as error:
        return None, f"the image is not used: {error}"
