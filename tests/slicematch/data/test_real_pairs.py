"""Nine real panoramas with tiles, as a table: where the folder of them is there."""

import csv
import math
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from slicematch.data.dataset import PoseDataset
from slicematch.data.images import denormalise
from slicematch.data.table import TableConfig
from slicematch.data.table_files import write_table
from slicematch.runs.config import TrainConfig
from slicematch.training.train import train

PAIRS = Path(os.environ.get("SLICEMASK_REAL_PAIRS", "../shared/data/real_pairs"))
if not PAIRS.is_absolute():
    PAIRS = Path(__file__).parents[3] / PAIRS
pytestmark = pytest.mark.skipif(
    not (PAIRS / "pairs.csv").exists(), reason=f"{PAIRS} holds no real pairs"
)
SIZES = {"ground_size": (64, 128), "aerial_size": 128, "side_m": 60.0}
GPANO = (
    '<x:xmpmeta xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" '
    'GPano:ProjectionType="equirectangular" GPano:FullPanoWidthPixels="{width}" '
    'GPano:FullPanoHeightPixels="{full}" GPano:CroppedAreaImageWidthPixels="{width}" '
    'GPano:CroppedAreaImageHeightPixels="{height}" GPano:CroppedAreaLeftPixels="0" '
    'GPano:CroppedAreaTopPixels="{top}"/>'
)


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """The nine pairs as a table; bands of panoramas say in GPano data where they belong."""
    folder = tmp_path_factory.mktemp("real")
    with (PAIRS / "pairs.csv").open() as file:
        pairs = list(csv.DictReader(file))
    rows = []
    for pair in pairs:
        ground = PAIRS / pair["ground"]
        top_deg, bottom_deg = float(pair["top_deg"]), float(pair["bottom_deg"])
        if top_deg < 90:
            with Image.open(ground) as image:
                width, height = image.size
                full = width // 2
                top = round((90 - top_deg) / 180 * full)
                assert abs((top_deg - bottom_deg) / 180 * full - height) <= 1
                numbers = {"width": width, "height": height, "full": full, "top": top}
                ground = folder / pair["ground"]
                image.save(ground, quality=95, xmp=GPANO.format(**numbers).encode())
        rows.append(
            {name: pair[name] for name in ("id", "u", "v", "heading_deg", "metres_per_pixel")}
            | {"ground": str(ground), "tile": str(PAIRS / pair["aerial"])}
        )
    write_table(folder / "photos.csv", {name: [row[name] for row in rows] for name in rows[0]})
    return folder / "photos.csv"


def test_all_nine_are_samples(table):
    dataset = PoseDataset(TableConfig(root=table, **SIZES), "test")
    assert len(dataset) == 9
    assert dataset.tile_metres.tolist() == [60.0] * 9
    for sample in dataset:
        u, v, heading_deg = sample["pose"].tolist()
        # The camera is up to a quarter of the side off the centre where the tile has room: the
        # rural ones have 172 m, the others 73.
        room_m = 15.0 if sample["name"].startswith("rural") else (73.08 - 60.0) / 2
        assert max(abs(u - 0.5), abs(v - 0.5)) <= room_m / 60 + 1e-3
        assert 0 <= heading_deg < 360
        shown = denormalise(sample["ground"]).astype(int)
        if sample["name"].startswith("rural"):  # a band: the rest of the sphere is black
            assert shown[:17].max() < 10
            assert shown[42:].max() < 10
            assert shown[20:40].mean() > 40
        else:
            assert shown[:32].mean() > 40


def test_a_turned_panorama_is_the_same_one(table):
    free = PoseDataset(TableConfig(root=table, **SIZES), "test")
    north = PoseDataset(TableConfig(root=table, **SIZES, heading_half_width_deg=0), "test")
    for turned, still in zip(free, north, strict=True):
        columns = round(float(turned["pose"][2]) / 360 * 128)
        rolled = np.roll(still["ground"].numpy(), -columns, axis=-1)
        off = np.abs(rolled - turned["ground"].numpy()).mean()
        assert off < 0.35 * np.abs(np.roll(rolled, 40, axis=-1) - rolled).mean(), turned["name"]


@pytest.mark.slow
def test_a_run_learns_them_by_heart(table, tmp_path, cache):
    from slicematch.evaluation.evaluate import evaluate

    config = TrainConfig(
        data="table", root=str(table), encoder="test_resnet", weights="none", stride=8,
        data_settings={"side_m": 60.0, "shift_m": 15.0}, ground_size=(32, 128), aerial_size=96,
        heading_half_width_deg=0, train_grid="7x7x1", test_grid="7x7x1", learning_rate=3e-3,
        batch_size=9, epochs=40, validation_fraction=0.0, heat_map_every=0, workers=0,
        accelerator="cpu",
    )  # fmt: skip
    run = train(config, tmp_path / "run", cache=cache, progress=False)
    evaluation, _ = evaluate(run, part="train", refine="none", cache=cache, device="cpu")
    assert len(evaluation.names) == 9
    assert math.isfinite(evaluation.errors.place_m.mean())
    centre = 60 * np.hypot(*(evaluation.truths[:, :2] - 0.5).T)
    assert evaluation.errors.place_m.mean() < 0.8 * centre.mean()
