"""Files of a track, read back by what others read them with."""

import csv
import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from slicematch.localization.geodesy import offset_position
from slicematch.tracking.outputs import Track, check_track_target, write_track
from slicematch.tracking.track_estimate import TrackEstimate, TrackMode

from slicemask.errors import OutputError

ORIGIN = 40.7, -74.0
# What the command evo_ape runs.
EVO_APE = "from evo.cli.entry_points import ape; ape()"


def make_track(count=20):
    """A quarter circle to the right at 20 m, east of north, at 10 Hz."""
    estimates = []
    for k in range(count):
        turn = np.radians(90.0 * k / count)
        east_m, north_m = 20 * (1 - np.cos(turn)), 20 * np.sin(turn)
        covariance = np.diag([4.0, 1.0, 9.0])
        lat, lon = offset_position(ORIGIN, east_m, north_m)
        mode = TrackMode(
            lat, lon, float(np.degrees(turn)), covariance, 0.9, float(east_m), float(north_m)
        )
        estimates.append(TrackEstimate(k / 10, (mode,), True, ("the image is missing",)))
    return Track([1_000_000.0 + k / 10 for k in range(count)], estimates, ORIGIN)


@pytest.fixture(scope="module")
def track():
    return make_track()


def test_an_estimate_is_sure_or_not_and_shows_what_is_notable():
    mode = make_track(1).estimates[0].modes[0]
    modes = tuple(replace(mode, probability=share) for share in (0.7, 0.2, 0.02, 0.01))
    doubt = TrackEstimate(0.0, modes, True)
    assert not doubt.sure
    assert doubt.notable == modes[:3]
    assert TrackEstimate(0.0, (mode,), True).sure
    lost = TrackEstimate(0.0, (replace(mode, probability=0.001),), True)
    assert lost.notable == lost.modes  # the answer is always shown


def test_tum_is_a_pose_a_line(track, tmp_path):
    write_track(track, tmp_path / "a.tum")
    lines = np.loadtxt(tmp_path / "a.tum")
    assert lines.shape == (20, 8)
    np.testing.assert_allclose(lines[:, 0], track.times_s)
    # The body's x axis looks where the car drives.
    x, y, z, w = lines[:, 4:].T
    ahead = np.stack([1 - 2 * (y**2 + z**2), 2 * (x * y + z * w)], axis=1)
    driven = np.gradient(lines[:, 1:3], axis=0)
    driven /= np.hypot(*driven.T)[:, None]
    assert (np.sum(ahead * driven, axis=1) > 0.999).all()


def test_kitti_is_a_rigid_matrix_a_line(track, tmp_path):
    write_track(track, tmp_path / "a.txt")
    matrices = np.loadtxt(tmp_path / "a.txt").reshape(-1, 3, 4)
    rotation = matrices[..., :3]
    np.testing.assert_allclose(
        rotation @ rotation.swapaxes(1, 2), np.tile(np.eye(3), (20, 1, 1)), atol=1e-5
    )
    assert np.linalg.det(rotation[7]) == pytest.approx(1.0, abs=1e-5)
    driven = np.gradient(matrices[:, [0, 2], 3], axis=0)
    driven /= np.hypot(*driven.T)[:, None]
    assert (np.sum(rotation[:, [0, 2], 2] * driven, axis=1) > 0.999).all()  # z looks ahead


def test_evo_finds_no_error_between_two_files_of_one_track(track, tmp_path):
    pytest.importorskip("evo")
    write_track(track, tmp_path / "a.tum")
    found = subprocess.run(
        [sys.executable, "-c", EVO_APE, "tum", "a.tum", "a.tum"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
        env={"HOME": str(tmp_path), "PATH": "/usr/bin:/bin"},
    )  # fmt: skip
    assert found.returncode == 0, found.stderr
    (line,) = [line for line in found.stdout.splitlines() if "rmse" in line]
    assert float(line.split()[1]) == pytest.approx(0.0, abs=1e-6)


def test_csv_holds_the_covariance(track, tmp_path):
    write_track(track, tmp_path / "a.csv")
    rows = list(csv.DictReader((tmp_path / "a.csv").open()))
    assert len(rows) == 20
    assert [float(rows[3][f"cov_{name}"]) for name in ("ee", "en", "nn", "hh")] == [4, 0, 1, 9]
    assert rows[3]["notes"] == "the image is missing"
    assert float(rows[3]["ellipse_azimuth_deg"]) == pytest.approx(90.0)


def test_geojson_holds_track_poses_and_ellipses(track, tmp_path):
    write_track(track, tmp_path / "a.geojson")
    features = json.loads((tmp_path / "a.geojson").read_text())["features"]
    kinds = [feature["properties"]["kind"] for feature in features]
    assert {kind: kinds.count(kind) for kind in set(kinds)} == {
        "track": 1,
        "pose": 20,
        "uncertainty": 20,
    }
    assert features[0]["geometry"]["coordinates"][0] == pytest.approx([ORIGIN[1], ORIGIN[0]])


def test_mcap_is_read_back_by_rosbags(track, tmp_path):
    pytest.importorskip("mcap")
    highlevel = pytest.importorskip("rosbags.highlevel")
    from rosbags.typesys import Stores, get_typestore

    write_track(track, tmp_path / "a.mcap")
    store = get_typestore(Stores.ROS2_HUMBLE)
    with highlevel.AnyReader([tmp_path / "a.mcap"], default_typestore=store) as reader:
        found = {
            connection.topic: reader.deserialize(raw, connection.msgtype)
            for connection, _, raw in reader.messages()
        }
    pose, fix = found["/slicemask/pose"], found["/slicemask/fix"]
    last = track.estimates[-1].modes[0]
    assert pose.pose.pose.position.x == pytest.approx(last.east_m)
    covariance = pose.pose.covariance.reshape(6, 6)
    assert covariance[0, 0] == 4.0
    assert covariance[5, 5] == pytest.approx(np.radians(3.0) ** 2)
    assert (fix.latitude, fix.longitude) == pytest.approx((last.lat, last.lon))
    assert pose.header.stamp.sec == 1_000_001


@pytest.mark.parametrize("name", ["a.bag", "a", "missing/a.tum"])
def test_files_of_other_kinds_are_refused(name, tmp_path):
    with pytest.raises(OutputError, match=r"suffix|folder"):
        check_track_target(tmp_path / name)
