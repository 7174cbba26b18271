"""Generated cities in VIGOR's format: names, labels, loaders, determinism, going on."""

import json
import re

import numpy as np
import pytest
from PIL import Image
from slicematch.data.dataset import PoseDataset
from slicematch.data.vigor import METRES_PER_PIXEL, VigorConfig, read_labels

from slicemask.errors import SpecError, SynthError
from slicemask.synth import generate_vigor
from slicemask.synth.formats.vigor import CITIES, VigorSpec, plan_city

NAMES = ("NewYork", "SanFrancisco")


def label_lines(root, city, name="pano_label_balanced"):
    path = root / "splits__corrected" / city / f"{name}__corrected.txt"
    return [line.split(" ") for line in path.read_text().splitlines()]


def contents(root):
    return {
        str(path.relative_to(root)): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file()
    }


def test_cities_have_vigors_names_and_resolutions():
    assert {city.name: city.metres_per_pixel for city in CITIES} == METRES_PER_PIXEL


@pytest.mark.parametrize("city", NAMES)
def test_names_labels_and_lists_are_vigors(vigor_tree, city):
    lines = label_lines(vigor_tree, city)
    assert len(lines) == 5
    listed = (vigor_tree / "splits__corrected" / city / "satellite_list.txt").read_text().split()
    on_disk = {path.name for path in (vigor_tree / city / "satellite").iterdir()}
    assert on_disk == set(listed) == {name for line in lines for name in line[1::3]}
    panoramas = {path.name for path in (vigor_tree / city / "panorama").iterdir()}
    assert panoramas == {line[0] for line in lines}
    for line in lines:
        assert len(line) == 13
        assert re.fullmatch(r"[\w-]{22},-?\d+\.\d{6},-?\d+\.\d{6},\.jpg", line[0])
        assert all(re.fullmatch(r"satellite_\d+\.\d+_-\d+\.\d+\.png", name) for name in line[1::3])
        assert len(set(line[1::3])) == 4
        offsets = np.abs(np.array([line[2::3], line[3::3]], dtype=float))
        assert offsets[:, 0].max() <= 164 + 1e-6  # the positive is the nearest tile
        assert offsets.max() <= 328 + 1e-6
    parts = [label_lines(vigor_tree, city, f"same_area_balanced_{part}") for part in
             ("train", "test")]  # fmt: skip
    assert sorted(parts[0] + parts[1]) == sorted(lines)
    assert [len(part) for part in parts] == [3, 2]


@pytest.mark.parametrize("folder", ["splits", "splits_new"])
@pytest.mark.parametrize("city", NAMES)
def test_labels_lie_under_the_names_that_other_loaders_open(vigor_tree, city, folder):
    corrected, other = vigor_tree / "splits__corrected" / city, vigor_tree / folder / city
    assert {path.name for path in other.iterdir()} == {
        path.name.replace("__corrected", "") for path in corrected.iterdir()
    }
    for path in corrected.iterdir():
        assert (other / path.name.replace("__corrected", "")).read_bytes() == path.read_bytes()


def test_original_labels_are_the_corrected_ones(vigor_tree):
    corrected, original = (
        PoseDataset(VigorConfig(root=vigor_tree, cities=NAMES, labels=labels), "test")
        for labels in ("corrected", "original")
    )
    assert len(corrected) == len(original) > 0
    for index in range(len(corrected)):
        assert np.array_equal(corrected[index]["pose"], original[index]["pose"])


@pytest.mark.parametrize("city", NAMES)
def test_labels_agree_with_latitude_and_longitude(vigor_tree, city):
    """d0 counts south and d1 west from the tile's centre, in pixels of 640."""
    for line in label_lines(vigor_tree, city):
        latitude, longitude = map(float, line[0].split(",")[1:3])
        for name, d0, d1 in zip(line[1::3], line[2::3], line[3::3], strict=True):
            tile_latitude, tile_longitude = map(float, name[:-4].split("_")[1:])
            south_m = (tile_latitude - latitude) * 111_320
            west_m = (tile_longitude - longitude) * 111_320 * np.cos(np.radians(latitude))
            assert float(d0) * METRES_PER_PIXEL[city] == pytest.approx(south_m, abs=0.15)
            assert float(d1) * METRES_PER_PIXEL[city] == pytest.approx(west_m, abs=0.15)


def test_loader_reads_the_tree_with_exact_poses(vigor_tree):
    config = VigorConfig(root=vigor_tree, cities=NAMES, validation_fraction=0.0)
    dataset = PoseDataset(config, "test")
    assert dataset.left_out == 0
    assert len(dataset) == 4
    plans = {CITIES[k].name: plan_city(VigorSpec(3, k, 5, (256, 128), 160)) for k in (0, 1)}
    for index in range(len(dataset)):
        sample = dataset[index]
        city, panorama = sample["name"].split("/")
        plan = plans[city]
        tile = next(line[1] for line in label_lines(vigor_tree, city) if line[0] == panorama)
        camera = plan.places[plan.panorama_names.index(panorama)]
        centre = plan.tile_centres(np.array(plan.tile_names.index(tile)))
        east_m, north_m = camera - centre
        span_m = 640 * METRES_PER_PIXEL[city]
        u, v, _ = np.asarray(sample["pose"])
        assert u == pytest.approx(0.5 + east_m / span_m, abs=1e-5)
        assert v == pytest.approx(0.5 - north_m / span_m, abs=1e-5)
        assert sample["ground"].shape == (3, 320, 640)
        assert sample["aerial"].shape == (3, 512, 512)


def test_cross_area_split_has_a_city_on_either_side(vigor_tree):
    config = VigorConfig(root=vigor_tree, split="cross-area", cities=NAMES, validation_fraction=0.2)
    assert {name.split("/")[0] for name in PoseDataset(config, "train").names} == {"NewYork"}
    assert {name.split("/")[0] for name in PoseDataset(config, "test").names} == {"SanFrancisco"}


def test_poses_spread_over_the_central_part_as_in_the_real_labels():
    """Chicago's corrected labels: evenly spread within 164 pixels, deviation 94 to 96."""
    plan = plan_city(VigorSpec(1, 3, 300, (256, 128), 160))
    offsets = plan.offsets()[:, 0]
    assert np.abs(offsets).max() <= 164 + 1e-6
    assert offsets.std(axis=0) == pytest.approx([94.7, 94.7], rel=0.15)
    assert (np.histogram(offsets, bins=4, range=(-164, 164))[0] > 0.15 * offsets.size).all()


def test_overlapping_tiles_show_the_same_ground(vigor_tree):
    """Neighbours are cut out of one picture; only sensor noise differs."""
    plan = plan_city(VigorSpec(3, 0, 5, (256, 128), 160))
    folder = vigor_tree / "NewYork" / "satellite"
    west, east = (
        np.asarray(Image.open(folder / plan.tile_names[tile]), dtype=int) for tile in (0, 1)
    )
    step = 82  # 328 of 640 pixels
    assert np.abs(west[:, step:] - east[:, :-step]).mean() < 6
    assert np.abs(west[:, :-step] - east[:, :-step]).mean() > 12


def test_panorama_faces_north_at_its_centre(vigor_tree):
    """What lies on the ground around the camera shows in both views, in like colours."""
    found = []
    labels = read_labels(
        vigor_tree / "splits__corrected" / "NewYork" / "pano_label_balanced__corrected.txt"
    )
    for panorama, aerial, (d0, d1) in zip(*labels, strict=True):
        ground = np.asarray(Image.open(vigor_tree / "NewYork" / "panorama" / panorama), dtype=float)
        tile = np.asarray(Image.open(vigor_tree / "NewYork" / "satellite" / aerial), dtype=float)
        column, row = np.meshgrid(np.arange(256) + 0.5, np.arange(78, 110) + 0.5)
        azimuth = 2 * np.pi * (column / 256 - 0.5)
        pixels = 2.5 / np.tan(np.pi * (row / 128 - 0.5)) / METRES_PER_PIXEL["NewYork"]
        u = (320 - d1 + pixels * np.sin(azimuth)) / 4
        v = (320 + d0 - pixels * np.cos(azimuth)) / 4
        from_above = tile[np.clip(v, 0, 159).astype(int), np.clip(u, 0, 159).astype(int)].mean(-1)
        street = ground[78:110].mean(axis=-1)
        found.append(
            [
                np.corrcoef(np.roll(street, shift, axis=1).ravel(), from_above.ravel())[0, 1]
                for shift in (0, 64, 128, 192)
            ]
        )
    assert np.mean(found, axis=0).argmax() == 0
    assert np.mean(found, axis=0)[0] > 0.3


def test_same_bytes_whatever_the_number_of_processes(vigor_tree, vigor_options, tmp_path):
    generate_vigor(tmp_path / "again", jobs=2, **vigor_options)
    assert contents(tmp_path / "again") == contents(vigor_tree)


def test_goes_on_where_it_stopped(vigor_options, tmp_path):
    options = {**vigor_options, "cities": 1}
    root = tmp_path / "city"
    calls = []
    first = generate_vigor(root, jobs=1, progress=lambda *call: calls.append(call), **options)
    assert first.rendered == first.images == 11
    assert calls[0] == (0, 11)
    assert calls[-1] == (11, 11)
    whole = contents(root)
    pictures = sorted(root.rglob("*.jpg"))
    tile, other = list(root.rglob("*.png"))[:2]
    pictures[0].unlink()
    pictures[1].write_bytes(pictures[1].read_bytes()[:-200])  # cut short
    tile.write_bytes(tile.read_bytes()[:500])
    damaged = bytearray(other.read_bytes())
    damaged[11] = 5  # the header's length
    other.write_bytes(damaged)
    again = generate_vigor(root, jobs=1, **options)
    assert again.rendered == 4
    assert contents(root) == whole
    assert generate_vigor(root, jobs=1, **options).rendered == 0


def test_seeds_differ(vigor_options, vigor_tree, tmp_path):
    generate_vigor(tmp_path / "other", jobs=1, **{**vigor_options, "seed": 4, "cities": 1})
    assert label_lines(tmp_path / "other", "NewYork") != label_lines(vigor_tree, "NewYork")


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"cities": 5}, "cities is 5; VIGOR has 1 to 4"),
        ({"panoramas": 0}, "panoramas is 0; it must be at least 1"),
        ({"panorama_size": (100, 60)}, "panorama_size is 100x60; it must be twice as wide"),
        ({"tile_size": 3}, "tile_size is 3; it must be at least 16"),
        ({"seed": -1}, "seed is -1; it must be at least 0"),
        ({"jobs": 0}, "jobs is 0; it must be a whole number of at least 1"),
    ],
)
def test_wrong_options_are_one_sentence(vigor_options, tmp_path, wrong, sentence):
    with pytest.raises((SynthError, SpecError), match=re.escape(sentence)):
        generate_vigor(tmp_path / "city", **{**vigor_options, **wrong})
    assert not (tmp_path / "city").exists()


def test_folders_of_something_else_are_refused(vigor_tree, vigor_options, tmp_path):
    before = contents(vigor_tree)
    with pytest.raises(SynthError, match="holds another generated data set"):
        generate_vigor(vigor_tree, **{**vigor_options, "seed": 9})
    assert contents(vigor_tree) == before
    (tmp_path / "thesis.txt").write_text("all of it")
    with pytest.raises(SynthError, match="is not empty and holds no synth"):
        generate_vigor(tmp_path, **vigor_options)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]
    (tmp_path / "thesis.txt").unlink()
    (tmp_path / "synth.json").write_text("{")
    with pytest.raises(SynthError, match="cannot be used as the data set's folder"):
        generate_vigor(tmp_path, **vigor_options)


def test_record_says_how_it_was_made(vigor_tree):
    record = json.loads((vigor_tree / "synth.json").read_text())
    assert record["seed"] == 3
    assert record["panorama_size"] == [256, 128]


@pytest.mark.parametrize(("panoramas", "seed"), [(1, 9), (4, 18)])
def test_streets_without_room_are_refused_before_anything_is_written(tmp_path, panoramas, seed):
    with pytest.raises(SynthError, match=f"panoramas is {panoramas} and seed is {seed}; the str"):
        generate_vigor(tmp_path / "city", panoramas=panoramas, seed=seed)
    assert not (tmp_path / "city").exists()
