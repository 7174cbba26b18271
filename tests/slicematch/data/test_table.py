"""The data set of a table: samples, what they are cut from, and rows that cannot be used."""

import math

import numpy as np
import pytest
from PIL import Image
from slicematch.data.cameras import Camera
from slicematch.data.dataset import BadSampleLog, PoseDataset
from slicematch.data.errors import DatasetError, SampleError
from slicematch.data.images import denormalise
from slicematch.data.table import TableConfig
from slicematch.data.table_files import write_table
from slicematch.data.views import level_pinhole
from slicematch.data.vigor import VigorConfig
from slicematch.localization.geodesy import offset_position

SIZES = {"ground_size": (32, 64), "aerial_size": 64, "validation_fraction": 0.0}
METRES_PER_PIXEL = 0.111262 * 8  # of Chicago's tiles, 80 pixels wide
SIDE_M = 80 * METRES_PER_PIXEL


def rows_of(tree):
    """The pairs of a VIGOR tree as rows of a table."""
    return [
        {
            "id": f"Chicago/{panorama}",
            "ground": f"Chicago/panorama/{panorama}",
            "tile": f"Chicago/satellite/{tile}",
            "u": 0.5 - d1 / 640,
            "v": 0.5 + d0 / 640,
            "heading_deg": 0.0,
            "metres_per_pixel": METRES_PER_PIXEL,
        }
        for panorama, tile, d0, d1 in tree.labels["Chicago"]
    ]


def write_rows(path, rows):
    names = list(dict.fromkeys(name for row in rows for name in row))
    write_table(path, {name: [row.get(name) for row in rows] for name in names})
    return path


@pytest.fixture
def pairs(vigor):
    return rows_of(vigor)


@pytest.fixture
def table(vigor, tmp_path):
    """The function that writes rows beside a VIGOR tree's files, and gives the settings."""

    def write(rows, **settings):
        for row in rows:
            for name in ("ground", "tile"):
                if row.get(name):
                    row[name] = str(vigor.root / row[name])
        return TableConfig(root=write_rows(tmp_path / "photos.csv", rows), **SIZES | settings)

    return write


@pytest.mark.parametrize("prior", [None, 0, 20])
@pytest.mark.parametrize("part", ["train", "test"])
def test_a_table_of_vigor_s_pairs_gives_vigor_s_samples(table, pairs, vigor, part, prior):
    settings = {**SIZES, "heading_half_width_deg": prior}
    own = PoseDataset(table(pairs, heading_half_width_deg=prior), part)
    ours = PoseDataset(VigorConfig(root=vigor.root, cities=("Chicago",), **settings), part)
    assert own.names == ours.names
    np.testing.assert_allclose(own.tile_metres, ours.tile_metres, rtol=1e-12)
    for dataset in (own, ours):
        dataset.set_epoch(3)
    for index in range(len(own)):
        a, b = own[index], ours[index]
        assert (a["ground"] == b["ground"]).all()
        assert (a["aerial"] == b["aerial"]).all()
        np.testing.assert_allclose(a["pose"], b["pose"], rtol=0, atol=1e-12)


def test_the_panorama_s_own_heading_counts(table, pairs, vigor):
    for row in pairs:
        row["heading_deg"] = 90.0
    turned = PoseDataset(table(pairs, heading_half_width_deg=0), "test")
    north = PoseDataset(table(rows_of(vigor), heading_half_width_deg=0), "test")
    # What the centre column of the one shows, a quarter of the width right of it does the other's.
    a, b = (np.asarray(dataset[0]["ground"]) for dataset in (turned, north))
    np.testing.assert_allclose(a, np.roll(b, 16, axis=-1), atol=1e-5)


def marked_tile(path, u, v, pixels=400):
    """A black tile with a white square of 8 pixels around a place."""
    tile = np.zeros((pixels, pixels, 3), np.uint8)
    row, column = round(v * pixels), round(u * pixels)
    tile[max(row - 4, 0) : row + 4, max(column - 4, 0) : column + 4] = 255
    Image.fromarray(tile).save(path)


def mark(sample):
    """Where the white square of a sample's aerial image is: u, v."""
    grey = denormalise(sample["aerial"]).astype(float).mean(axis=-1)
    weight = np.where(grey > 60, grey, 0)
    rows, columns = np.indices(grey.shape) + 0.5
    row, column = (rows * weight).sum(), (columns * weight).sum()
    return np.array([column, row]) / weight.sum() / len(grey)


@pytest.mark.parametrize("place", ["u, v", "lat, lon"])
def test_large_tiles_are_cut_off_the_camera(table, pairs, tmp_path, place):
    rng = np.random.default_rng(1)
    rows = pairs[:4]
    for number, row in enumerate(rows):
        u, v = rng.uniform(0.1, 0.9, 2)
        marked_tile(tmp_path / f"{number}.png", u, v)
        row |= {"tile": str(tmp_path / f"{number}.png"), "u": u, "v": v, "metres_per_pixel": 0.5}
        if place == "lat, lon":
            row["tile_lat"], row["tile_lon"] = 52.0, 4.5
            row["lat"], row["lon"] = offset_position((52.0, 4.5), 200 * (u - 0.5), 200 * (0.5 - v))
            del row["u"], row["v"]
    dataset = PoseDataset(table(rows, side_m=80.0, shift_m=25.0), "train")
    assert dataset.tile_metres.tolist() == [80.0] * 4
    seen = []
    for epoch in range(3):
        dataset.set_epoch(epoch)
        for index in range(4):
            sample = dataset[index]
            u, v, _ = sample["pose"]
            np.testing.assert_allclose(mark(sample), [u, v], atol=0.02)
            assert sample["metres_per_pixel"] == 80.0 / 64
            seen.append((float(u), float(v)))
    # Where the tile has room, the camera is up to 25 m off the window's centre.
    away_m = 80 * np.abs(np.array(seen) - 0.5)
    assert len(set(seen)) == 12
    assert away_m.max() <= 40.0
    assert (away_m <= 25.0 + 1e-9).mean() > 0.5


def test_test_samples_are_cut_once_and_for_all(table, pairs):
    dataset = PoseDataset(table(pairs, side_m=50.0), "test")
    first = dataset.poses()
    dataset.set_epoch(5)
    np.testing.assert_array_equal(dataset.poses(), first)
    assert (np.abs(first[:, :2] - 0.5) > 0.01).any()


def test_without_a_side_it_is_that_of_the_smallest_tile(table, pairs):
    assert table(pairs).side_m == pytest.approx(SIDE_M)
    pairs[2]["metres_per_pixel"] /= 2
    assert table(pairs).side_m == pytest.approx(SIDE_M / 2)


def test_a_tile_that_lacks_a_little_is_padded_and_a_smaller_one_refused(table, pairs, tmp_path):
    Image.new("RGB", (80, 80), (200, 100, 50)).save(tmp_path / "plain.png")
    for row in pairs:
        row["tile"] = str(tmp_path / "plain.png")
    dataset = PoseDataset(table(pairs, side_m=1.05 * SIDE_M), "test")
    shown = denormalise(dataset[0]["aerial"])
    np.testing.assert_allclose(shown, np.broadcast_to([200, 100, 50], shown.shape), atol=1)
    place = np.array([pairs[0]["u"], pairs[0]["v"]])
    np.testing.assert_allclose(dataset.pose(0)[:2], 0.5 + (place - 0.5) / 1.05, atol=1e-12)
    dataset = PoseDataset(table(pairs, side_m=2 * SIDE_M), "test")
    with pytest.raises(SampleError, match=r"line 2: tile .*plain\.png: is 71\.21 m wide and the"):
        dataset[0]


def test_the_column_split_tells_the_parts(table, pairs, caplog):
    for row, part in zip(pairs, ("train", "test", "train", "validation", "train"), strict=True):
        row["split"] = part
    names = {
        part: PoseDataset(table(pairs), part).names for part in ("train", "validation", "test")
    }
    ids = [row["id"] for row in pairs]
    assert names == {
        "train": [ids[0], ids[2], ids[4]],
        "validation": [ids[3]],
        "test": [ids[1]],
    }
    for row in pairs:
        row["split"] = row["split"].replace("validation", "train")
    some = [
        PoseDataset(table(pairs, validation_fraction=0.25), part)
        for part in ("train", "validation")
    ]
    assert sorted(name for dataset in some for name in dataset.names) == sorted(
        [ids[0], ids[2], ids[3], ids[4]]
    )
    assert len(some[1]) == 1
    assert "no column split" not in caplog.text
    for row in pairs:
        del row["split"]
    assert PoseDataset(table(pairs), "test").names == ids
    assert "has no column split, so that all its rows are the test part" in caplog.text


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"heading_deg": None}, "line 3: heading_deg is empty; expected degrees clockwise"),
        ({"metres_per_pixel": None}, "metres_per_pixel is empty; expected that of the row's tile"),
        ({"u": None, "v": None}, "u is empty; expected the camera's place in its tile"),
        ({"v": None}, "v is empty; expected a number from 0 to 1, beside u"),
        ({"u": None, "v": None, "lat": 1.0, "lon": 2.0}, "tile_lat is empty; expected with"),
        ({"tile": None}, "lat is empty; expected with lon the camera's place"),
        ({"tile": None, "lat": 1.0, "lon": 2.0}, "tile is empty; expected an aerial tile, or a m"),
    ],
)
def test_rows_that_lack_something(table, pairs, change, said):
    pairs[1] |= change
    with pytest.raises(DatasetError, match=said):
        PoseDataset(table(pairs), "train")


def test_places_off_their_tile(table, pairs):
    for row in pairs:
        del row["u"], row["v"]
        row |= {"tile_lat": 52.0, "tile_lon": 4.5, "lat": 52.0, "lon": 4.5}
    pairs[1] |= {"lat": 4.5, "lon": 52.0}
    pairs[2]["lat"] = 52.01
    dataset = PoseDataset(table(pairs), "train")
    assert dataset.pose(0)[:2].tolist() == [0.5, 0.5]
    with pytest.raises(DatasetError, match=r"line 3: lat is '4\.5'; .*: the two are swapped"):
        dataset.poses()
    with pytest.raises(
        DatasetError, match=r"line 4: lat is '52\.01'; .* is 1113 m off its centre$"
    ):
        dataset.pose(2)


def test_missing_files_are_samples_that_cannot_be_read(table, pairs, tmp_path):
    pairs[0]["ground"], pairs[1]["tile"] = "Chicago/none.jpg", "Chicago/none.png"
    log = BadSampleLog(tmp_path / "bad.jsonl")
    dataset = PoseDataset(table(pairs), "test", log)
    assert [sample is None for sample in map(dataset.__getitem__, range(5))] == [
        True, True, False, False, False,
    ]  # fmt: skip
    assert all("there is no such image" in error for error in log.entries().values())


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"side_m": 0.0}, r"side_m is 0\.0; it must be above 0, in metres"),
        ({"shift_m": -1.0}, r"shift_m is -1\.0; it must be at least 0"),
        ({"view": (10.0, -10.0, 5.0, 20.0)}, "view is .*such as -35,35,-20,20 degrees"),
        ({"split": "cross-area"}, "a table tells its parts by its column split"),
    ],
)
def test_settings_out_of_range(table, pairs, settings, said):
    with pytest.raises(DatasetError, match=said):
        table(pairs, **settings)


def test_a_list_of_headings_goes_before_drawn_ones(table, pairs):
    dataset = PoseDataset(table(pairs), "test")
    dataset.use_headings(np.array([10.0, 20.0, 30.0, 40.0, 50.0]))
    assert dataset.poses()[:, 2].tolist() == [10.0, 20.0, 30.0, 40.0, 50.0]


def test_a_part_of_each_panorama_is_vigor_s(table, pairs, vigor):
    own = PoseDataset(table(pairs, hfov_deg=120.0, elevations=(-30, 60)), "train")
    config = VigorConfig(
        root=vigor.root, cities=("Chicago",), hfov_deg=120.0, elevations=(-30, 60), **SIZES
    )
    ours = PoseDataset(config, "train")
    assert own.hfov_deg == ours.hfov_deg == 120.0
    for a, b in zip(own, ours, strict=True):
        assert (a["ground"] == b["ground"]).all()
        np.testing.assert_allclose(a["pose"], b["pose"], atol=1e-12)


def test_tilted_panoramas_are_levelled(table, pairs, tmp_path):
    pitch, roll = 12.0, -7.0
    xmp = (
        '<x:xmpmeta xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" '
        f'GPano:PosePitchDegrees="{pitch}" GPano:PoseRollDegrees="{roll}"/>'
    )
    table(pairs)  # makes the names absolute
    for number, row in enumerate(pairs):
        said = tmp_path / f"says_{number}.jpg"
        with Image.open(row["ground"]) as image:
            image.save(said, quality=95, xmp=xmp.encode())
        with Image.open(said) as image:
            Image.fromarray(np.asarray(image)).save(tmp_path / f"{number}.png")
        row["ground"] = str(tmp_path / f"{number}.png")
    plain = list(PoseDataset(table(pairs), "test"))
    for row in pairs:
        row |= {"pitch_deg": pitch, "roll_deg": roll}
    levelled = list(PoseDataset(table(pairs), "test"))
    # What the file says of itself is done once, whatever the table says.
    for number, row in enumerate(pairs):
        row["ground"] = str(tmp_path / f"says_{number}.jpg")
    says = list(PoseDataset(table(pairs), "test"))
    for a, b, c in zip(plain, levelled, says, strict=True):
        # Headings are drawn by name, and the files' names are the ids here.
        assert float((b["ground"] - c["ground"]).abs().max()) < 1e-5
        assert float((a["ground"] - b["ground"]).abs().mean()) > 0.05


# On a map.


@pytest.fixture
def on_map(mapped, tmp_path):
    """The function that writes a table of the photographs of a map, and gives the settings."""
    rows = [
        {"ground": str(mapped.folder / name), "lat": lat, "lon": lon, "heading_deg": heading}
        for name, (lat, lon, heading) in mapped.poses.items()
    ]

    def write(change=lambda row: None, **settings):
        for row in rows:
            change(row)
        path = write_rows(tmp_path / "photos.csv", rows)
        return TableConfig(root=path, **SIZES | {"map": str(mapped.map)} | settings)

    return write


def test_samples_of_a_map_show_what_their_photographs_show(on_map, sample_view):
    dataset = PoseDataset(on_map(side_m=70.0, aerial_size=140), "train")
    assert dataset.tile_metres.tolist() == [70.0] * 6
    places = []
    for epoch in range(2):
        dataset.set_epoch(epoch)
        for index in range(6):
            sample = dataset[index]
            u, v, heading_deg = sample["pose"]
            assert max(abs(u - 0.5), abs(v - 0.5)) <= 0.2501
            places.append((float(u), float(v)))
            # The photograph again, as the sample's tile and pose have it.
            azimuth_deg = float(heading_deg) + 360 * ((np.arange(64) + 0.5) / 64 - 0.5)
            ranges = 0.5 * (1 - (np.arange(32) + 0.5) / 32)
            aerial = denormalise(sample["aerial"])
            seen = sample_view(aerial, (float(u), float(v)), azimuth_deg, ranges)[20:, :]
            off = np.abs(seen.astype(int) - denormalise(sample["ground"])[20:, :])
            assert np.median(off) < 15, (index, np.median(off))
    assert len(set(places)) == 12


def test_maps_that_miss_the_place(on_map):
    def to_the_south(row):
        row["lat"] -= 1.0

    def swap(row):
        row["lat"], row["lon"] = row["lon"], row["lat"]

    with pytest.raises(DatasetError, match=r"line 2: lat is .*shows none of the rows$"):
        PoseDataset(on_map(to_the_south), "train")
    with pytest.raises(DatasetError, match="shows none of the rows; lat and lon are swapped"):
        PoseDataset(on_map(lambda row: (to_the_north(row), swap(row))), "train")


def to_the_north(row):
    row["lat"] += 1.0


def test_a_row_off_the_map_is_a_sample_that_cannot_be_read(on_map, mapped):
    first = next(iter(mapped.poses))

    def one_away(row):
        if row["ground"].endswith(first):
            row["lat"] += 0.01

    dataset = PoseDataset(on_map(one_away), "test")
    with pytest.raises(SampleError, match=r"ortho\.tif: does not show"):
        dataset[0]
    assert dataset[1] is not None


def test_the_map_of_a_folder_is_found(on_map, mapped, tmp_path):
    (tmp_path / "map.tif").symlink_to(mapped.map)
    assert len(PoseDataset(on_map(map=None), "train")) == 6


# Cameras.

FRONT = "{projection: pinhole, width: 320, height: 120, fx: 160.0, cx: 180.0, cy: 50.0}"
# The same camera cropped by 40 columns at the left and 20 rows at the bottom, at twice the size.
CROPPED = "{projection: pinhole, width: 560, height: 200, fx: 320.0, cx: 280.0, cy: 100.0}"


@pytest.fixture
def pinhole(table, pairs, sample_view, vigor, tmp_path):
    """The function that photographs each tile with these cameras, and gives the settings."""

    def write(cameras, **settings):
        (tmp_path / "cameras.yaml").write_text(
            "\n".join(f"{name}: {text}" for name, text in cameras.items())
        )
        rows = []
        for number, row in enumerate(pairs):
            name = list(cameras)[number % len(cameras)]
            picture = photograph(sample_view, vigor.root / row["tile"], row, name, 37.0 * number)
            file = tmp_path / f"{name}_{number}.png"
            picture.save(file)
            rows.append(row | {"ground": str(file), "heading_deg": 37.0 * number, "camera": name})
        return table(rows, **settings)

    return write


def photograph(sample_view, tile, row, name, heading_deg):
    """What a camera sees of a tile: its columns by their azimuth, all rows alike."""
    scale = 1 if name == "front" else 2
    columns = np.arange(320 if name == "front" else 560) + 0.5
    offset = columns / scale - (180.0 if name == "front" else 140.0)
    azimuth_deg = heading_deg + np.degrees(np.arctan(offset / 160.0))
    rows = 120 if name == "front" else 200
    pixels = np.asarray(Image.open(tile))
    return Image.fromarray(
        sample_view(pixels, (row["u"], row["v"]), azimuth_deg, np.full(rows, 0.15))
    )


def test_pinhole_images_keep_their_heading_and_principal_point(pinhole, sample_view):
    config = pinhole({"front": FRONT}, aerial_size=80)
    assert config.projection == "pinhole"
    left, right = (math.degrees(math.atan(x / 160.0)) for x in (-180.0, 140.0))
    low, high = (math.degrees(math.atan(y / 160.0)) for y in (-70.0, 50.0))
    assert config.view == pytest.approx((left, right, low, high))
    assert config.ground_aspect == pytest.approx(320 / 120)
    assert config.hfov_deg == pytest.approx(right - left)
    dataset = PoseDataset(config, "train")
    for index in range(len(dataset)):
        sample = dataset[index]
        assert float(sample["pose"][2]) == 37.0 * index
        columns = (np.arange(64) + 0.5) / 64 * 320 - 180.0
        azimuth_deg = 37.0 * index + np.degrees(np.arctan(columns / 160.0))
        aerial = denormalise(sample["aerial"])
        seen = sample_view(aerial, sample["pose"][:2].numpy(), azimuth_deg, np.full(32, 0.15))
        assert np.abs(seen.astype(int) - denormalise(sample["ground"])).mean() < 12


def test_other_cameras_are_cropped_to_the_run_s_view(pinhole):
    config = pinhole({"cropped": CROPPED, "front": FRONT})
    assert config.hfov_deg == pytest.approx(2 * math.degrees(math.atan(280 / 320)))
    dataset = PoseDataset(config, "train")
    # The same place, seen by both: 280 of 320 columns of the one are all of the other's.
    config = pinhole({"front": FRONT, "cropped": CROPPED}, view=config.view)
    for a, b in zip(dataset, PoseDataset(config, "train"), strict=True):
        assert float((a["ground"] - b["ground"]).abs().mean()) < 0.06
    wide = PoseDataset(
        pinhole({"cropped": CROPPED, "front": FRONT}, view=(-45, 40, -15, 15)), "test"
    )
    with pytest.raises(SampleError, match="does not show the run's view, -45 to 40 degrees acro"):
        wide[0]
    assert wide[1] is not None


def test_cameras_that_do_not_go_together(pinhole, table, pairs, tmp_path):
    (tmp_path / "cameras.yaml").write_text(f"front: {FRONT}\ncropped: {CROPPED}\n")
    with pytest.raises(DatasetError, match="line 2: camera is empty; expected one of front, crop"):
        table([dict(row) for row in pairs])
    for row in pairs:
        row["camera"] = "rear"
    with pytest.raises(DatasetError, match="camera is 'rear'; expected one of front, cropped, in"):
        table([dict(row) for row in pairs])
    (tmp_path / "cameras.yaml").write_text(f"rear: {FRONT}\nroof: {{projection: equirectangular}}")
    pairs[0]["camera"] = "roof"
    with pytest.raises(DatasetError, match=r"rear pinhole, roof equirectangular.*a table of"):
        PoseDataset(table([dict(row) for row in pairs]), "train")
    (tmp_path / "cameras.yaml").unlink()
    with pytest.raises(DatasetError, match="expected one of panorama, as there is no"):
        table(pairs)


@pytest.mark.parametrize(("pitch_deg", "roll_deg"), [(10.0, 0.0), (-15.0, 20.0), (0.0, -30.0)])
def test_tilted_pinhole_images_are_levelled(pitch_deg, roll_deg):
    """Marks at known azimuths and elevations show where a level camera would see them."""
    camera = Camera(projection="pinhole", width=400, height=300, fx=200.0, cx=210.0, cy=140.0)
    pitch, roll = math.radians(pitch_deg), math.radians(roll_deg)
    for azimuth_deg, elevation_deg in ((0, 0), (15, 0), (-20, 5), (10, -8)):
        azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
        right = math.cos(elevation) * math.sin(azimuth)
        ahead = math.cos(elevation) * math.cos(azimuth)
        up = math.sin(elevation)
        # Pitched up, the camera sees all lower; rolled to the right, all turned to the left.
        ahead_p = ahead * math.cos(pitch) + up * math.sin(pitch)
        up_p = up * math.cos(pitch) - ahead * math.sin(pitch)
        right_r = right * math.cos(roll) - up_p * math.sin(roll)
        up_r = up_p * math.cos(roll) + right * math.sin(roll)
        row, column = 140 - 200 * up_r / ahead_p, 210 + 200 * right_r / ahead_p
        assert 10 < row < 290
        assert 10 < column < 390
        rows, columns = np.indices((300, 400)) + 0.5
        mark_at = 255 * np.exp(-((rows - row) ** 2 + (columns - column) ** 2) / 18)
        image = Image.fromarray(np.repeat(mark_at[..., None], 3, 2).astype(np.uint8))
        level = np.asarray(level_pinhole(image, camera, pitch_deg, roll_deg), float)[..., 0]
        found = (rows * level).sum() / level.sum(), (columns * level).sum() / level.sum()
        expected = 140 - 200 * up / ahead, 210 + 200 * right / ahead
        np.testing.assert_allclose(found, expected, atol=0.7)


def test_the_table_s_tilt_of_pinhole_images_counts(pinhole, pairs):
    plain = list(PoseDataset(pinhole({"front": FRONT}), "test"))
    for row in pairs:
        row["pitch_deg"] = 20.0
    tilted = list(PoseDataset(pinhole({"front": FRONT}), "test"))
    for row in pairs:
        row["pitch_deg"] = 1.0  # counts as level
    level = list(PoseDataset(pinhole({"front": FRONT}), "test"))
    for a, b, c in zip(plain, tilted, level, strict=True):
        assert (a["ground"] == c["ground"]).all()
        assert (a["ground"] != b["ground"]).any()


def test_a_part_of_panoramas_is_not_turned(table, pairs, vigor, tmp_path):
    for number, row in enumerate(pairs):
        with Image.open(vigor.root / row["ground"]) as image:
            image.crop((32, 16, 96, 48)).save(tmp_path / f"{number}.png")  # 180 by 90 degrees
        row |= {"ground": str(tmp_path / f"{number}.png"), "heading_deg": 30.0 * number}
    (tmp_path / "cameras.yaml").write_text("half: {projection: equirectangular, hfov_deg: 180}\n")
    with pytest.raises(DatasetError, match="camera half: is a part of a panorama; its width and"):
        table([dict(row) for row in pairs])
    (tmp_path / "cameras.yaml").write_text(
        "half: {projection: equirectangular, hfov_deg: 180, width: 64, height: 32}\n"
    )
    config = table([dict(row) for row in pairs])
    assert (config.hfov_deg, config.view) == (180.0, (-90.0, 90.0, -45.0, 45.0))
    dataset = PoseDataset(config, "train")
    np.testing.assert_allclose(dataset.poses()[:, 2], [0.0, 30.0, 60.0, 90.0, 120.0])
    with Image.open(tmp_path / "2.png") as image:
        shown = np.asarray(image.convert("RGB"))
    np.testing.assert_allclose(denormalise(dataset[2]["ground"]), shown, atol=1)
    with pytest.raises(DatasetError, match=r"hfov_deg is 90; the images of .* show 180 degrees"):
        table([dict(row) for row in pairs], hfov_deg=90.0)
    (tmp_path / "cameras.yaml").unlink()
    with pytest.raises(DatasetError, match=r"photos\.csv lists whole panoramas, of which hfov_deg"):
        table(pairs, view=(-90.0, 90.0, -45.0, 45.0))


def test_pinhole_images_take_no_heading_prior(pinhole):
    with pytest.raises(DatasetError, match="heading_half_width_deg is 10; only whole panoramas"):
        PoseDataset(pinhole({"front": FRONT}, heading_half_width_deg=10), "train")
