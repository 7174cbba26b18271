"""Samples of a program's own: what `train` and `evaluate` take, and the documentation's example."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from slicematch import PoseDataset, TrainConfig, evaluate, train
from slicematch.data.dataset import BadSampleLog
from slicematch.data.errors import DatasetError, SampleError
from slicematch.data.images import denormalise
from slicematch.errors import ConfigError
from slicematch.runs.folder import RunFolder
from torch.utils.data import Dataset

PAGE = Path(__file__).parents[3] / "docs" / "own-data.md"
TINY = {
    "data": "own", "projection": "equirectangular", "encoder": "test_convnext", "weights": "none",
    "ground_size": (32, 64), "aerial_size": 64, "slices": 4, "train_grid": "3x3x4",
    "test_grid": "4x5x8", "epochs": 1, "batch_size": 2, "heat_map_every": 0, "workers": 0,
    "accelerator": "cpu",
}  # fmt: skip


class Samples(Dataset):
    """Random pairs; `kind` is what the images are handed over as."""

    def __init__(self, count=4, kind="array", **changes):
        self.count, self.kind, self.changes = count, kind, changes
        self.calls = 0

    def __len__(self):
        return self.count

    def __getitem__(self, index):
        self.calls += 1
        rng = np.random.default_rng(index)
        images = [
            rng.integers(0, 256, shape, dtype=np.uint8) for shape in ((40, 80, 3), (50, 50, 3))
        ]
        if self.kind == "tensor":
            images = [torch.from_numpy(image).permute(2, 0, 1) for image in images]
        elif self.kind == "float tensor":
            images = [torch.from_numpy(image).permute(2, 0, 1) / 255 for image in images]
        elif self.kind == "pil":
            images = [Image.fromarray(image) for image in images]
        pose = torch.tensor([0.25, 0.75, 10.0 * index])
        sample = {"ground": images[0], "aerial": images[1], "pose": pose, "metres_per_pixel": 0.4}
        return sample | self.changes


def own(samples, part="test", **settings):
    return TrainConfig(**TINY | settings).own_dataset(samples, part)


@pytest.mark.parametrize("kind", ["array", "tensor", "float tensor", "pil"])
def test_items_become_samples_of_the_run(kind):
    samples = Samples(kind=kind)
    dataset = own(samples)
    assert isinstance(dataset, PoseDataset)
    sample = dataset[2]
    assert sample["pose"].tolist() == [0.25, 0.75, 20.0]
    assert sample["metres_per_pixel"] == pytest.approx(50 * 0.4 / 64)
    assert (sample["name"], sample["index"]) == ("2", 2)
    expected = samples[2] if kind == "pil" else Samples(kind="pil")[2]
    for key, size in (("ground", (64, 32)), ("aerial", (64, 64))):
        shown = np.asarray(expected[key].resize(size, Image.Resampling.BILINEAR))
        np.testing.assert_array_equal(denormalise(sample[key]), shown)


def test_a_sample_is_one_call():
    samples = Samples()
    dataset = own(samples, "train")
    before = samples.calls
    assert dataset[1]["pose"].tolist() == [0.25, 0.75, 10.0]
    assert samples.calls == before + 1


def test_augmentation_holds_for_them_too(true_colours):
    dataset = own(Samples(), "train", augment=True)
    poses = set()
    for epoch in range(12):
        dataset.set_epoch(epoch)
        poses.add(tuple(dataset[1]["pose"].tolist()))
    assert len(poses) > 4
    assert {abs(u - 0.5) for u, _, _ in poses} == {0.25}


def test_names_and_unreadable_files(tmp_path):
    samples = Samples(2, ground=tmp_path / "none.jpg")
    samples.names = ["left", "right"]
    dataset = own(samples)
    with pytest.raises(SampleError, match=r"sample 0 of the data set: ground: .*no such image"):
        dataset[0]
    dataset.bad_sample_log = BadSampleLog(tmp_path / "bad.jsonl")
    assert dataset[1] is None
    assert list(dataset.bad_sample_log.entries()) == ["right"]


@pytest.mark.parametrize(
    ("samples", "said"),
    [
        (iter([]), "is of type list_iterator; it must be a torch Dataset"),
        (Samples(0), "holds no sample"),
        ([1, 2], "sample 0 of the data set: is int; expected a dict of ground, aerial, pose, metr"),
        ([{"ground": 1}], "is ground; expected a dict of ground, aerial, pose"),
        (Samples(metres_per_pixel=0), "metres_per_pixel is 0; it must be that of the aerial image"),
        (Samples(metres_per_pixel=None), "metres_per_pixel is None"),
        (Samples(pose=[2.0, 0.5, 0.0]), r"pose: pose 0 lies outside the tile: u=2"),
        (Samples(pose=[0.5, 0.5]), r"pose: poses have shape \[1, 2\]"),
        (Samples(aerial=np.zeros((50, 60, 3), np.uint8)), "aerial is 60x50 pixels; it must be squ"),
    ],
)
def test_data_sets_that_are_none(samples, said):
    with pytest.raises(DatasetError, match=said):
        own(samples)[0]


def test_the_field_of_view_of_a_pinhole_camera_must_be_known():
    with pytest.raises(ConfigError, match="hfov_deg is None; of a program's own pinhole images"):
        own(Samples(), projection="pinhole")


def test_samples_go_with_their_own_settings(tmp_path):
    with pytest.raises(ConfigError, match=r"data is 'vigor'; .*go with data 'own'"):
        train(TrainConfig(**TINY | {"data": "vigor", "root": "x"}), tmp_path, dataset=Samples())
    with pytest.raises(ConfigError, match="data is 'own'"):
        train(TrainConfig(**TINY), tmp_path)
    with pytest.raises(ConfigError, match="root is ''; it must be a folder or a table"):
        TrainConfig(data="vigor")


def test_without_validation_and_resumed(tmp_path, cache):
    config = TrainConfig(**TINY)
    run = train(config, tmp_path / "run", dataset=Samples(), cache=cache, progress=False)
    longer = TrainConfig(**TINY | {"epochs": 2})
    train(longer, run, dataset=Samples(), resume=True, cache=cache, progress=False)
    assert [line["epoch"] for line in RunFolder(run).load_metrics()] == [0, 1]
    assert RunFolder(run).load_config().tile_side_m == pytest.approx(20.0)
    assert not (run / "calibration.json").exists()
    with pytest.raises(DatasetError, match=r"come from a program's own data set; hand its test p"):
        evaluate(run, cache=cache, device="cpu")


def test_a_run_on_vigor_is_evaluated_on_samples_of_one_s_own(run, cache, tmp_path):
    samples = Samples(3, metres_per_pixel=71.2 / 50)
    evaluation, folder = evaluate(
        run, dataset=samples, cache=cache, device="cpu", out=tmp_path / "results"
    )
    assert evaluation.truths[:, 2].tolist() == [0.0, 10.0, 20.0]
    assert evaluation.settings["data"] == "own"
    assert (folder / "samples.csv").read_text().count("\n") == 4


def test_the_page_s_example_runs_as_written(tmp_path, monkeypatch):
    (block,) = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), re.DOTALL | re.MULTILINE)
    assert len(block.splitlines()) < 30
    rng = np.random.default_rng(0)
    for part, count in {"train": 4, "validation": 2, "test": 2}.items():
        folder = tmp_path / "drive" / part
        folder.mkdir(parents=True)
        with (folder / "poses.csv").open("w") as file:
            writer = csv.writer(file)
            writer.writerow(["image", "tile", "u", "v", "heading_deg"])
            for number in range(count):
                names = f"image{number}.png", f"tile{number}.png"
                for name, shape in zip(names, ((48, 96, 3), (120, 120, 3)), strict=True):
                    pixels = rng.integers(0, 256, shape, dtype=np.uint8)
                    Image.fromarray(pixels).save(folder / name)
                writer.writerow([*names, 0.4, 0.6, 30.0 * number])
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(compile(block, PAGE.name, "exec"), names)
    assert len(names["evaluation"].names) == 2
    assert names["evaluation"].truths[:, 2].tolist() == [0.0, 30.0]
    config = RunFolder(Path("runs/drive")).load_config()
    assert (config.data, config.hfov_deg, config.tile_side_m) == ("own", 90.0, 30.0)
    assert Path("runs/drive/calibration.json").exists()
