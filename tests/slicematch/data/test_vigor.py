"""VIGOR: each trap of its labels, panoramas and cities, on trees in its own format."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from slicematch.data.dataset import PoseDataset
from slicematch.data.errors import DatasetError, SampleError
from slicematch.data.images import denormalise
from slicematch.data.vigor import CITIES, VigorConfig, read_labels
from slicematch.evaluation.metrics import oracle_error
from torch.utils.data import DataLoader

from slicemask import PoseGrid

SMALL = {"ground_size": (32, 64), "aerial_size": 64, "validation_fraction": 0.0}
REAL = Path(__file__).parents[4] / "shared" / "data" / "vigor_labels"
# What editors and other programs make of a text of lines.
WRITINGS = {
    "blank lines": lambda text: ("\n\n" + text.replace("\n", "\n\n") + "\n\n\n").encode(),
    "lines of a space": lambda text: (" \n" + text.replace("\n", "\n \n") + "\n ").encode(),
    "lines of a tab": lambda text: (text.replace("\n", "\n\t\n") + "\n\t").encode(),
    "byte-order mark": lambda text: text.encode("utf-8-sig"),
    "byte-order mark on a line of its own": lambda text: ("\ufeff\n" + text).encode(),
    "CRLF": lambda text: (text.replace("\n", "\r\n") + "\r\n").encode(),
    "CR": lambda text: text.replace("\n", "\r").encode(),
    "all of it": lambda text: ("\ufeff \r\n" + text.replace("\n", "\r\n\t\r\n")).encode(),
}
QUARTER = (0.25, 0.25, 0.75, 0.75)


def open_vigor(root, part="train", **settings):
    return PoseDataset(VigorConfig(root=root, **{**SMALL, **settings}), part)


def label_file(root, name, city="Chicago"):
    return Path(root) / "splits__corrected" / city / f"{name}__corrected.txt"


def write_label(root, d0, d1):
    """Let the training file hold one pair at d0, d1; returns its tile's path."""
    path = label_file(root, "same_area_balanced_train")
    fields = path.read_text().split("\n")[0].split(" ")
    fields[2:4] = str(d0), str(d1)
    path.write_text(" ".join(fields))
    return Path(root) / "Chicago" / "satellite" / fields[1]


def test_the_paper_s_sizes_are_the_defaults(make_vigor_tree, tmp_path):
    make_vigor_tree(tmp_path, pairs=2)
    dataset = PoseDataset(VigorConfig(root=tmp_path, cities=("Chicago",)), "test")
    sample = dataset[0]
    assert sample["ground"].shape == (3, 320, 640)
    assert sample["aerial"].shape == (3, 512, 512)
    assert (dataset.hfov_deg, dataset.config.projection, dataset.aerial_size) == (
        360.0,
        "equirectangular",
        512,
    )


@pytest.mark.parametrize(("hfov_deg", "columns"), [(180, 64), (90.0, 32)])
def test_a_field_of_view_is_cut_around_the_heading(make_vigor_tree, tmp_path, hfov_deg, columns):
    make_vigor_tree(tmp_path, pairs=2)
    whole = open_vigor(tmp_path, "test", cities=("Chicago",), ground_size=(64, 128))
    size = (64, columns)
    cut = open_vigor(tmp_path, "test", cities=("Chicago",), ground_size=size, hfov_deg=hfov_deg)
    assert cut.hfov_deg == hfov_deg
    middle = slice(64 - columns // 2, 64 + columns // 2)
    for index in range(2):
        assert np.array_equal(cut.pose(index), whole.pose(index))
        ground = whole[index]["ground"][..., middle]
        assert (cut[index]["ground"] - ground)[..., 1:-1].abs().max() < 0.1


def test_pairs_of_the_files_as_published(make_vigor_tree, tmp_path):
    """Names with commas, 13 fields, and a last line without its newline."""
    tree = make_vigor_tree(tmp_path, pairs=3)
    text = label_file(tmp_path, "same_area_balanced_train").read_text()
    assert not text.endswith("\n")
    dataset = open_vigor(tmp_path, cities=("Chicago",))
    assert dataset.names == [f"Chicago/{panorama}" for panorama, *_ in tree.labels["Chicago"]]
    assert "," in dataset.names[0]
    for index, (_, _, d0, d1) in enumerate(tree.labels["Chicago"]):
        expected = [(320 - d1) / 640, (320 + d0) / 640]
        assert dataset[index]["pose"][:2].tolist() == expected
    label_file(tmp_path, "same_area_balanced_train").write_text(text + "\n")
    assert len(open_vigor(tmp_path, cities=("Chicago",))) == 3


def test_the_place_in_the_tile_is_320_plus_d0_down_and_320_minus_d1_across(
    make_vigor_tree, tmp_path
):
    make_vigor_tree(tmp_path, pairs=1, tile_pixels=640)
    tile_file = write_label(tmp_path, 100.0, -60.0)
    tile = np.zeros((640, 640, 3), dtype=np.uint8)
    tile[320 + 100 - 8 : 320 + 100 + 8, 320 + 60 - 8 : 320 + 60 + 8] = 255
    Image.fromarray(tile).save(tile_file)
    sample = open_vigor(tmp_path, cities=("Chicago",))[0]
    shown = denormalise(sample["aerial"])[..., 0].astype(float)
    v, u = [
        (shown.sum(axis=1 - axis) * (np.arange(64) + 0.5)).sum() / shown.sum() / 64
        for axis in (0, 1)
    ]
    assert sample["pose"][:2].tolist() == pytest.approx([u, v], abs=1e-3)
    assert sample["pose"][:2].tolist() == [380 / 640, 420 / 640]


def test_places_are_not_rounded(make_vigor_tree, tmp_path):
    make_vigor_tree(tmp_path, pairs=1)
    write_label(tmp_path, 100.37, -60.81)
    expected = [0.5 + 60.81 / 640, 0.5 + 100.37 / 640]
    assert open_vigor(tmp_path, cities=("Chicago",)).poses()[0, :2] == pytest.approx(
        expected, abs=1e-15
    )


@pytest.mark.parametrize("labels", ["corrected", "original"])
def test_only_the_labels_asked_for_are_opened(make_vigor_tree, tmp_path, labels):
    make_vigor_tree(tmp_path, pairs=2)
    folder = {"corrected": "splits__corrected", "original": "splits"}[labels]
    other = {"corrected": "splits", "original": "splits__corrected"}[labels]
    shutil.rmtree(tmp_path / other)
    assert len(open_vigor(tmp_path, labels=labels, cities=("Chicago",))) == 2
    (tmp_path / folder).rename(tmp_path / other)
    with pytest.raises(DatasetError, match="the label file is missing"):
        open_vigor(tmp_path, labels=labels, cities=("Chicago",))


def test_corrected_labels_are_the_default_and_the_message_names_the_choice(
    make_vigor_tree, tmp_path
):
    make_vigor_tree(tmp_path, pairs=2)
    corrected = open_vigor(tmp_path, cities=("Chicago",)).poses()
    original = open_vigor(tmp_path, cities=("Chicago",), labels="original").poses()
    assert np.array_equal(
        corrected, open_vigor(tmp_path, cities=("Chicago",), labels="corrected").poses()
    )
    assert np.abs(corrected - original).max() > 1 / 640
    shutil.rmtree(tmp_path / "splits__corrected")
    with pytest.raises(DatasetError, match=r"\(--labels original\), which are up to 3 m"):
        open_vigor(tmp_path, cities=("Chicago",))


@pytest.mark.parametrize(
    ("edit", "line"),
    [
        (lambda line: line + " more", 2),
        (lambda line: line.rsplit(" ", 1)[0], 2),
        (lambda line: line.replace(" ", "  ", 1), 2),
        (lambda line: " ".join([*line.split(" ")[:2], "here", *line.split(" ")[3:]]), 2),
        (lambda line: " ".join([*line.split(" ")[:2], "nan", *line.split(" ")[3:]]), 2),
    ],
    ids=["14 fields", "12 fields", "double space", "no number", "nan"],
)
def test_a_line_that_is_no_label_is_named(make_vigor_tree, tmp_path, edit, line):
    make_vigor_tree(tmp_path, pairs=3)
    path = label_file(tmp_path, "same_area_balanced_train")
    lines = path.read_text().split("\n")
    lines[line - 1] = edit(lines[line - 1])
    path.write_text("\n".join(lines))
    with pytest.raises(DatasetError, match=rf"corrected\.txt, line {line}: is no label, since "):
        open_vigor(tmp_path, cities=("Chicago",))


@pytest.mark.parametrize(
    ("field", "text", "shown"),
    [
        (3, "nan", "field 3 (d0) is 'nan'; expected a number of pixels"),
        (4, "inf", "field 4 (d1) is 'inf'; expected a number of pixels"),
        (4, "1e999", "field 4 (d1) is '1e999'"),
        (3, "1_0", "field 3 (d0) is '1_0'"),
        (3, "\u0661", "field 3 (d0) is '\u0661'"),
        (3, '"12.5"', "field 3 (d0) is '\"12.5\"'"),
        (7, "'3'", "field 7 (d1) is \"'3'\""),
        (13, "12.5\t", "field 13 (d1) is '12.5\\t'"),
        (1, '"pano,,1.jpg"', "field 1 (panorama) is '\"pano,,1.jpg\"'; expected a bare file name"),
        (5, "'sat.png'", "field 5 (aerial tile) is \"'sat.png'\"; expected a bare file name"),
        (2, "\tsat.png", "field 2 (aerial tile) is '\\tsat.png'; expected a bare file name"),
        (1, "", "field 1 (panorama) is ''; expected a file's name"),
    ],
)
def test_the_field_that_is_no_label_is_shown(make_vigor_tree, tmp_path, field, text, shown):
    make_vigor_tree(tmp_path, pairs=3)
    path = label_file(tmp_path, "same_area_balanced_train")
    lines = path.read_text().split("\n")
    fields = lines[1].split(" ")
    fields[field - 1] = text
    lines[1] = " ".join(fields)
    path.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(DatasetError) as caught:
        open_vigor(tmp_path, cities=("Chicago",))
    message = str(caught.value)
    assert f"{path}, line 2: is no label, since {shown}" in message
    assert len(message) < len(str(path)) + 150


@pytest.mark.parametrize("write", WRITINGS.values(), ids=WRITINGS)
def test_label_files_as_editors_write_them(make_vigor_tree, tmp_path, write):
    make_vigor_tree(tmp_path, pairs=3)
    before = open_vigor(tmp_path, cities=("Chicago",))
    path = label_file(tmp_path, "same_area_balanced_train")
    path.write_bytes(write(path.read_text()))
    after = open_vigor(tmp_path, cities=("Chicago",))
    assert after.names == before.names
    assert np.array_equal(after.poses(), before.poses())


@pytest.mark.parametrize("labels", ["corrected", "original"])
@pytest.mark.parametrize("within", [True, False], ids=["in the root", "elsewhere"])
def test_labels_may_be_a_folder(make_vigor_tree, tmp_path, labels, within):
    root = tmp_path / "data"
    make_vigor_tree(root, pairs=2)
    expected = open_vigor(root, labels=labels, cities=("Chicago",)).poses()
    home = {"corrected": "splits__corrected", "original": "splits"}[labels]
    folder = (root if within else tmp_path) / "my_labels"
    (root / home).rename(folder)
    for split in ("splits", "splits__corrected"):
        shutil.rmtree(root / split, ignore_errors=True)
    named = "my_labels" if within else str(folder)
    assert np.array_equal(open_vigor(root, labels=named, cities=("Chicago",)).poses(), expected)


def test_the_corrected_labels_of_a_folder_come_first(make_vigor_tree, tmp_path):
    make_vigor_tree(tmp_path, pairs=2)
    expected = open_vigor(tmp_path, cities=("Chicago",)).poses()
    shutil.copytree(tmp_path / "splits", tmp_path / "both")
    shutil.copytree(tmp_path / "splits__corrected", tmp_path / "both", dirs_exist_ok=True)
    found = open_vigor(tmp_path, labels="both", cities=("Chicago",)).poses()
    assert np.array_equal(found, expected)


@pytest.mark.parametrize("labels", ["splits_newest", "Corrected", ""])
def test_labels_that_are_neither_a_word_nor_a_folder(make_vigor_tree, tmp_path, labels):
    make_vigor_tree(tmp_path, pairs=1)
    with pytest.raises(DatasetError, match=f"labels is '{labels}'; it must be corrected, original"):
        open_vigor(tmp_path, labels=labels, cities=("Chicago",))


@pytest.mark.parametrize(
    "content", [b"", b"\n\n", b"\xff\xfe\x00"], ids=["empty", "blank", "binary"]
)
def test_a_label_file_without_labels_is_named(make_vigor_tree, tmp_path, content):
    make_vigor_tree(tmp_path, pairs=1)
    label_file(tmp_path, "same_area_balanced_train").write_bytes(content)
    with pytest.raises(DatasetError, match=r"same_area_balanced_train__corrected\.txt: the label"):
        open_vigor(tmp_path, cities=("Chicago",))


@pytest.mark.parametrize(
    ("d0", "d1", "kept"),
    [(320, 0, 1), (-320, 320, 1), (320.5, 0, 0), (0, -321, 0), (-321, 5, 0)],
)
def test_cameras_off_the_tile_are_left_out_and_counted(make_vigor_tree, tmp_path, d0, d1, kept):
    make_vigor_tree(tmp_path, pairs=2)
    path = label_file(tmp_path, "same_area_balanced_train")
    first, second = path.read_text().split("\n")
    fields = second.split(" ")
    fields[2:4] = str(d0), str(d1)
    path.write_text(f"{first}\n{' '.join(fields)}")
    dataset = open_vigor(tmp_path, cities=("Chicago",))
    assert (len(dataset), dataset.left_out) == (1 + kept, 1 - kept)
    assert np.all((dataset.poses()[:, :2] >= 0) & (dataset.poses()[:, :2] <= 1))


def test_same_area_trains_and_tests_in_every_city(make_vigor_tree, tmp_path):
    tree = make_vigor_tree(tmp_path, pairs=2, test_pairs=1, cities=CITIES)
    train, test = open_vigor(tmp_path), open_vigor(tmp_path, "test")
    assert (len(train), len(test)) == (8, 4)
    assert [name.split("/")[0] for name in test.names] == list(CITIES)
    assert test.names == [f"{city}/{tree.labels[city][2][0]}" for city in CITIES]
    assert not set(train.names) & set(test.names)


def test_cross_area_uses_whole_cities(make_vigor_tree, tmp_path):
    make_vigor_tree(tmp_path, pairs=2, test_pairs=1, cities=CITIES)
    train = open_vigor(tmp_path, split="cross-area")
    test = open_vigor(tmp_path, "test", split="cross-area")
    assert [name.split("/")[0] for name in train.names] == ["NewYork"] * 3 + ["Seattle"] * 3
    assert [name.split("/")[0] for name in test.names] == ["SanFrancisco"] * 3 + ["Chicago"] * 3


def test_cities_are_chosen_among_those_of_the_split(make_vigor_tree, tmp_path):
    make_vigor_tree(tmp_path, pairs=2, cities=("Seattle",))
    assert len(open_vigor(tmp_path, cities=("Seattle",))) == 2
    assert len(open_vigor(tmp_path, cities=("Seattle", "Chicago"), split="cross-area")) == 2
    with pytest.raises(
        DatasetError, match="the test part of the cross-area split has SanFrancisco"
    ):
        open_vigor(tmp_path, "test", cities=("Seattle",), split="cross-area")
    with pytest.raises(DatasetError, match="city is 'Boston'; it must be one of NewYork"):
        open_vigor(tmp_path, cities=("Boston",))
    with pytest.raises(
        DatasetError,
        match=r"NewYork.*label file is missing; .* cities that are there \(--cities Seattle\)",
    ):
        open_vigor(tmp_path)


def test_metres_per_pixel_differ_by_city_and_scale_with_the_size(make_vigor_tree, tmp_path):
    make_vigor_tree(tmp_path, pairs=1, cities=CITIES)
    at_640 = {
        "NewYork": 0.113248,
        "Seattle": 0.100817,
        "SanFrancisco": 0.118141,
        "Chicago": 0.111262,
    }
    for size in (64, 512):
        dataset = open_vigor(tmp_path, aerial_size=size)
        for index, city in enumerate(CITIES):
            found = dataset[index]["metres_per_pixel"]
            assert found == pytest.approx(at_640[city] * 640 / size, rel=1e-12)
            assert dataset.tile_metres[index] == pytest.approx(at_640[city] * 640, rel=1e-12)


def test_labels_outside_a_candidate_extent_are_counted(make_vigor_tree, tmp_path):
    make_vigor_tree(tmp_path, pairs=1)
    for d0, d1, outside in ((160, -160, 0), (161, 0, 1), (0, 160.5, 1)):
        write_label(tmp_path, d0, d1)
        dataset = open_vigor(tmp_path, cities=("Chicago",))
        assert dataset.count_outside(QUARTER) == outside
        assert dataset.count_outside((0, 0, 1, 1)) == 0
        corner = d0 * d1 != 0
        assert dataset.count_outside((0, 0, 1, 1), place_prior=(0.5, 0.5, 0.3)) == corner


@pytest.mark.parametrize("augment", [False, True])
def test_the_ground_image_is_what_the_tile_shows_from_the_pose(
    make_vigor_tree, tmp_path, sample_view, true_colours, augment
):
    """The tree paints with north at the centre; the loader has turned it to the heading."""
    make_vigor_tree(tmp_path, pairs=4)
    dataset = open_vigor(
        tmp_path, cities=("Chicago",), aerial_size=320, ground_size=(64, 128), augment=augment
    )
    azimuth_deg = 360 * ((np.arange(128) + 0.5) / 128 - 0.5)
    ranges = 0.5 * (1 - (np.arange(64) + 0.5) / 64)
    for index in range(4):
        sample = dataset[index]
        u, v, heading_deg = sample["pose"].numpy()
        tile, ground = denormalise(sample["aerial"]), denormalise(sample["ground"]).astype(int)

        def mismatch(turned_deg, tile=tile, ground=ground, place=(u, v)):
            seen = sample_view(tile, place, turned_deg + azimuth_deg, ranges)
            return np.abs(seen - ground).mean()

        turns = np.arange(-40, 41, 1.0)
        best = turns[np.argmin([mismatch(heading_deg + turn) for turn in turns])]
        assert abs(best) <= 1
        assert mismatch(heading_deg) < 8 < mismatch(-heading_deg)


def test_augmenting_shows_all_eight_symmetries_and_keeps_a_known_heading(
    make_vigor_tree, tmp_path, true_colours
):
    make_vigor_tree(tmp_path, pairs=1)
    plain, augmented, again, aligned = (
        open_vigor(tmp_path, cities=("Chicago",), augment=augment, heading_half_width_deg=prior)
        for augment, prior in ((False, None), (True, None), (True, None), (True, 0))
    )
    images, places, known = set(), set(), set()
    for epoch in range(60):
        for dataset in (plain, augmented, again, aligned):
            dataset.set_epoch(epoch)
        assert np.array_equal(augmented.pose(0), again.pose(0))
        images.add(augmented[0]["aerial"].numpy().tobytes())
        places.add(tuple(augmented.pose(0)[:2].round(9)))
        u, v, heading_deg = aligned.pose(0)
        assert heading_deg == 0
        known.add((round(u, 9), round(v, 9)))
    assert len(images) == len(places) == 8
    u, v, _ = plain.pose(0)
    assert known == {(round(u, 9), round(v, 9)), (round(1 - u, 9), round(v, 9))}
    test = open_vigor(tmp_path, "test", cities=("Chicago",), augment=True)
    assert np.array_equal(test.pose(0)[:2], plain.pose(0)[:2])


def test_a_share_of_the_training_images_is_restyled(make_vigor_tree, tmp_path, true_colours):
    make_vigor_tree(tmp_path, pairs=4)
    small = {"cities": ("Chicago",), "ground_size": (16, 32), "aerial_size": 32, "augment": True}
    plain, half, again, each = (
        open_vigor(tmp_path, restyle=share, **small) for share in (0.0, 0.5, 0.5, 1.0)
    )
    changed = {0.5: [], 1.0: []}
    for epoch in range(8):
        for dataset in (plain, half, again, each):
            dataset.set_epoch(epoch)
        for index in range(len(plain)):
            sample, restyled = plain[index], half[index]
            for view in ("ground", "aerial"):
                changed[0.5].append(not torch.equal(restyled[view], sample[view]))
                changed[1.0].append(not torch.equal(each[index][view], sample[view]))
            assert torch.equal(restyled["ground"], again[index]["ground"])
    assert 0.3 < np.mean(changed[0.5]) < 0.7
    assert all(changed[1.0])
    test = open_vigor(tmp_path, "test", restyle=1.0, **small)
    expected = open_vigor(tmp_path, "test", **(small | {"augment": False}))
    assert torch.equal(test[0]["aerial"], expected[0]["aerial"])


@pytest.mark.parametrize("share", [-0.1, 1.5, float("nan"), "much"])
def test_a_share_of_restyled_images_is_from_0_to_1(tmp_path, share):
    with pytest.raises(DatasetError, match=r"restyle is .* a share from 0 to 1"):
        open_vigor(tmp_path, cities=("Chicago",), augment=True, restyle=share)


@pytest.mark.parametrize(
    ("settings", "places"),
    [
        # Kept: everything; the mirroring that the centre line allows; the half turn; nothing.
        ({"place_prior": (0.5, 0.5, 0.4)}, 8),
        ({"place_prior": (0.3, 0.5, 0.4)}, 2),
        ({"place_prior": (0.3, 0.3, 0.4)}, 2),
        ({"place_prior": (0.3, 0.4, 0.4)}, 1),
        ({"extent": (0.1, 0.1, 0.9, 0.9)}, 8),
        ({"extent": (0.1, 0.0, 0.9, 1.0)}, 4),
        ({"extent": (0.0, 0.0, 0.5, 1.0)}, 2),
        ({"extent": (0.0, 0.0, 0.5, 1.0), "heading_half_width_deg": 0}, 1),
        ({"extent": (0.0, 0.0, 0.5, 1.0), "place_prior": (0.2, 0.4, 0.4)}, 1),
    ],
)
def test_augmenting_keeps_true_places_among_the_candidates(
    make_vigor_tree, tmp_path, settings, places
):
    make_vigor_tree(tmp_path, pairs=1)
    write_label(tmp_path, 41, 90)  # a place on no axis of the tile, inside all of the above
    dataset = open_vigor(tmp_path, cities=("Chicago",), augment=True, **settings)
    found = set()
    for epoch in range(60):
        dataset.set_epoch(epoch)
        assert dataset.count_outside(dataset.config.extent, None, dataset.config.place_prior) == 0
        found.add(tuple(dataset.pose(0)[:2].round(9)))
    assert len(found) == places


def test_unknown_headings_are_drawn_anew_each_epoch_and_reproducibly(make_vigor_tree, tmp_path):
    make_vigor_tree(tmp_path, pairs=16)
    dataset, again = (open_vigor(tmp_path, cities=("Chicago",)) for _ in range(2))
    epochs = []
    for epoch in range(3):
        dataset.set_epoch(epoch)
        epochs.append(dataset.poses()[:, 2])
    assert len(np.unique(epochs)) > 40
    assert np.min(epochs) < 60
    assert np.max(epochs) > 300
    again.set_epoch(2)  # as after a resume
    assert np.array_equal(again.poses()[:, 2], epochs[2])
    other = open_vigor(tmp_path, cities=("Chicago",), seed=1)
    assert not np.array_equal(other.poses()[:, 2], epochs[0])
    # Whole columns of a panorama: rolling it by them is exact.
    assert np.array_equal(np.array(epochs) * 2048 / 360 % 1, np.zeros((3, 16)))


@pytest.mark.parametrize("context", ["fork", "spawn"])
def test_worker_processes_follow_the_epoch(make_vigor_tree, tmp_path, context):
    make_vigor_tree(tmp_path, pairs=6)
    dataset = open_vigor(tmp_path, cities=("Chicago",))
    loader = DataLoader(
        dataset,
        batch_size=2,
        num_workers=2,
        persistent_workers=True,
        multiprocessing_context=context,
    )
    for epoch in (0, 1):
        dataset.set_epoch(epoch)
        loaded = np.concatenate([batch["pose"].numpy() for batch in loader])
        assert np.array_equal(loaded, dataset.poses())


def test_validation_and_test_keep_their_headings(make_vigor_tree, tmp_path):
    make_vigor_tree(tmp_path, pairs=8, cities=("Seattle", "Chicago"))
    for part in ("validation", "test"):
        dataset = open_vigor(tmp_path, part, cities=("Seattle", "Chicago"), validation_fraction=0.5)
        before = dataset.poses()
        dataset.set_epoch(5)
        assert np.array_equal(dataset.poses(), before)
        assert len(np.unique(before[:, 2])) > 6
    # A sample keeps its heading whatever else is tested with it.
    assert np.array_equal(open_vigor(tmp_path, "test", cities=("Chicago",)).poses(), before[8:])


def test_a_known_heading_is_north(make_vigor_tree, tmp_path):
    make_vigor_tree(tmp_path, pairs=4, panorama_size=(32, 64))
    for part in ("train", "test"):
        dataset = open_vigor(tmp_path, part, cities=("Chicago",), heading_half_width_deg=0)
        assert dataset.heading_prior == (0.0, 0.0)
        assert dataset.poses()[:, 2].tolist() == [0.0] * 4
    panorama = tmp_path / "Chicago" / "panorama" / dataset.names[0].split("/", 1)[1]
    with Image.open(panorama) as image:
        assert np.array_equal(denormalise(dataset[0]["ground"]), np.asarray(image))


def test_a_heading_prior_bounds_the_turn_to_both_sides(make_vigor_tree, tmp_path):
    make_vigor_tree(tmp_path, pairs=32, panorama_size=(8, 16), tile_pixels=8)
    dataset = open_vigor(tmp_path, cities=("Chicago",), heading_half_width_deg=20)
    assert dataset.heading_prior == (0.0, 20.0)
    headings = (dataset.poses()[:, 2] + 180) % 360 - 180
    assert np.abs(headings).max() <= 20
    assert headings.min() < -10
    assert headings.max() > 10
    for unknown in (None, 180):
        assert (
            open_vigor(tmp_path, cities=("Chicago",), heading_half_width_deg=unknown).heading_prior
            is None
        )


def test_validation_is_a_seeded_share_of_the_training_file(make_vigor_tree, tmp_path):
    make_vigor_tree(tmp_path, pairs=20, panorama_size=(8, 16), tile_pixels=8)

    def names(part, seed=0):
        settings = {"cities": ("Chicago",), "validation_fraction": 0.25, "seed": seed}
        return open_vigor(tmp_path, part, **settings).names

    train, validation = names("train"), names("validation")
    assert (len(train), len(validation)) == (15, 5)
    assert sorted(train + validation) == names("test")  # the same pairs, all of them
    assert validation == names("validation")
    assert validation != names("validation", seed=1)
    with pytest.raises(DatasetError, match=r"the validation part .* holds no sample"):
        open_vigor(tmp_path, "validation", cities=("Chicago",), validation_fraction=0.0)


@pytest.mark.parametrize(("folder", "size"), [("panorama", (200, 120)), ("satellite", (64, 50))])
def test_an_oddly_shaped_image_is_named(make_vigor_tree, tmp_path, folder, size):
    make_vigor_tree(tmp_path, pairs=1)
    (path,) = (tmp_path / "Chicago" / folder).iterdir()
    Image.new("RGB", size).save(path)
    with pytest.raises(SampleError) as error:
        open_vigor(tmp_path, cities=("Chicago",))[0]
    assert str(path) in str(error.value)
    assert f"{size[0]}x{size[1]} pixels" in str(error.value)


@pytest.fixture
def real_chicago(tmp_path):
    if not REAL.is_dir():
        pytest.skip(f"the real VIGOR labels are not at {REAL}")
    (tmp_path / "splits__corrected").symlink_to(REAL, target_is_directory=True)
    return tmp_path


@pytest.mark.parametrize(("part", "count"), [("train", 12_740), ("test", 12_739)])
def test_the_real_chicago_labels_read_whole(real_chicago, part, count):
    dataset = open_vigor(real_chicago, part, cities=("Chicago",))
    assert (len(dataset), dataset.left_out) == (count, 0)
    assert len(set(dataset.names)) == count


def test_the_real_chicago_labels_reach_beyond_the_central_quarter(real_chicago):
    extremes, outside = [], 0
    for part in ("train", "test"):
        labels = read_labels(label_file(real_chicago, f"same_area_balanced_{part}"))
        extremes.append(np.abs(labels.offsets).max())
        dataset = open_vigor(real_chicago, part, cities=("Chicago",))
        outside += dataset.count_outside(QUARTER)
        assert dataset.count_outside((0, 0, 1, 1)) == 0
    assert max(extremes) == 165
    assert outside > 0


@pytest.mark.parametrize(
    ("grid", "mean", "median"), [("21x21x64", 1.26, 1.30), ("64x64x64", 0.42, 0.45)]
)
def test_the_oracle_error_of_grids_on_real_labels(real_chicago, grid, mean, median):
    """Near the figures for three cities; a tile of Chicago is about as large as theirs."""
    dataset = open_vigor(real_chicago, "test", cities=("Chicago",))
    oracle = oracle_error(PoseGrid.parse(grid).poses(), dataset.poses(), dataset.tile_metres)
    summary = oracle.summary()
    assert summary["place_mean_m"] == pytest.approx(mean, rel=0.05)
    assert summary["place_median_m"] == pytest.approx(median, rel=0.05)
    # Headings k * 360/64: at most 2.8125 degrees off, half that in the mean.
    assert oracle.heading_deg.max() <= 2.8125
    assert summary["heading_mean_deg"] == pytest.approx(1.406, abs=0.03)


def test_corrected_and_original_labels_of_a_folder_are_not_mixed(make_vigor_tree, tmp_path):
    """A folder whose corrected labels lack a city is not filled up with original ones."""
    cities = ("Chicago", "Seattle")
    make_vigor_tree(tmp_path, pairs=2, cities=cities)
    mine = tmp_path / "mine"
    (tmp_path / "splits").rename(mine)
    corrected = label_file(tmp_path, "same_area_balanced_train")
    corrected.rename(mine / "Chicago" / corrected.name)
    assert open_vigor(tmp_path, labels="mine", cities=("Chicago",)).names
    with pytest.raises(
        DatasetError, match=r"mine/Seattle/same_area_balanced_train__corrected\.txt"
    ):
        open_vigor(tmp_path, labels="mine", cities=cities)
