"""Settings of a run: the paper's defaults, what is refused, and YAML."""

import numpy as np
import pytest
from slicematch.data.kitti import SHIFT_RANGE_M, camera_pose
from slicematch.errors import ConfigError
from slicematch.runs.config import TrainConfig


def test_the_defaults_for_vigor_are_the_papers():
    config = TrainConfig(data="vigor", root="data")
    assert (config.encoder, config.weights, config.stride) == ("vgg16", "imagenet", 16)
    assert (config.ground_size, config.aerial_size) == ((320, 640), 512)
    assert (config.train_grid, config.test_grid) == ("7x7x16", "21x21x64")
    assert (config.slices, config.alpha, config.tau) == (16, 4.0, 0.1)
    assert (config.learning_rate, config.batch_size) == (1e-5, 4)
    assert config.extent == (0.0, 0.0, 1.0, 1.0)
    assert config.heading_prior() is None


def test_the_defaults_for_kitti_are_the_papers():
    config = TrainConfig(data="kitti", root="data", heading_half_width_deg=10)
    assert (config.ground_size, config.aerial_size) == ((256, 1024), 512)
    assert (config.train_grid, config.test_grid) == ("5x5x16", "15x15x64")
    assert config.heading_prior() == (90.0, 10.0)


@pytest.mark.parametrize(
    ("prior", "low", "high"),
    [(0, 0.3, 0.7), (10, 0.26, 0.74), (45, 0.21, 0.79), (None, 0.21, 0.79)],
)
def test_kittis_grid_holds_every_camera(prior, low, high):
    config = TrainConfig(data="kitti", root="data", heading_half_width_deg=prior)
    assert config.extent == (low, low, high, high)
    reach = 180 if prior is None else prior
    places = [
        camera_pose(np.array([x, y]), turn)[:2]
        for x in (-SHIFT_RANGE_M, SHIFT_RANGE_M)
        for y in (-SHIFT_RANGE_M, SHIFT_RANGE_M)
        for turn in np.linspace(-reach, reach, 73)
    ]
    assert low <= np.min(places)
    assert np.max(places) <= high
    # No more than a hundredth of the tile is wasted.
    assert np.min(places) - low < 0.01


def test_yaml_there_and_back(tmp_path):
    config = TrainConfig(
        data="vigor",
        root="some/where",
        data_settings={"cities": ["Chicago"]},
        heading_half_width_deg=0,
        place_prior=(0.5, 0.5, 0.3),
        alpha=None,
        ground_size=[64, 128],
    )
    config.save(tmp_path / "config.yaml")
    assert TrainConfig.load(tmp_path / "config.yaml") == config


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"encodr": "vgg16"}, "setting 'encodr' is unknown; it must be one of data, root"),
        ({"data": None}, "setting 'data' is missing"),
        ({"data": "cvusa"}, "data is 'cvusa'; it must be one of vigor, kitti"),
        ({"slices": 0}, "slices is 0; it must be at least 1"),
        ({"slices": "16"}, "slices is '16'; it must be a whole number"),
        ({"slices": True}, "slices is True; it must be a whole number"),
        ({"tau": 0}, "tau is 0.0; it must be greater than 0"),
        ({"tau": float("nan")}, "tau is nan; it must be a finite number"),
        ({"tau": 10**400}, "tau is 1000.*; it must be a finite number"),
        ({"tau": "1e999"}, "tau is '1e999'; it must be a finite number"),
        ({"tau": "one"}, "tau is 'one'; it must be a finite number"),
        ({"seed": 5_000_000_000}, "seed is 5000000000; it must be from 0 to 4294967295"),
        ({"workers": -1}, "workers is -1; it must be at least 0"),
        ({"root": "a\0b"}, "root is 'a.*b'; it must be text without null characters"),
        ({"cities": ["a\0b"]}, "cities is .*; it must be a list of texts"),
        ({"hfov_deg": 400}, "hfov_deg is 400.0; it must be a number of degrees above 0 and up to"),
        ({"ground_fit": "stretch"}, "ground_fit is 'stretch'; it must be one of crop, resize"),
        ({"ground_size": [64]}, "ground_size is .64.; it must be a list of 2 whole numbers"),
        ({"train_grid": "7x7"}, "7x7"),
        ({"extent": [0.7, 0, 0.3, 1]}, "extent"),
        ({"heading_half_width_deg": 200}, "heading_half_width_deg is 200.0"),
        (
            {"split_dir": "elsewhere"},
            "setting 'split_dir' is unknown; it must be one of .*, labels",
        ),
        ({"cities": ["Gotham"]}, "Gotham"),
        ({"image_mean": [0.5]}, "image_mean is .0.5.; it must be a list of 3 finite numbers"),
        ({"image_std": [0.5, 0, 0.5]}, "image_std is .*; it must be three numbers greater than 0"),
        ({"tile_side_m": 0}, "tile_side_m is 0.0; it must be greater than 0"),
        ({"precision": "8"}, "precision is '8'; it must be one of 32-true"),
    ],
)
def test_invalid_settings_are_refused(settings, said):
    with pytest.raises(ValueError, match=said):
        TrainConfig.from_dict({"data": "vigor", "root": "data", **settings})


def test_yaml_numbers_as_the_help_prints_them(tmp_path):
    (tmp_path / "my.yaml").write_text("data: vigor\nroot: x\nlearning_rate: 1e-5\nalpha: 2\n")
    config = TrainConfig.load(tmp_path / "my.yaml")
    assert (config.learning_rate, config.alpha) == (1e-5, 2.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("- a\n- b\n", "holds no settings"),
        ("a: [", "is unreadable as YAML"),
        ("a: " + "1" * 5000, "is unreadable as YAML"),
        ("a: 2026-99-99", "is unreadable as YAML"),
        ("data: !!python/object/apply:os.system ['true']\n", "is unreadable as YAML"),
        ("data: vigor\nroot: x\nseed: -1\n", "seed is -1"),
        ('data: vigor\nroot: "\\0"\n', "root is .*without null characters"),
    ],
)
def test_files_that_are_no_settings(tmp_path, text, said):
    path = tmp_path / "my.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=said) as caught:
        TrainConfig.load(path)
    assert str(path) in str(caught.value)
