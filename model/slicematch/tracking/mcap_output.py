"""A track as ROS 2 messages in an MCAP file, written without ROS."""

import io
from pathlib import Path
from typing import Any

import numpy as np

from slicemask.errors import OutputError
from slicematch.tracking.outputs import Track, yaw_quaternion

POSE_TOPIC, FIX_TOPIC = "/slicemask/pose", "/slicemask/fix"
_POSE, _FIX = "geometry_msgs/msg/PoseWithCovarianceStamped", "sensor_msgs/msg/NavSatFix"
FRAME = "map"
# Of what a drive on the ground does not say: height, pitch and roll.
_UNKNOWN = 1e6
_KNOWN_COVARIANCE = 3  # NavSatFix.COVARIANCE_TYPE_KNOWN


def check_installed(path: Path) -> None:
    """Refuse a file of this kind where the packages that write it are missing."""
    try:
        import mcap.writer  # noqa: F401
        import rosbags.typesys  # noqa: F401
    except ImportError as error:
        raise OutputError(
            f"{path}: MCAP needs mcap and rosbags, of which one cannot be imported ({error}); "
            "install: pip install 'slicemask[drives]', or write a .tum or .csv"
        ) from error


def mcap_bytes(track: Track) -> bytes:
    """A track as an MCAP file.

    Poses are in the frame ``map``: metres east, north and up of the track's origin, which is in the
    file's metadata; what is unknown has a variance of a million.
    """
    from mcap.writer import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    buffer = io.BytesIO()
    writer = Writer(buffer)
    writer.start(profile="ros2", library="slicemask")
    channels = {}
    for topic, kind in ((POSE_TOPIC, _POSE), (FIX_TOPIC, _FIX)):
        text = store.generate_msgdef(kind, ros_version=2)[0]
        name = kind
        schema = writer.register_schema(name, "ros2msg", text.encode())
        channels[kind] = writer.register_channel(topic, "cdr", schema)
    lat, lon = track.origin
    writer.add_metadata("origin", {"lat": repr(lat), "lon": repr(lon), "frame_id": FRAME})
    for number, time_s in enumerate(track.times_s):
        nanoseconds = round(time_s * 1e9)
        for kind, message in _messages(store.types, track, number, nanoseconds).items():
            writer.add_message(
                channels[kind],
                log_time=max(nanoseconds, 0),
                publish_time=max(nanoseconds, 0),
                data=bytes(store.serialize_cdr(message, kind)),
                sequence=number,
            )
    writer.finish()
    return buffer.getvalue()


def _messages(types: Any, track: Track, number: int, nanoseconds: int) -> dict[str, Any]:
    one = track.estimates[number]
    seconds, rest = divmod(nanoseconds, 10**9)
    stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=rest)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=FRAME)
    mode = one.modes[0]
    pose = types["geometry_msgs/msg/Pose"](
        position=types["geometry_msgs/msg/Point"](x=mode.east_m, y=mode.north_m, z=0.0),
        orientation=types["geometry_msgs/msg/Quaternion"](*yaw_quaternion(one.heading_deg)),
    )
    # x, y, z and the turns about them; a heading grows the other way round than a yaw.
    scale = np.array([1.0, 1.0, -np.pi / 180.0])
    known = one.covariance * np.outer(scale, scale)
    covariance = np.diag([0.0, 0.0, _UNKNOWN, _UNKNOWN, _UNKNOWN, 0.0])
    covariance[np.ix_([0, 1, 5], [0, 1, 5])] = known
    place = np.zeros((3, 3))
    place[:2, :2] = one.covariance[:2, :2]
    place[2, 2] = _UNKNOWN
    status = types["sensor_msgs/msg/NavSatStatus"](status=0, service=0)
    return {
        _POSE: types[_POSE](
            header=header,
            pose=types["geometry_msgs/msg/PoseWithCovariance"](
                pose=pose, covariance=covariance.ravel()
            ),
        ),
        _FIX: types[_FIX](
            header=header,
            status=status,
            latitude=one.lat,
            longitude=one.lon,
            altitude=0.0,
            position_covariance=place.ravel(),
            position_covariance_type=_KNOWN_COVARIANCE,
        ),
    }
