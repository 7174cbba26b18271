"""A run of panoramas is measured, and calibrated, on another data set than it was trained on."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from slicematch.data.errors import DatasetError
from slicematch.data.to_table import table_from_vigor
from slicematch.errors import ConfigError
from slicematch.evaluation.calibration import calibrate
from slicematch.evaluation.evaluate import evaluate
from slicematch.runs.config import TrainConfig
from slicematch.runs.folder import RunFolder

from slicemask.cli.main import main


@pytest.fixture(scope="module")
def table(vigor, tmp_path_factory):
    """The pairs of the run's tree, as a table."""
    out = tmp_path_factory.mktemp("table") / "photos.csv"
    return table_from_vigor(vigor.root, out, cities=("Chicago",)).path


def test_the_same_pairs_in_a_table_give_the_same_answers(run, cache, vigor, table, tmp_path):
    settings = {"cache": cache, "device": "cpu", "heading_half_width_deg": 0.0, "workers": 0}
    of_tree, _ = evaluate(run, out=tmp_path / "tree", **settings)
    of_table, _ = evaluate(run, data="table", root=str(table), out=tmp_path / "table", **settings)
    # The tree lists the same pairs for training, so that a table counts them.
    assert [name.removesuffix("#2") for name in of_table.names] == of_tree.names
    np.testing.assert_allclose(of_table.truths, of_tree.truths, atol=1e-12)
    np.testing.assert_allclose(of_table.tile_metres, of_tree.tile_metres)
    np.testing.assert_allclose(of_table.estimates, of_tree.estimates, atol=1e-3)
    assert (of_tree.settings["data"], of_table.settings["data"]) == ("vigor", "table")
    # Both are searched as the run was trained: in tiles of its size.
    assert of_table.settings["data_settings"]["side_m"] == of_tree.tile_metres[0]


def test_from_the_command(slicemask, run, vigor, table, tmp_path):
    result = slicemask(
        "evaluate", "--data", "table", "--root", table, "--workers", 0, "--limit", 3, "--json"
    )
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert summary["folder"] == str(run / "evaluation" / "table_same-area_test_4x5x8_best_mean_3")
    # The run's own data, in other cities than it was trained on.
    result = slicemask("evaluate", "--cities", "Seattle", "--out", tmp_path / "out")
    assert result.exit_code == 1
    assert "Seattle" in result.stderr
    assert not (tmp_path / "out").exists()


def test_a_run_is_calibrated_on_another_data_set(run, cache, table, tmp_path):
    folder = RunFolder(shutil.copytree(run, tmp_path / "run"))
    replace(folder.load_config(), validation_fraction=0.6).save(folder.config_file)
    other = {"data": "table", "root": str(table), "cache": cache, "device": "cpu", "workers": 0}
    content = calibrate(folder.path, **other)
    assert content["samples"] == 3
    assert json.loads(folder.calibration_file.read_text()) == content
    arguments = ["calibrate", folder.path, "--data", "table", "--root", table, "--json"]
    arguments += ["--cache", cache, "--device", "cpu", "--workers", 0]
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["temperature"] == pytest.approx(content["temperature"])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"data": "table"}, "data is 'table'.*'vigor'; name the root"),
        ({"data": "kitti", "root": "{0}"}, "only panoramas go with a run"),
        ({"data": "oxford", "root": "{0}"}, "data is 'oxford'; it must be one of vigor"),
        ({"data": "table", "root": "{0}/no.csv"}, "no.csv"),
        ({"data_settings": {"map": "a.tif"}}, "setting 'map' is unknown to vigor"),
        ({"data": "table", "root": "{1}", "split": "cross-area"}, "split is 'cross-area'"),
        ({"data": "table", "root": "{1}", "data_settings": {"side_m": 0}}, "side_m is 0"),
        ({"data": "table", "root": "{1}", "data_settings": {"side_m": 500}}, "500 m"),
        ({"data": "table", "root": "{1}", "dataset": [1]}, "dataset of the program's own"),
    ],
)
def test_data_that_do_not_go_with_a_run(run, cache, table, tmp_path, changes, said):
    given = {
        name: value.format(tmp_path, table) if isinstance(value, str) else value
        for name, value in changes.items()
    }
    with pytest.raises((ConfigError, DatasetError, OSError), match=said):
        evaluate(run, cache=cache, device="cpu", workers=0, out=tmp_path / "out", **given)
    assert not (tmp_path / "out").exists()


def test_runs_of_cameras_take_their_own_data_alone():
    config = TrainConfig(data="kitti", root="drives", hfov_deg=81.5)
    assert config.with_data("kitti", "elsewhere").root == "elsewhere"
    with pytest.raises(ConfigError, match="cameras with their own alone"):
        config.with_data("table", "photos.csv")
