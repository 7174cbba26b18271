"""Generated drives: motion is a car's, tables say what the pictures show."""

import csv

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("trimesh")
pytest.importorskip("rasterio")

from slicemask.errors import SynthError
from slicemask.synth import generate_drive
from slicemask.synth.formats.drive import DriveSpec, plan_drives
from slicemask.synth.layout.sensors import measure_fixes, measure_odometry

SMALL = {"seconds": 1.0, "rate_hz": 2.0, "seed": 3, "panorama_size": (64, 32), "tile_size": 32}


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    root = tmp_path_factory.mktemp("drives") / "city"
    generate_drive(root, drives=2, jobs=1, **SMALL)
    return root


@pytest.fixture(scope="module")
def motions():
    return plan_drives(DriveSpec(7, 3, 60.0, 10.0, (64, 32), 32)).motions


def test_tables_pictures_and_the_map_are_there(drives):
    rows = list(csv.DictReader((drives / "drive_01.csv").open()))
    assert [row["time_s"] for row in rows] == ["0.000", "0.500"]
    assert [row["gnss_lat"] == "" for row in rows] == [False, True]  # a fix a second
    with Image.open(drives / rows[1]["ground"]) as image:
        assert image.size == (64, 32)
    assert (drives / "map.tif").exists()
    assert not (drives / ".map").exists()
    # Done again, nothing is rendered, and another drive needs another folder.
    assert generate_drive(drives, drives=2, jobs=1, **SMALL).rendered == 0
    with pytest.raises(SynthError, match="holds another generated data set"):
        generate_drive(drives, drives=1, jobs=1, **SMALL)


def test_cars_turn_stop_and_go_smoothly_along_their_way(motions):
    stops = 0
    for motion in motions:
        step = np.diff(motion.places, axis=0)
        way_m = np.hypot(*step.T)
        assert way_m.sum() > 150
        mean = (motion.speeds_mps[1:] + motion.speeds_mps[:-1]) / 2
        np.testing.assert_allclose(way_m * 10, mean, atol=0.1)
        moving = way_m > 0.3
        along_deg = np.degrees(np.arctan2(*step[moving].T))
        off = (along_deg - motion.headings_deg[1:][moving] + 180) % 360 - 180
        assert np.abs(off).max() < 6.0  # the chord against its end
        turned = (np.diff(motion.headings_deg) + 180) % 360 - 180
        yaw = (motion.yaw_rates_dps[1:] + motion.yaw_rates_dps[:-1]) / 2
        np.testing.assert_allclose(turned * 10, yaw, atol=2.0)
        assert np.abs(turned).sum() > 90  # it turns
        assert np.abs(np.diff(motion.speeds_mps)).max() < 0.35  # it neither jumps nor brakes hard
        stops += (motion.speeds_mps == 0).any()
    assert stops


def test_odometry_drifts_and_fixes_are_off_as_they_say(motions):
    drifts, errors = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        speed, yaw = measure_odometry(motions[0], rng)
        drifts.append((speed.sum() / motions[0].speeds_mps.sum() - 1, np.mean(yaw) * 60))
        errors.append(measure_fixes(motions[0], rng) - motions[0].places)
        assert (speed[motions[0].speeds_mps == 0] == 0).all()
    assert 0.005 < np.std([scale for scale, _ in drifts]) < 0.03
    assert 2.0 < np.std(errors) < 6.0
    smooth = np.diff(errors[0], axis=0).std() / np.std(errors[0])
    assert smooth < 0.3  # errors last


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"drives": 0}, "drives is 0; it must be at least 1"),
        ({"seconds": 0.0}, "seconds is 0; it must be 1 to 3600"),
        ({"rate_hz": float("nan")}, "rate_hz is nan; it must be 0.1 to 100"),
        ({"panorama_size": (64, 64)}, "it must be twice as wide as high"),
        ({"seconds": 3600.0}, "have no way that is as long"),
    ],
)
def test_what_cannot_be_is_refused_and_nothing_is_written(options, said, tmp_path, monkeypatch):
    monkeypatch.setattr("slicemask.synth.formats.drive.ROUTES", 1)
    monkeypatch.setattr("slicemask.synth.layout.routes.TRIES", 5)
    with pytest.raises(SynthError, match=said):
        generate_drive(tmp_path / "city", **{**SMALL, **options})
    assert not (tmp_path / "city").exists()
