"""KITTI as cut by LM: the closed form, the image operations, and the files around them."""

import numpy as np
import pytest
import torch
from PIL import Image
from slicematch.data.dataset import PoseDataset
from slicematch.data.errors import DatasetError, SampleError
from slicematch.data.images import denormalise
from slicematch.data.kitti import (
    METRES_PER_PIXEL,
    SPAN_M,
    KittiConfig,
    camera_pose,
    cut_tile,
    read_calibration,
)

SMALL = {"ground_size": (32, 64), "aerial_size": 64, "validation_fraction": 0.0}
# What editors and other programs make of a text of lines.
WRITINGS = {
    "blank lines": lambda text: ("\n\n" + text.replace("\n", "\n\n")).encode(),
    "lines of a space": lambda text: (" \n" + text.replace("\n", "\n \n")).encode(),
    "byte-order mark": lambda text: text.encode("utf-8-sig"),
    "byte-order mark on a line of its own": lambda text: ("\ufeff\n" + text).encode(),
    "CRLF": lambda text: text.replace("\n", "\r\n").encode(),
    "tabs": lambda text: text.replace(" ", "\t").encode(),
    "spaces at both ends": lambda text: ("  " + text.replace("\n", " \n  ")).encode(),
}
DRIVE = "2011_09_26/2011_09_26_drive_0001_sync"


def open_kitti(root, part="train", **settings):
    return PoseDataset(KittiConfig(root=root, **{**SMALL, **settings}), part)


def test_the_crop_spans_100_26_metres():
    assert pytest.approx(0.19583, abs=5e-6) == METRES_PER_PIXEL
    assert pytest.approx(100.26, abs=0.005) == SPAN_M


@pytest.mark.parametrize(
    ("shift_m", "rotation_deg", "right_m", "up_m", "heading_deg"),
    [
        ((0, 0), 0, 0, 0, 90),
        ((20, 0), 0, 20, 0, 90),
        ((0, 20), 0, 0, 20, 90),
        ((20, 0), 90, 0, 20, 0),
        ((0, 20), 90, -20, 0, 0),
        ((20, 10), 180, -20, -10, 270),
        ((20, 10), -90, 10, -20, 180),
        ((0, 0), 10, 0, 0, 80),
        ((0, 0), 100, 0, 0, 350),
        ((0, 0), 90.00000000000001, 0, 0, 0),  # -1e-14 % 360 rounds to 360 itself
    ],
)
def test_the_closed_form(shift_m, rotation_deg, right_m, up_m, heading_deg):
    pose = camera_pose(np.array(shift_m, dtype=float), rotation_deg)
    expected = [0.5 + right_m / SPAN_M, 0.5 - up_m / SPAN_M, heading_deg]
    assert pose == pytest.approx(expected, abs=1e-12)
    assert 0 <= pose[2] < 360


def cut_step_by_step(tile, heading, sx, sy, rotation_deg):
    """LM's image operations one after the other; sx and sy are those of a test line."""
    tile = tile.rotate(-np.degrees(heading), resample=Image.Resampling.BILINEAR)
    ahead, right = 1.08 / METRES_PER_PIXEL, 0.26 / METRES_PER_PIXEL
    shift_x, shift_y = (-s * 20 / METRES_PER_PIXEL for s in (sx, sy))  # negated on load
    for x, y in ((ahead, right), (shift_x, -shift_y)):
        tile = tile.transform(
            tile.size, Image.Transform.AFFINE, (1, 0, x, 0, 1, y), Image.Resampling.BILINEAR
        )
    tile = tile.rotate(rotation_deg, resample=Image.Resampling.BILINEAR)
    left = (tile.width - 512) // 2
    return tile.crop((left, left, left + 512, left + 512))


def random_cuts(count=6):
    rng = np.random.default_rng(5)
    return [
        (rng.uniform(-np.pi, np.pi), *rng.uniform(-1, 1, 2), rng.uniform(-180, 180))
        for _ in range(count)
    ]


@pytest.mark.parametrize(("heading", "sx", "sy", "rotation_deg"), random_cuts())
def test_one_resampling_cuts_what_lm_cuts_in_five(paint_texture, heading, sx, sy, rotation_deg):
    tile = Image.fromarray(paint_texture(np.random.default_rng(0), 1280, blocks=40))
    once = cut_tile(tile, heading, 20 * np.array([sx, sy]), rotation_deg)
    steps = cut_step_by_step(tile, heading, sx, sy, rotation_deg)

    def mismatch(image, other):
        # Each resampling rounds down: five of them are darker by a grey level or two throughout.
        difference = np.asarray(image, dtype=float) - other
        return np.abs(difference - difference.mean()).mean()

    assert mismatch(once, steps) < 1
    one_pixel_off = np.roll(np.asarray(steps), 1, axis=1)
    assert mismatch(once, one_pixel_off) > 2.5


def paint_spot(pixels, east_m, north_m):
    """White, with a black Gaussian spot some metres from the middle of the tile."""
    y, x = np.mgrid[:pixels, :pixels] + 0.5
    x0, y0 = pixels / 2 + east_m / METRES_PER_PIXEL, pixels / 2 - north_m / METRES_PER_PIXEL
    spot = 255 * np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / 2 / 4.0**2)
    return Image.fromarray(np.rint(spot)[..., None].repeat(3, 2).astype(np.uint8))


def find_spot(image):
    shown = np.asarray(image, dtype=float)[..., 0]
    at = (np.arange(len(shown)) + 0.5) / len(shown)
    return shown.sum(axis=0) @ at / shown.sum(), shown.sum(axis=1) @ at / shown.sum()


@pytest.mark.parametrize(("heading", "sx", "sy", "rotation_deg"), random_cuts())
def test_a_landmark_at_the_camera_lies_at_the_stated_pose(heading, sx, sy, rotation_deg):
    """And one 15 m ahead of the camera lies 15 m along the stated heading."""
    shift = 20 * np.array([sx, sy])
    u, v, heading_deg = camera_pose(shift, rotation_deg)
    # The camera stands 1.08 m ahead of the GPS unit and 0.26 m to its right.
    camera = np.array(
        [
            1.08 * np.cos(heading) + 0.26 * np.sin(heading),
            1.08 * np.sin(heading) - 0.26 * np.cos(heading),
        ]
    )
    ahead = camera + 15 * np.array([np.cos(heading), np.sin(heading)])
    tolerance = 0.1 / 512  # a tenth of a pixel
    at_camera = cut_tile(paint_spot(1280, *camera), heading, shift, rotation_deg)
    assert find_spot(at_camera) == pytest.approx((u, v), abs=tolerance)
    angle = np.radians(heading_deg)
    expected = u + 15 / SPAN_M * np.sin(angle), v - 15 / SPAN_M * np.cos(angle)
    at_ahead = cut_tile(paint_spot(1280, *ahead), heading, shift, rotation_deg)
    assert find_spot(at_ahead) == pytest.approx(expected, abs=tolerance)


@pytest.mark.parametrize("augment", [False, True])
@pytest.mark.parametrize("part", ["train", "test"])
def test_the_ground_image_is_what_the_crop_shows_from_the_pose(
    make_kitti_tree, tmp_path, sample_view, true_colours, part, augment
):
    tree = make_kitti_tree(tmp_path, pairs=3)
    dataset = open_kitti(tmp_path, part, aerial_size=512, ground_size=(64, 128), augment=augment)
    left, right = np.tan(np.radians(tree.edges_deg))
    azimuth_deg = np.degrees(np.arctan(left + (right - left) * (np.arange(128) + 0.5) / 128))
    ranges = 40.0 / SPAN_M * (1 - (np.arange(64) + 0.5) / 64)
    assert (dataset.left_deg, dataset.left_deg + dataset.hfov_deg) == pytest.approx(tree.edges_deg)
    for index in range(3):
        sample = dataset[index]
        u, v, heading_deg = sample["pose"].numpy()
        tile, ground = denormalise(sample["aerial"]), denormalise(sample["ground"]).astype(int)
        seen = sample_view(tile, (u, v), heading_deg + azimuth_deg, ranges)
        # Where rays leave the crop, the tree painted what lies further out in the tile.
        # So it does where a mirrored image has no more columns, which are grey.
        inside = ~np.all(seen == 128, axis=2) & ~(sample["ground"] == 0).all(dim=0).numpy()
        assert inside.mean() > 0.4
        assert np.abs(seen - ground)[inside].mean() < 8
        wrong = sample_view(tile, (u, v), heading_deg + 5 + azimuth_deg, ranges)
        assert np.abs(wrong - ground)[inside].mean() > 10


def test_the_paper_s_sizes_are_the_defaults(make_kitti_tree, tmp_path):
    make_kitti_tree(tmp_path, pairs=1)
    dataset = PoseDataset(KittiConfig(root=tmp_path), "test")
    sample = dataset[0]
    assert sample["ground"].shape == (3, 256, 1024)
    assert sample["aerial"].shape == (3, 512, 512)
    assert sample["metres_per_pixel"] == pytest.approx(METRES_PER_PIXEL, rel=1e-12)
    assert dataset.config.projection == "pinhole"
    assert open_kitti(tmp_path)[0]["metres_per_pixel"] == pytest.approx(8 * METRES_PER_PIXEL)


@pytest.mark.parametrize(("prior", "reach"), [(10, 10), (0, 0), (None, 180), (180, 180)])
def test_test_poses_follow_their_file(make_kitti_tree, tmp_path, prior, reach):
    tree = make_kitti_tree(tmp_path, pairs=3, tile_pixels=8, ground_size=(5, 16))
    dataset = open_kitti(tmp_path, "test", heading_half_width_deg=prior)
    assert dataset.heading_prior == (None if reach == 180 else (90.0, float(prior)))
    for index, (sx, sy, theta) in enumerate(tree.tests):
        t = np.radians(theta * reach)
        right = 20 * (sx * np.cos(t) - sy * np.sin(t))
        up = 20 * (sx * np.sin(t) + sy * np.cos(t))
        expected = [0.5 + right / SPAN_M, 0.5 - up / SPAN_M, (90 - theta * reach) % 360]
        assert dataset.pose(index).tolist() == pytest.approx(expected, abs=1e-12)
    dataset.set_epoch(7)
    assert dataset.pose(2).tolist() == pytest.approx(expected, abs=1e-12)


def test_both_test_files_can_be_chosen(make_kitti_tree, tmp_path):
    tree = make_kitti_tree(tmp_path, pairs=2)
    (tmp_path / "test2_files.txt").write_text(f"{tree.frames[1]} 1 -0.5 0")
    assert open_kitti(tmp_path, "test").names == tree.frames
    cross = open_kitti(tmp_path, "test", split="cross-area", heading_half_width_deg=10)
    assert cross.names == [tree.frames[1]]
    assert cross.poses().tolist() == [[0.5 + 20 / SPAN_M, 0.5 + 10 / SPAN_M, 90.0]]
    with pytest.raises(DatasetError, match="split is 'test3'; it must be one of same-area"):
        open_kitti(tmp_path, "test", split="test3")


def test_split_files_may_lie_elsewhere(make_kitti_tree, tmp_path):
    make_kitti_tree(tmp_path / "data", pairs=2)
    (tmp_path / "lists").mkdir()
    (tmp_path / "data" / "train_files.txt").rename(tmp_path / "lists" / "train_files.txt")
    assert len(open_kitti(tmp_path / "data", split_dir=tmp_path / "lists")) == 2
    with pytest.raises(
        DatasetError, match=r"train_files\.txt: the split file is missing; .* split_dir"
    ):
        open_kitti(tmp_path / "data")


def test_training_draws_shift_and_turn_anew(make_kitti_tree, tmp_path):
    make_kitti_tree(tmp_path, pairs=8, tile_pixels=8, ground_size=(5, 16))
    dataset = open_kitti(tmp_path, heading_half_width_deg=10)
    poses = []
    for epoch in range(20):
        dataset.set_epoch(epoch)
        poses.append(dataset.poses())
    again = open_kitti(tmp_path, heading_half_width_deg=10)
    again.set_epoch(19)
    assert np.array_equal(again.poses(), poses[19])
    u, v, heading_deg = np.concatenate(poses).T
    assert len(np.unique(u)) == 160
    # Undo the turn: along and across the heading, up to 20 m.
    t = np.radians(90 - heading_deg)
    right, up = (u - 0.5) * SPAN_M, (0.5 - v) * SPAN_M
    along = right * np.cos(t) + up * np.sin(t)
    across = up * np.cos(t) - right * np.sin(t)
    for drawn, reach in ((along, 20), (across, 20), (heading_deg - 90, 10)):
        assert -reach <= drawn.min() < -0.9 * reach
        assert 0.9 * reach < drawn.max() <= reach


def test_validation_is_drawn_once(make_kitti_tree, tmp_path):
    tree = make_kitti_tree(tmp_path, pairs=8, tile_pixels=8, ground_size=(5, 16))
    validation = open_kitti(tmp_path, "validation", validation_fraction=0.25)
    train = open_kitti(tmp_path, "train", validation_fraction=0.25)
    assert sorted(validation.names + train.names) == tree.frames
    before = validation.poses()
    validation.set_epoch(3)
    assert np.array_equal(validation.poses(), before)


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("test1_files.txt", f"{DRIVE}/0000000001.png 0.1 0.2"),
        ("test1_files.txt", f"{DRIVE}/0000000001.png"),
        ("test1_files.txt", f"{DRIVE}/0000000001.png 0.1 0.2 1.5"),
        ("test1_files.txt", f"{DRIVE}/0000000001.png 0.1 nan 0.5"),
        ("test1_files.txt", f"{DRIVE}/0000000001.png 0.1 left 0.5"),
        ("train_files.txt", f"{DRIVE}/0000000001.png 0.1 0.2 0.5"),
        ("train_files.txt", "0000000001.png"),
        ("train_files.txt", f"{DRIVE}/0000000001.txt"),
    ],
)
def test_a_line_that_is_no_sample_is_named(make_kitti_tree, tmp_path, name, line):
    make_kitti_tree(tmp_path, pairs=1)
    text = (tmp_path / name).read_text()
    (tmp_path / name).write_text(text + line + "\n")
    with pytest.raises(DatasetError, match=rf"{name}, line 2: is no sample, since "):
        open_kitti(tmp_path, name.split("_")[0].rstrip("1"))


def write_calib(root, date, text):
    path = root / "raw_data" / date / "calib_cam_to_cam.txt"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def test_field_of_view_of_the_calibration_file(tmp_path):
    """The five days of KITTI: widths and focal lengths differ, the field of view hardly does."""
    for width, focal, hfov_deg in (
        (1242, 721.5377, 81.44),
        (1224, 707.0493, 81.76),
        (1238, 718.3351, 81.50),
        (1226, 707.0912, 81.85),
        (1241, 718.8560, 81.60),
    ):
        text = f"S_rect_02: {width}e+00 370\nP_rect_02: {focal:e} 0 609 44 0 721 172 0.2 0 0 1 0\n"
        frustum, horizon = read_calibration(write_calib(tmp_path, "day", text))
        assert frustum.hfov_deg == pytest.approx(hfov_deg, abs=0.02)
        assert frustum.principal_point == pytest.approx(609 / width)
        assert horizon == pytest.approx(172 / 370)
    text = "P_rect_02: 721.5377 0 621 0 0 721.5377 172.854 0 0 0 1 0\n"
    frustum, horizon = read_calibration(write_calib(tmp_path, "day", text))
    assert frustum.hfov_deg == pytest.approx(81.44, abs=0.01)
    assert frustum.left_deg is None
    assert horizon == pytest.approx(172.854 / 375)


def test_field_of_view_of_a_tree(make_kitti_tree, tmp_path):
    make_kitti_tree(tmp_path / "without", pairs=1, calib=False)
    plain = open_kitti(tmp_path / "without")
    assert (plain.hfov_deg, plain.left_deg, plain.horizon) == (81.5, None, 0.5)
    tree = make_kitti_tree(tmp_path / "with", pairs=1)
    for day, focal, cx, cy in (("2011_09_29", 700.0, 600, 170), ("2011_09_30", 710.0, 615, 190)):
        write_calib(tree.root, day, f"P_rect_02: {focal} 0 {cx} 0 0 {focal} {cy} 0 0 0 1 0\n")
    # The median of the days, whatever the part.
    left_deg = np.degrees(np.arctan(-600 / 700))
    right_deg = np.degrees(np.arctan((1242 - 615) / 710))
    for part in ("train", "test"):
        dataset = open_kitti(tree.root, part)
        assert dataset.left_deg == pytest.approx(left_deg)
        assert dataset.hfov_deg == pytest.approx(right_deg - left_deg)
        assert dataset.horizon == pytest.approx(172.854 / 375)


def test_a_field_of_view_that_is_given_is_that_of_a_centred_camera(make_kitti_tree, tmp_path):
    """As in runs of before, which knew of no principal point."""
    make_kitti_tree(tmp_path, pairs=1)
    dataset = open_kitti(tmp_path, hfov_deg=81.44)
    assert (dataset.hfov_deg, dataset.left_deg, dataset.horizon) == (81.44, None, 0.5)
    dataset = open_kitti(tmp_path, hfov_deg=81.44, left_deg=-40.2, horizon=0.46)
    assert (dataset.hfov_deg, dataset.left_deg, dataset.horizon) == (81.44, -40.2, 0.46)


def test_elevations_are_those_about_the_principal_point(make_kitti_tree, tmp_path):
    make_kitti_tree(tmp_path, pairs=1, ground_size=(375, 1242))
    (path,) = (file for file in tmp_path.rglob("*.png") if "image_02" in str(file))
    rows = np.arange(375) < 172.854
    Image.fromarray(np.repeat(np.where(rows, 255, 0)[:, None], 1242, 1).astype("u1")).save(path)
    ground = denormalise(open_kitti(tmp_path, elevations=(-10, 10))[0]["ground"])
    assert ground[:15].min() == 255
    assert ground[17:].max() == 0
    # About half the height, the horizon would be at 0.44 of the part that is taken.
    assert ground.mean() / 255 == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("S_rect_02: 1242 375\n", "no focal length and principal point"),
        ("P_rect_02: 700 0 600\n", "no focal length and principal point"),
        ("P_rect_02: 700 0 600 0 0 700 400\n", "row is 400 of 375; expected some 173 of 375"),
        ("P_rect_02: \n", "no focal length"),
        ("P_rect_02: wide\n", "no focal length"),
        ("P_rect_02: nan 0\n", "P_rect_02 is 'nan 0'"),
        (
            "S_rect_02: -5 1\nP_rect_02: 700 0 600 0 0 700 170\n",
            "width is -5.0; .* expected some 720, 610 and 1242",
        ),
        ("", "the calibration file is empty"),
    ],
)
def test_a_broken_calibration_file_is_named(make_kitti_tree, tmp_path, text, message):
    make_kitti_tree(tmp_path, pairs=1)
    path = write_calib(tmp_path, "2011_09_26", text)
    with pytest.raises(DatasetError, match=message) as error:
        open_kitti(tmp_path)
    assert str(path) in str(error.value)


@pytest.mark.parametrize(
    "content", [None, "", "1 2 3 4 5", "1 2 3 4 5 east", "1 2 3 4 5 inf", b"\xff\xfe"]
)
def test_a_broken_oxts_file_is_named(make_kitti_tree, tmp_path, content):
    make_kitti_tree(tmp_path, pairs=1)
    path = tmp_path / "raw_data" / DRIVE / "oxts" / "data" / "0000000000.txt"
    if content is None:
        path.unlink()
    else:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(SampleError) as error:
        open_kitti(tmp_path)[0]
    assert str(path) in str(error.value)


@pytest.mark.parametrize(
    ("folder", "size"),
    [("satmap", (512, 511 - 20)), ("satmap", (400, 400))],
    ids=["not square", "smaller than the crop"],
)
def test_an_oddly_sized_image_is_named(make_kitti_tree, tmp_path, folder, size):
    make_kitti_tree(tmp_path, pairs=1)
    (path,) = (file for file in tmp_path.rglob("*.png") if folder in str(file))
    Image.new("RGB", size).save(path)
    with pytest.raises(SampleError) as error:
        open_kitti(tmp_path)[0]
    assert str(path) in str(error.value)
    assert f"{size[0]}x{size[1]} pixels" in str(error.value)


def test_ground_images_of_any_proportions_are_cut_about_the_horizon_or_resized(
    make_kitti_tree, tmp_path
):
    make_kitti_tree(tmp_path, pairs=1, ground_size=(375, 1242))
    (path,) = (file for file in tmp_path.rglob("*.png") if "image_02" in str(file))
    whole = Image.open(path)
    expected = open_kitti(tmp_path)[0]["ground"]
    # Fewer rows of the same camera, as many of them gone above the horizon as below, in proportion.
    top, bottom = (round(40 * share) for share in (172.854 / 375, 1 - 172.854 / 375))
    whole.crop((0, top, 1242, 375 - bottom)).save(path)
    cut = open_kitti(tmp_path)[0]["ground"]
    assert (denormalise(cut)[[0, -1]] == 0).all()
    assert (cut - expected)[:, 3:-3].abs().mean() < 0.1
    resized = open_kitti(tmp_path, ground_fit="resize")[0]["ground"]
    assert (denormalise(resized)[[0, -1]] > 0).any()
    assert (resized - expected)[:, 3:-3].abs().mean() > 0.1
    # More rows than the run takes.
    taller = Image.new("RGB", (1242, 475))
    taller.paste(whole, (0, round(100 * 172.854 / 375)))
    taller.save(path)
    assert (open_kitti(tmp_path)[0]["ground"] - expected).abs().mean() < 0.1


@pytest.mark.parametrize("write", WRITINGS.values(), ids=WRITINGS)
def test_text_files_as_editors_write_them(make_kitti_tree, tmp_path, write):
    """Splits, oxts and calibration."""
    make_kitti_tree(tmp_path, pairs=2)
    parts = ("train", "test")
    before = [open_kitti(tmp_path, part) for part in parts]
    samples = [dataset[1] for dataset in before]
    texts = [path for path in tmp_path.rglob("*.txt") if path.stat().st_size]
    assert {path.parent.name for path in texts} == {tmp_path.name, "data", "2011_09_26"}
    for path in texts:
        path.write_bytes(write(path.read_text()))
    for part, old, sample in zip(parts, before, samples, strict=True):
        new = open_kitti(tmp_path, part)
        assert (new.names, new.hfov_deg) == (old.names, old.hfov_deg)
        assert np.array_equal(new.poses(), old.poses())
        assert all(torch.equal(new[1][key], sample[key]) for key in ("ground", "aerial"))
