"""Drives as they are recorded: tables, KITTI's folders and ROS bags."""

import math
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image
from slicematch.data.errors import DatasetError
from slicematch.runs.config import TrainConfig
from slicematch.tracking.drive import open_drive

PANORAMAS = TrainConfig(data="vigor", root=".")
CAMERAS = TrainConfig(data="kitti", root=".")


@pytest.fixture
def table(tmp_path):
    """Write a table of frames, of which the third has no image."""
    for number in (0, 1):
        Image.new("RGB", (32, 16)).save(tmp_path / f"{number}.jpg")

    def write(*lines, header="time_s,ground,speed_mps,yaw_rate_dps,gnss_lat,gnss_lon,lat,lon"):
        (tmp_path / "drive.csv").write_text("\n".join([header, *lines]) + "\n")
        return tmp_path / "drive.csv"

    return write


def test_a_table_gives_frames_and_the_mean_motion_between_them(table):
    path = table(
        "10.0,0.jpg,4.0,0,40.70,-74.0,40.701,-74.001",
        "10.1,1.jpg,6.0,10,,,,",
        "10.2,2.jpg,nan,20,,,,",
        "10.3,1.jpg,,,,,,",
    )
    frames = list(open_drive(path, PANORAMAS))
    assert [frame.time_s for frame in frames] == [10.0, 10.1, 10.2, 10.3]
    assert (frames[1].odometry.speed_mps, frames[1].odometry.yaw_rate_dps) == (5.0, 5.0)
    assert frames[2].odometry.speed_mps == 6.0  # of the frame that says one
    assert frames[3].odometry is None
    assert frames[0].fix.lat == 40.70
    assert frames[1].fix is None
    assert frames[0].truth[:2] == (40.701, -74.001)
    assert math.isnan(frames[0].truth[2])
    assert (frames[2].image, frames[2].note) == (None, "the image is missing")


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (",0.jpg,1,0,,,,", "line 2: time_s is empty; expected the frame's time in seconds"),
        ("0,0.jpg,fast,0,,,,", "line 2: speed_mps is 'fast'; expected a number, or nothing"),
    ],
)
def test_a_wrong_cell_is_named(table, line, said):
    with pytest.raises(DatasetError, match=said):
        open_drive(table(line), PANORAMAS)


def test_what_is_no_drive_is_refused(table, tmp_path):
    with pytest.raises(DatasetError, match="has no column time_s"):
        open_drive(table("0.jpg", header="ground"), PANORAMAS)
    with pytest.raises(DatasetError, match="there is no such file or folder"):
        open_drive(tmp_path / "none.csv", PANORAMAS)
    with pytest.raises(DatasetError, match="its camera is equirectangular"):
        open_drive(table("0,0.jpg,1,0,,,,"), CAMERAS)


def test_a_kitti_drive_has_its_speeds(tmp_path):
    pytest.importorskip("trimesh")
    from slicemask.synth import generate_kitti

    generate_kitti(tmp_path, frames=12, seed=2, image_size=(124, 38), tile_size=512, jobs=1)
    folder = max(
        tmp_path.glob("raw_data/*/*_sync"), key=lambda path: len(list(path.glob("oxts/data/*")))
    )
    frames = list(open_drive(folder, CAMERAS))
    assert len(frames) >= 4
    assert frames[1].time_s == pytest.approx(0.4)
    # Its records are the truth, of which a track may know where the drive begins, about.
    drive = open_drive(folder, CAMERAS)
    assert all(frame.fix is None for frame in frames)
    assert drive.start(True) == drive.start(False)
    assert drive.start(True).within_m == 20.0
    for before, frame in pairwise(frames):
        assert 8 < frame.odometry.speed_mps < 12  # frames are 4 m and 0.4 s apart
        turned = (frame.truth[2] - before.truth[2] + 180) % 360 - 180
        assert abs(turned - 0.4 * frame.odometry.yaw_rate_dps) < 4
    assert frames[0].image is not None
    with pytest.raises(DatasetError, match="is a KITTI drive, of a pinhole camera"):
        open_drive(folder, PANORAMAS)


@pytest.fixture(params=["sqlite3", "mcap"])
def bag(request, tmp_path):
    """A ROS 2 bag: five images at 10 Hz, odometry at 20 Hz, an IMU, and one fix."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    pytest.importorskip("mcap")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    types = store.types

    def make(kind, **fields):
        return types[kind](**fields)

    def header(nanoseconds):
        seconds, rest = divmod(nanoseconds, 10**9)
        stamp = make("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
        return make("std_msgs/msg/Header", stamp=stamp, frame_id="camera")

    def vector(x=0.0, y=0.0, z=0.0):
        return make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)

    upright = make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    pixels = np.zeros((16, 32, 3), np.uint8)
    pixels[..., 2] = 200  # in bgr8, red
    path = tmp_path / "bag"
    storage = getattr(rosbag2.StoragePlugin, request.param.upper())
    with rosbag2.Writer(path, version=9, storage_plugin=storage) as writer:
        connections = {
            topic: writer.add_connection(topic, kind, typestore=store)
            for topic, kind in (
                ("/camera", "sensor_msgs/msg/Image"),
                ("/odom", "nav_msgs/msg/Odometry"),
                ("/imu", "sensor_msgs/msg/Imu"),
                ("/fix", "sensor_msgs/msg/NavSatFix"),
            )
        }

        def write(topic, nanoseconds, message):
            data = store.serialize_cdr(message, connections[topic].msgtype)
            writer.write(connections[topic], nanoseconds, data)

        start = 1_700_000_000 * 10**9
        fix = make(
            "sensor_msgs/msg/NavSatFix", header=header(start), latitude=40.7, longitude=-74.0,
            status=make("sensor_msgs/msg/NavSatStatus", status=0, service=1), altitude=5.0,
            position_covariance=np.diag([16.0, 16.0, 100.0]).ravel(), position_covariance_type=2,
        )  # fmt: skip
        write("/fix", start, fix)
        for k in range(10):
            at = start + k * 50_000_000
            point = make("geometry_msgs/msg/Point", x=0.0, y=0.0, z=0.0)
            pose = make(
                "geometry_msgs/msg/PoseWithCovariance", covariance=np.zeros(36),
                pose=make("geometry_msgs/msg/Pose", position=point, orientation=upright),
            )  # fmt: skip
            twist = make(
                "geometry_msgs/msg/TwistWithCovariance", covariance=np.zeros(36),
                twist=make("geometry_msgs/msg/Twist", linear=vector(x=float(k)), angular=vector()),
            )  # fmt: skip
            odometry = make(
                "nav_msgs/msg/Odometry", header=header(at), child_frame_id="base", pose=pose,
                twist=twist,
            )  # fmt: skip
            write("/odom", at, odometry)
            imu = make(
                "sensor_msgs/msg/Imu", header=header(at), orientation=upright,
                orientation_covariance=np.zeros(9), angular_velocity=vector(z=math.radians(10.0)),
                angular_velocity_covariance=np.zeros(9), linear_acceleration=vector(),
                linear_acceleration_covariance=np.zeros(9),
            )  # fmt: skip
            write("/imu", at, imu)
            if k % 2:
                image = make(
                    "sensor_msgs/msg/Image", header=header(at), height=16, width=32,
                    encoding="bgr8" if k < 9 else "bayer_rggb8", is_bigendian=0, step=96,
                    data=pixels.ravel(),
                )  # fmt: skip
                write("/camera", at + 1, image)
    return path


def test_a_bag_that_rosbags_wrote_is_read_back(bag):
    drive = open_drive(bag, PANORAMAS)
    frames = list(drive)
    assert len(drive) == len(frames) == 5
    np.testing.assert_allclose(np.diff([frame.time_s for frame in frames]), 0.1, atol=1e-6)
    assert [frame.odometry.speed_mps for frame in frames] == [0.5, 2.5, 4.5, 6.5, 8.5]
    # An IMU turns counter-clockwise where z grows; headings grow clockwise.
    assert frames[1].odometry.yaw_rate_dps == pytest.approx(-10.0)
    assert (frames[0].fix.lat, frames[0].fix.lon) == (40.7, -74.0)
    assert frames[0].fix.accuracy_m == pytest.approx(4.0)
    assert frames[1].fix is None
    assert np.asarray(frames[0].image)[0, 0].tolist() == [200, 0, 0]
    assert frames[4].image is None
    assert "bayer_rggb8" in frames[4].note


def test_a_topic_that_is_not_there_is_named(bag):
    with pytest.raises(DatasetError, match=r"has no topic /rear of .*; it has /camera"):
        open_drive(bag, PANORAMAS, image_topic="/rear")


def test_a_bag_s_topics_go_with_bags_alone(table):
    with pytest.raises(DatasetError, match="is no bag, so that it has no topics"):
        open_drive(table("0,0.jpg,1,0,,,,"), PANORAMAS, image_topic="/camera")
