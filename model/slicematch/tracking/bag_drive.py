"""Drives from ROS bags: ROS 2's (SQLite or MCAP), single MCAP files, and ROS 1's; without ROS."""

import io
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from slicematch.data.cameras import Camera
from slicematch.data.errors import DatasetError
from slicematch.data.positions import Fix
from slicematch.data.views import is_whole
from slicematch.localization.on_map import PlaceOnGlobe
from slicematch.runs.config import TrainConfig
from slicematch.tracking.drive import Frame, mean_odometry, start_at_first_fix

_IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_ODOMETRY, _IMU, _FIX = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix"
_CAMERA = "sensor_msgs/msg/CameraInfo"
# Encodings of plain images: channels, and where red, green and blue are.
_CHANNELS = {
    "rgb8": (3, (0, 1, 2)), "bgr8": (3, (2, 1, 0)), "rgba8": (4, (0, 1, 2)),
    "bgra8": (4, (2, 1, 0)), "mono8": (1, (0, 0, 0)),
}  # fmt: skip


class BagDrive:
    """A drive in a ROS bag.

    Frames are the messages of an image topic. Between two of them motion is the mean of what the
    odometry's twist says (forward along x, turning about z), the turning from an IMU where there is
    one. Nothing is known of the truth.

    Parameters
    ----------
    path : Path
    config : TrainConfig
        Of the run that images are for.
    topics : dict of str to str or None
        ``image_topic``, ``odometry_topic``, ``imu_topic``, ``fix_topic``; None for the only one.
    """

    def __init__(self, path: Path, config: TrainConfig, topics: dict[str, str | None]) -> None:
        self.path, self.config = path, config
        with _reader(path) as reader:
            kinds = {one.topic: (one.msgtype, one.msgcount) for one in reader.connections}
            self.image = _choose(path, kinds, _IMAGES, topics.get("image_topic"), "--image-topic")
            self.odometry, self.imu, self.fix = (
                _choose(path, kinds, (kind,), topics.get(name), f"--{name.replace('_', '-')}", True)
                for kind, name in (
                    (_ODOMETRY, "odometry_topic"), (_IMU, "imu_topic"), (_FIX, "fix_topic"),
                )
            )  # fmt: skip
            self.camera_info = next((t for t, (kind, _) in kinds.items() if kind == _CAMERA), None)
            self._count = kinds[str(self.image)][1]

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[Frame]:
        wanted = {self.image, self.odometry, self.imu, self.fix, self.camera_info} - {None}
        speeds: list[float] = []
        turns: dict[str, list[float]] = {"odometry": [], "imu": []}
        fix: Fix | None = None
        camera: Camera | None = None
        with _reader(self.path) as reader:
            chosen = [one for one in reader.connections if one.topic in wanted]
            for connection, stamp, raw in reader.messages(connections=chosen):
                message = reader.deserialize(raw, connection.msgtype)
                topic = connection.topic
                if topic == self.odometry:
                    speeds.append(float(message.twist.twist.linear.x))
                    turns["odometry"].append(_clockwise_dps(message.twist.twist.angular.z))
                elif topic == self.imu:
                    turns["imu"].append(_clockwise_dps(message.angular_velocity.z))
                elif topic == self.fix:
                    fix = fix_of(message)
                elif topic == self.camera_info:
                    camera = _camera(message) if camera is None else camera
                else:
                    yaw = turns["imu"] or turns["odometry"]
                    means = [float(np.mean(some)) if some else None for some in (speeds, yaw)]
                    picture, note = _picture(message, connection.msgtype, camera, self.config)
                    # ROS's y and z axes point left and up.
                    yield Frame(
                        _time_s(message, stamp),
                        picture,
                        mean_odometry(means, means),
                        fix,
                        None,
                        note,
                    )
                    speeds, turns, fix = [], {"odometry": [], "imu": []}, None

    def start(self, fixes: bool) -> PlaceOnGlobe | None:
        """At its first fix, if it has one."""
        return start_at_first_fix(self, fixes)


def open_drive(path: Path, config: TrainConfig, **topics: str | None) -> BagDrive:
    """Open a bag.

    Raises
    ------
    DatasetError
        If rosbags is missing, the bag is unreadable, or it is not clear which topic is meant.
    """
    try:
        import rosbags.highlevel  # noqa: F401
    except ImportError as error:
        raise DatasetError(
            f"{path}: bags need rosbags, which cannot be imported ({error}); install: "
            "pip install 'slicemask[drives]'"
        ) from error
    return BagDrive(path, config, topics)


def _reader(path: Path) -> Any:
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import Stores, get_typestore

    try:
        return AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
    except (AnyReaderError, OSError, ValueError) as error:
        raise DatasetError(f"{path}: is unreadable as a ROS bag ({error})") from error


def _choose(
    path: Path,
    kinds: dict[str, tuple[str, int]],
    wanted: tuple[str, ...],
    asked: str | None,
    option: str,
    may_lack: bool = False,
) -> str | None:
    """The topic that is meant."""
    found = sorted(topic for topic, (kind, _) in kinds.items() if kind in wanted)
    if asked is not None:
        if asked in found:
            return asked
        raise DatasetError(
            f"{path}: has no topic {asked} of {' or '.join(wanted)}; it has "
            f"{', '.join(found) or 'none'}"
        )
    if len(found) > 1:
        raise DatasetError(f"{path}: has several such topics; name one ({option}): "
                           f"{', '.join(found)}")  # fmt: skip
    if not found and not may_lack:
        raise DatasetError(
            f"{path}: has no topic of {' or '.join(wanted)}, so that it shows nothing"
        )
    return found[0] if found else None


def _clockwise_dps(radians: float) -> float:
    return -math.degrees(float(radians))


def _time_s(message: Any, stamp: int) -> float:
    header = message.header.stamp
    seconds = header.sec + header.nanosec * 1e-9
    return float(seconds if seconds > 0 else stamp * 1e-9)


def fix_of(message: Any) -> Fix | None:
    """What a sensor_msgs/NavSatFix says; None where it has no fix."""
    if message.status.status < 0 or not math.isfinite(message.latitude + message.longitude):
        return None
    variance = float(np.mean(np.asarray(message.position_covariance)[[0, 4]]))
    accuracy_m = math.sqrt(variance) if message.position_covariance_type and variance > 0 else None
    return Fix(float(message.latitude), float(message.longitude), accuracy_m)


def _camera(message: Any) -> Camera | None:
    matrix = np.asarray(message.K if hasattr(message, "K") else message.k, dtype=float)
    if not matrix[0] > 0:  # not calibrated
        return None
    fx, cx, fy, cy = matrix[[0, 2, 4, 5]].tolist()
    raw = np.asarray(message.D if hasattr(message, "D") else message.d, dtype=float).tolist()
    fisheye = message.distortion_model in ("equidistant", "fisheye")
    names = (
        ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    )
    return Camera(
        projection="pinhole",
        width=int(message.width),
        height=int(message.height),
        fx=fx, fy=fy, cx=cx, cy=cy,
        model="OPENCV_FISHEYE" if fisheye else "OPENCV",
        **dict(zip(names, raw, strict=False)),
    )  # fmt: skip


def _picture(
    message: Any, kind: str, camera: Camera | None, config: TrainConfig
) -> tuple[Any, str]:
    """An image message as a run takes it, or why it cannot."""
    try:
        if kind.endswith("CompressedImage"):
            image = Image.open(io.BytesIO(bytes(message.data))).convert("RGB")
        else:
            image = Image.fromarray(_plain(message))
    except (OSError, ValueError, KeyError) as error:
        return None, f"the image is not used: it is unreadable ({error})"
    if config.projection == "pinhole" and camera is not None and not is_whole(camera):
        from slicematch.tracking.drive import view_of

        return view_of(image, camera, config)
    return image, ""


def _plain(message: Any) -> np.ndarray:
    """The pixels of an image message, uint8 [H, W, 3]."""
    channels, order = _CHANNELS[str(message.encoding).lower()]
    rows = np.asarray(message.data, dtype=np.uint8).reshape(message.height, message.step)
    pixels = rows[:, : message.width * channels].reshape(message.height, message.width, channels)
    return np.ascontiguousarray(pixels[..., list(order)])
