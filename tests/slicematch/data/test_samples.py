"""What the data sets share: settings, and what becomes of samples that cannot be read."""

import json
import os
import resource
from contextlib import suppress
from pathlib import Path

import pytest
import torch
from slicematch.data.dataset import BadSampleLog, PoseDataset, collate
from slicematch.data.errors import DatasetError, SampleError
from slicematch.data.kitti import KittiConfig
from slicematch.data.text import read_lines
from slicematch.data.vigor import VigorConfig
from torch.utils.data import DataLoader


def open_vigor(root, part="train", bad_sample_log=None):
    config = VigorConfig(
        root=root,
        cities=("Chicago",),
        ground_size=(16, 32),
        aerial_size=16,
        validation_fraction=0.0,
    )
    return PoseDataset(config, part, bad_sample_log)


@pytest.fixture
def broken_tree(make_vigor_tree, tmp_path):
    """Six pairs: sample 1 lacks its panorama, sample 4 has a tile cut short."""
    tree = make_vigor_tree(tmp_path / "data", pairs=6, panorama_size=(16, 32), tile_pixels=16)
    pairs = tree.labels["Chicago"]
    (tree.root / "Chicago" / "panorama" / pairs[1][0]).unlink()
    tile = tree.root / "Chicago" / "satellite" / pairs[4][1]
    tile.write_bytes(tile.read_bytes()[:100])
    return tree.root


def test_items_are_of_the_agreed_types(make_vigor_tree, tmp_path):
    make_vigor_tree(tmp_path, pairs=2)
    sample = open_vigor(tmp_path)[1]
    assert set(sample) == {"ground", "aerial", "pose", "metres_per_pixel", "name", "index"}
    assert (sample["ground"].dtype, sample["ground"].shape) == (torch.float32, (3, 16, 32))
    assert (sample["aerial"].dtype, sample["aerial"].shape) == (torch.float32, (3, 16, 16))
    assert (sample["pose"].dtype, sample["pose"].shape) == (torch.float64, (3,))
    assert isinstance(sample["metres_per_pixel"], float)
    assert isinstance(sample["name"], str)
    assert sample["index"] == 1


def test_a_loop_over_the_samples_ends(make_vigor_tree, tmp_path):
    make_vigor_tree(tmp_path, pairs=2)
    for part in ("train", "test"):
        assert [sample["index"] for sample in open_vigor(tmp_path, part)] == [0, 1]


def test_without_a_list_of_bad_samples_they_raise(broken_tree):
    dataset = open_vigor(broken_tree)
    with pytest.raises(SampleError, match=r"pano_001.*no such image"):
        dataset[1]
    with pytest.raises(SampleError, match=r"satellite_.*is unreadable as an image"):
        dataset[4]


def test_a_worker_s_error_is_still_one_sentence(broken_tree):
    with pytest.raises(SampleError) as error:
        list(DataLoader(open_vigor(broken_tree), num_workers=1))
    assert str(error.value).startswith(str(broken_tree))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("workers", [0, 2])
def test_in_training_the_next_readable_sample_stands_in(broken_tree, tmp_path, workers):
    bad_sample_log = BadSampleLog(tmp_path / "run" / "bad_samples.jsonl")
    dataset = open_vigor(broken_tree, bad_sample_log=bad_sample_log)
    loader = DataLoader(dataset, batch_size=3, num_workers=workers, collate_fn=collate)
    for _ in range(2):
        batches = list(loader)
        assert [batch["index"].tolist() for batch in batches] == [[0, 2, 2], [3, 5, 5]]
        assert batches[0]["name"][1] == batches[0]["name"][2] == dataset.names[2]
        assert torch.equal(batches[0]["ground"][1], batches[0]["ground"][2])
    # Both are on record, once each, and in the file for whoever looks later.
    assert set(bad_sample_log.entries()) == {dataset.names[1], dataset.names[4]}
    lines = (tmp_path / "run" / "bad_samples.jsonl").read_text().splitlines()
    assert len(lines) == 2
    assert "no such image" in bad_sample_log.entries()[dataset.names[1]]
    assert str(broken_tree) in json.loads(lines[0])["error"]
    assert bad_sample_log.report().startswith("2 samples are unreadable, listed in ")


@pytest.mark.parametrize("workers", [0, 2])
def test_in_evaluation_a_bad_sample_is_left_out(broken_tree, tmp_path, workers):
    bad_sample_log = BadSampleLog(tmp_path / "bad_samples.jsonl")
    dataset = open_vigor(broken_tree, "test", bad_sample_log)
    loader = DataLoader(dataset, batch_size=2, num_workers=workers, collate_fn=collate)
    assert [batch["index"].tolist() for batch in loader] == [[0], [2, 3], [5]]
    assert collate([dataset[1], dataset[4]]) is None
    assert set(bad_sample_log.entries()) == {dataset.names[1], dataset.names[4]}


def test_too_many_bad_samples_end_the_run(broken_tree, tmp_path):
    bad_sample_log = BadSampleLog(tmp_path / "bad_samples.jsonl", limit=1)
    dataset = open_vigor(broken_tree, bad_sample_log=bad_sample_log)
    assert dataset[1]["index"] == 2
    with pytest.raises(DatasetError, match=r"more than 1 samples .*bad_samples\.jsonl"):
        dataset[4]
    assert len(bad_sample_log.entries()) == 2


def test_a_data_set_without_a_single_good_sample_ends_the_run(broken_tree, tmp_path):
    for panorama in Path(broken_tree, "Chicago", "panorama").iterdir():
        panorama.unlink()
    dataset = open_vigor(broken_tree, bad_sample_log=BadSampleLog(tmp_path / "bad.jsonl"))
    with pytest.raises(DatasetError, match=r"none of the 6 samples is readable; see .*bad\.jsonl"):
        dataset[0]


def test_a_run_s_list_starts_empty_and_says_nothing_then(tmp_path):
    path = tmp_path / "bad_samples.jsonl"
    BadSampleLog(path).record("one", SampleError("one.png: gone"))
    again = BadSampleLog(path)
    assert again.entries() == {}
    assert again.report() == ""
    again.record("two", SampleError("two.png: gone"))
    assert list(BadSampleLog(path, keep=True).entries()) == ["two"]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("heading_half_width_deg", -1),
        ("heading_half_width_deg", 181),
        ("heading_half_width_deg", float("nan")),
        ("heading_half_width_deg", "10"),
        ("ground_size", (320,)),
        ("ground_size", (0, 640)),
        ("ground_size", (1.5, 640)),
        ("aerial_size", 0),
        ("aerial_size", "512"),
        ("validation_fraction", 1.0),
        ("validation_fraction", -0.1),
        ("validation_fraction", "0.1"),
        ("seed", -1),
        ("split", "random"),
    ],
)
def test_settings_out_of_range_are_named(name, value):
    with pytest.raises(DatasetError, match=f"{name} is .*; it must be"):
        VigorConfig(root="data", **{name: value})


def test_an_unknown_part_is_named(make_vigor_tree, tmp_path):
    make_vigor_tree(tmp_path, pairs=1)
    with pytest.raises(DatasetError, match="part is 'val'; it must be one of train, validation"):
        open_vigor(tmp_path, "val")


def test_running_out_of_open_files_makes_no_sample_unreadable(make_kitti_tree, tmp_path):
    """Neither an image nor a text file is to blame, so none is written down as such."""
    make_kitti_tree(tmp_path / "data", pairs=1)
    config = KittiConfig(
        root=tmp_path / "data", ground_size=(32, 64), aerial_size=64, validation_fraction=0.0
    )
    bad_sample_log = BadSampleLog(tmp_path / "bad_samples.jsonl")
    dataset = PoseDataset(config, "test", bad_sample_log)
    assert dataset[0] is not None
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    held = []
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft if soft < 256 else 256, hard))
    try:
        with suppress(OSError):
            while True:
                held.append(os.open(__file__, os.O_RDONLY))
        with pytest.raises(OSError, match="Too many open files"):
            dataset[0]
        with pytest.raises(OSError, match="Too many open files"):
            read_lines(Path(__file__), "the file", "")
    finally:
        for file in held:
            os.close(file)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert not bad_sample_log.entries()
