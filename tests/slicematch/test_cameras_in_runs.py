"""Fields of view and principal points in runs: settings, training, and answers."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image
from slicematch.localization.localizer import Localizer
from slicematch.localization.predict import predict
from slicematch.runs.config import TrainConfig
from slicematch.runs.folder import RunFolder
from slicematch.training.train import train

from slicemask import Frustum

TINY = {
    "encoder": "test_convnext",
    "weights": "none",
    "aerial_size": 64,
    "slices": 4,
    "train_grid": "2x2x4",
    "test_grid": "3x3x4",
    "epochs": 1,
    "batch_size": 2,
    "validation_fraction": 0.0,
    "heat_map_every": 0,
    "workers": 0,
    "accelerator": "cpu",
}


def test_a_cut_panorama_has_as_many_pixels_a_degree(vigor):
    sizes = {
        hfov_deg: TrainConfig(data="vigor", root=str(vigor.root), hfov_deg=hfov_deg).ground_size
        for hfov_deg in (None, 360, 180, 90, 70)
    }
    assert sizes == {
        None: (320, 640), 360: (320, 640), 180: (320, 320), 90: (320, 160), 70: (320, 128),
    }  # fmt: skip
    config = TrainConfig(data="vigor", root="x", hfov_deg=180, ground_size=(64, 96))
    assert config.ground_size == (64, 96)
    assert config.frustum() == Frustum(180, 16)


def test_a_run_on_cut_panoramas(vigor, cache, images, tmp_path):
    own = {"cities": ["Chicago"]}
    config = TrainConfig(
        data="vigor", root=str(vigor.root), data_settings=own, hfov_deg=180, ground_size=(32, 32),
        bands=(6, 12), **TINY,
    )  # fmt: skip
    run = train(config, tmp_path / "run", cache=cache, progress=False)
    localizer = Localizer.load(run, cache=cache, device="cpu")
    assert localizer.frustum.hfov_deg == 180
    found = localizer.localize(*images)
    # An image of the field of view alone is answered as the panorama that it was cut from.
    panorama = Image.open(images[0])
    middle = panorama.crop((panorama.width // 4, 0, 3 * panorama.width // 4, panorama.height))
    assert np.abs(localizer.localize(middle, images[1]).scores - found.scores).max() < 0.02
    picture = tmp_path / "answer.png"
    predict(run, *images, cache=cache, device="cpu", out=picture)
    assert picture.exists()


def test_a_run_on_kitti_keeps_the_camera_of_its_calibration(make_kitti_tree, cache, tmp_path):
    tree = make_kitti_tree(tmp_path / "kitti", pairs=3)
    config = TrainConfig(
        data="kitti", root=str(tree.root), ground_size=(32, 64), heading_half_width_deg=10,
        augment=True, **TINY,
    )  # fmt: skip
    run = train(config, tmp_path / "run", cache=cache, progress=False)
    kept = RunFolder(run).load_config()
    left_deg, right_deg = tree.edges_deg
    assert (kept.left_deg, kept.left_deg + kept.hfov_deg) == pytest.approx((left_deg, right_deg))
    assert kept.horizon == pytest.approx(172.854 / 375)
    assert kept.frustum().principal_point == pytest.approx(609.5593 / 1242)
    # The run's camera is no longer read from the data.
    (tree.root / "raw_data" / "2011_09_26" / "calib_cam_to_cam.txt").unlink()
    dataset = kept.dataset("train")
    assert (dataset.hfov_deg, dataset.left_deg) == (kept.hfov_deg, kept.left_deg)
    assert train(replace(kept, epochs=2), run, resume=True, cache=cache, progress=False) == run

    ground, aerial = (
        next(path for path in tree.root.rglob("*.png") if folder in str(path))
        for folder in ("image_02", "satmap")
    )
    localizer = Localizer.load(run, cache=cache, device="cpu")
    found = localizer.localize(ground, aerial)
    # Images of other proportions are cut about the horizon, and not refused.
    taller = Image.new("RGB", (414, 165))
    taller.paste(Image.open(ground), (0, round(40 * kept.horizon)))
    again = localizer.localize(taller, aerial)
    within = np.isfinite(found.scores)  # the heading prior leaves out the others
    assert within.any()
    assert np.array_equal(within, np.isfinite(again.scores))
    assert np.abs(again.scores[within] - found.scores[within]).max() < 0.1


def test_a_kitti_run_of_before_has_a_centred_camera(make_kitti_tree, tmp_path):
    """It holds a field of view and neither a left edge nor a horizon."""
    tree = make_kitti_tree(tmp_path, pairs=1)
    config = TrainConfig(
        data="kitti", root=str(tree.root), hfov_deg=81.44, ground_size=(32, 64), elevations=(-9, 9)
    )
    assert config.frustum() == Frustum(81.44, 16, "pinhole")
    dataset = config.dataset("test")
    assert (dataset.hfov_deg, dataset.left_deg, dataset.horizon) == (81.44, None, 0.5)
    (path,) = (file for file in tree.root.rglob("*.png") if "image_02" in str(file))
    image = Image.open(path)
    half = np.tan(np.radians(9)) / np.tan(np.radians(81.44 / 2)) * image.width / 2
    box = (0, image.height / 2 - half, image.width, image.height / 2 + half)
    size = image.width, round(2 * half)
    expected = image.resize(size, Image.Resampling.BILINEAR, box=box)
    expected = expected.resize((64, 32), Image.Resampling.BILINEAR)
    mean, std = (torch.tensor(values)[:, None, None] for values in config.normalisation())
    found = (dataset[0]["ground"] * std + mean) * 255
    assert np.abs(found.permute(1, 2, 0).numpy() - np.asarray(expected)).max() < 1.01
