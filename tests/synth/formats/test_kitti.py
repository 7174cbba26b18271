"""Generated drives in KITTI's format: the files, and that LM's crop shows what the camera sees."""

import re
import shutil

import numpy as np
import pytest
from PIL import Image
from slicematch.data.dataset import PoseDataset
from slicematch.data.kitti import (
    METRES_PER_PIXEL,
    KittiConfig,
    cut_tile,
    read_calibration,
    read_heading,
)

from slicemask.errors import SynthError
from slicemask.synth import generate_kitti
from slicemask.synth.formats import kitti


def frames(root, name):
    return [line.split() for line in (root / f"{name}_files.txt").read_text().splitlines()]


def plans(options):
    return [
        kitti.plan_drives(
            kitti.KittiSpec(
                options["seed"], area, counts, options["image_size"], options["tile_size"]
            )
        )
        for area, counts in enumerate(kitti.count_frames(options["frames"]))
    ]


def test_files_are_where_kitti_has_them(kitti_tree):
    splits = {name: frames(kitti_tree, name) for name in ("train", "test1", "test2")}
    assert {name: len(lines) for name, lines in splits.items()} == {
        "train": 3, "test1": 1, "test2": 1
    }  # fmt: skip
    for name, lines in splits.items():
        for path, *draws in lines:
            assert re.fullmatch(r"(\d{4}_\d\d_\d\d)/\1_drive_\d{4}_sync/\d{10}\.png", path)
            assert len(draws) == (0 if name == "train" else 3)
            assert all(abs(float(draw)) <= 1 for draw in draws)
            drive, frame = path.rsplit("/", 1)
            with Image.open(kitti_tree / "raw_data" / drive / "image_02/data" / frame) as image:
                assert image.size == (414, 125)
            with Image.open(kitti_tree / "satmap" / path) as tile:
                assert tile.size == (640, 640)
            oxts = kitti_tree / "raw_data" / drive / "oxts/data" / frame.replace("png", "txt")
            fields = [float(field) for field in oxts.read_text().split()]
            assert len(fields) == 30
            assert -np.pi <= fields[5] <= np.pi
            assert fields[0] == pytest.approx(49.015, abs=0.01)
    dates = [{line[0][:10] for line in splits[name]} for name in ("train", "test1", "test2")]
    assert dates == [{"2011_09_26"}, {"2011_09_26"}, {"2011_09_28"}]


def test_calibration_gives_the_cameras_field_of_view(kitti_tree):
    path = kitti_tree / "raw_data" / "2011_09_26" / "calib_cam_to_cam.txt"
    frustum, horizon = read_calibration(path)
    assert frustum.hfov_deg == pytest.approx(2 * np.degrees(np.arctan(621 / 721.5377)))
    assert frustum.left_deg is None
    assert horizon == pytest.approx(kitti.HORIZON_ROW / 375, abs=1e-5)


@pytest.mark.parametrize(("split", "test"), [("same-area", "test1"), ("cross-area", "test2")])
def test_loader_reads_the_tree(kitti_tree, split, test):
    config = KittiConfig(root=kitti_tree, split=split, heading_half_width_deg=10.0)
    dataset = PoseDataset(config, "test")
    sample = dataset[0]
    assert sample["ground"].shape == (3, 256, 1024)
    assert sample["aerial"].shape == (3, 512, 512)
    _, sx, sy, theta = (float(x) if "/" not in x else x for x in frames(kitti_tree, test)[0])
    turn = np.radians(10 * theta)
    right = 20 * (sx * np.cos(turn) - sy * np.sin(turn))
    up = 20 * (sx * np.sin(turn) + sy * np.cos(turn))
    span_m = 512 * METRES_PER_PIXEL
    expected = [0.5 + right / span_m, 0.5 - up / span_m, 90 - 10 * theta]
    assert np.asarray(sample["pose"]) == pytest.approx(expected, abs=1e-9)


def test_camera_stands_where_the_loader_expects_it(kitti_tree, kitti_options):
    """Ahead and to the right of the GPS unit, which is the tile's centre."""
    for plan in plans(kitti_options):
        for frame, gps, place, heading_deg in zip(
            plan.frames, plan.gps, plan.places, plan.headings_deg, strict=True
        ):
            drive, name = frame.rsplit("/", 1)
            oxts = kitti_tree / "raw_data" / drive / "oxts/data" / name.replace("png", "txt")
            yaw = read_heading(oxts)
            assert np.cos(yaw) == pytest.approx(np.sin(np.radians(heading_deg)), abs=1e-9)
            assert np.sin(yaw) == pytest.approx(np.cos(np.radians(heading_deg)), abs=1e-9)
            ahead = np.array([np.cos(yaw), np.sin(yaw)])
            right = np.array([np.sin(yaw), -np.cos(yaw)])
            assert (place - gps) @ ahead == pytest.approx(1.08)
            assert (place - gps) @ right == pytest.approx(0.26)
            # Tiles of a drive are cut out of one picture.
            assert gps / kitti.METRES_PER_PIXEL == pytest.approx(
                np.rint(gps / kitti.METRES_PER_PIXEL), abs=1e-6
            )


def test_crop_shows_the_road_that_the_camera_sees(kitti_tree, kitti_options):
    """With no shift and turn the crop's centre is the camera and east is ahead."""
    agree = []
    for plan in plans(kitti_options):
        for frame in plan.frames:
            drive, name = frame.rsplit("/", 1)
            raw = kitti_tree / "raw_data" / drive
            yaw = read_heading(raw / "oxts/data" / name.replace("png", "txt"))
            ground = np.asarray(Image.open(raw / "image_02/data" / name).convert("L"), dtype=float)
            crop = cut_tile(Image.open(kitti_tree / "satmap" / frame), yaw, np.zeros(2), 0.0)
            above = np.asarray(crop.convert("L"), dtype=float)
            column, row = np.meshgrid(np.arange(414) + 0.5, np.arange(72, 125) + 0.5)
            depth = 1.65 * 240.51 / (row - 57.62) / METRES_PER_PIXEL
            aside = depth * (column - 207) / 240.51
            scores = []
            for degrees in (0, 90, 180, 270):
                cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
                x, y = 256 + depth * cos - aside * sin, 256 + depth * sin + aside * cos
                scores.append(
                    np.corrcoef(
                        above[y.astype(int).clip(0, 511), x.astype(int).clip(0, 511)].ravel(),
                        ground[72:125].ravel(),
                    )[0, 1]
                )
            agree.append(scores)
    means = np.nanmean(agree, axis=0)
    assert means.argmax() == 0
    assert means[0] > 0.3


def test_goes_on_where_it_stopped(kitti_tree, kitti_options, tmp_path):
    root = tmp_path / "drive"
    shutil.copytree(kitti_tree, root)
    lost = [next((root / part).rglob("*.png")) for part in ("satmap", "raw_data")]
    for path in lost:
        path.unlink()
    assert generate_kitti(root, jobs=1, **kitti_options).rendered == 2
    for path in lost:
        assert path.read_bytes() == (kitti_tree / path.relative_to(root)).read_bytes()


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"frames": 2}, "frames is 2; it must be at least 3"),
        ({"tile_size": 100}, "tile_size is 100; it must be at least 512"),
        ({"image_size": (400, 400)}, "image_size is 400x400; it must have the proportions"),
    ],
)
def test_wrong_options_are_one_sentence(kitti_options, tmp_path, wrong, sentence):
    with pytest.raises(SynthError, match=re.escape(sentence)):
        generate_kitti(tmp_path / "drive", **{**kitti_options, **wrong})
