"""Recipes: sets of settings that a run starts from, kept in it."""

import pytest
from slicematch.data import config_class
from slicematch.errors import ConfigError
from slicematch.runs.config import TrainConfig
from slicematch.runs.folder import RunFolder, plan_run
from slicematch.runs.recipes import RECIPES
from slicematch.runs.shipped import find_run

VIGOR = {"data": "vigor", "root": "data"}
KITTI = {"data": "kitti", "root": "data"}


@pytest.mark.parametrize("settings", [VIGOR, KITTI])
def test_the_papers_recipe_is_the_defaults(settings):
    assert TrainConfig.from_dict({**settings, "recipe": "paper"}) == TrainConfig(**settings)


def test_the_fast_recipe_is_the_network_that_ships():
    fast = TrainConfig.from_dict({**VIGOR, "recipe": "fast"})
    shipped = RunFolder(find_run("generated-city")).load_config()
    # Which schedule and how many epochs a run takes is its own affair.
    for name in (*RECIPES["fast"].settings, "elevations"):
        assert getattr(fast, name) == getattr(shipped, name), name


def test_what_is_asked_for_goes_before_the_recipe():
    fast = TrainConfig.from_dict({**VIGOR, "recipe": "fast", "slices": 8, "elevations": None})
    assert (fast.slices, fast.elevations, fast.encoder) == (8, None, "tf_efficientnet_lite0")


def test_panoramas_are_cropped_and_camera_images_are_not():
    assert TrainConfig.from_dict({**VIGOR, "recipe": "fast"}).elevations == (-30.0, 30.0)
    kitti = TrainConfig.from_dict({**KITTI, "recipe": "fast"})
    assert (kitti.elevations, kitti.bands) == (None, (6.0, 12.0, 24.0))
    assert kitti.train_grid == config_class("kitti").train_grid


@pytest.mark.parametrize("name", ["Fast", "quick", "", None, 3, ["fast"]])
def test_there_is_no_other_recipe(name):
    with pytest.raises(ConfigError, match=r"recipe is .*; it must be paper or fast"):
        TrainConfig.from_dict({**VIGOR, "recipe": name})


def test_a_file_of_settings_may_name_a_recipe(tmp_path):
    file = tmp_path / "run.yaml"
    file.write_text("recipe: fast\ndata: vigor\nroot: data\nslices: 16\n")
    config, _ = plan_run({"epochs": 2}, file)
    assert (config.stride, config.slices, config.epochs) == (8, 16, 2)
    paper, _ = plan_run({"recipe": "paper"}, file)  # the command goes before the file
    assert (paper.stride, paper.slices) == (16, 16)


def test_a_run_that_goes_on_keeps_its_settings(tmp_path):
    fast = TrainConfig.from_dict({**VIGOR, "recipe": "fast", "slices": 8})
    fast.save(RunFolder(tmp_path).config_file)
    same, _ = plan_run({"recipe": "fast", "slices": 8}, None, tmp_path, resume=True)
    assert same == fast
    bare, _ = plan_run({}, None, tmp_path, resume=True)
    assert bare == fast


def test_a_recipe_is_not_lost_on_a_run_of_another(tmp_path):
    # Training then refuses to go on, and names what differs.
    TrainConfig(**VIGOR).save(RunFolder(tmp_path).config_file)
    config, _ = plan_run({"recipe": "fast"}, None, tmp_path, resume=True)
    assert (config.encoder, config.elevations) == ("tf_efficientnet_lite0", (-30.0, 30.0))
