"""A run of panoramas is measured, and calibrated, on another data set than it was trained on."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from slicematch.app.examples import DataExamples
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


def calibrated(folder, cache, *arguments):
    """What the command gives."""
    options = ("--cache", cache, "--device", "cpu", "--workers", 0)
    arguments = ["calibrate", folder, *options, *arguments]
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def test_a_run_is_calibrated_on_rows_that_it_was_not_trained_on(run, cache, table, tmp_path):
    folder = RunFolder(shutil.copytree(run, tmp_path / "run"))
    # It has no validation part of its own.
    assert "validation_fraction 0" in calibrated(folder.path, cache).stderr
    result = calibrated(folder.path, cache, "--data", "table", "--root", table, "--json")
    assert result.exit_code == 0, result.output
    content = json.loads(result.stdout)
    assert (content["samples"], content["data"], content["part"]) == (5, "table", "train")
    assert content["root"] == "photos.csv"
    assert json.loads(folder.calibration_file.read_text()) == content
    given = {"data": "table", "root": str(table), "cache": cache, "device": "cpu", "workers": 0}
    assert calibrate(folder.path, **given)["temperature"] == content["temperature"]


def test_a_fit_that_cannot_be_read_goes_only_when_there_is_another(run, cache, table, tmp_path):
    folder = RunFolder(shutil.copytree(run, tmp_path / "run"))
    folder.calibration_file.write_text("{")
    result = calibrated(folder.path, cache, "--data", "table")
    assert (result.exit_code, folder.calibration_file.read_text()) == (1, "{")
    result = calibrated(folder.path, cache, "--data", "table", "--root", table)
    assert result.exit_code == 0, result.output
    assert json.loads(folder.calibration_file.read_text())["data"] == "table"


def test_a_run_is_measured_without_augmentation(run, cache, tmp_path):
    config = replace(RunFolder(run).load_config(), augment=True, restyle=0.5)
    folder = RunFolder(shutil.copytree(run, tmp_path / "run"))
    settings = {"part": "train", "cache": cache, "device": "cpu", "workers": 0}
    plain, _ = evaluate(folder.path, out=tmp_path / "plain", **settings)
    config.save(folder.config_file)
    augmented, _ = evaluate(folder.path, out=tmp_path / "augmented", **settings)
    np.testing.assert_array_equal(augmented.truths, plain.truths)
    np.testing.assert_array_equal(augmented.estimates, plain.estimates)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"data": "table"}, "data is 'table'.*'vigor'; name the root"),
        ({"data": "table", "root": ""}, "name the root"),
        ({"data": "kitti", "root": "{0}"}, "its images are pinhole ones.*whole panoramas"),
        ({"data": "oxford", "root": "{0}"}, "data is 'oxford'; it must be one of vigor"),
        ({"data": "own", "root": "{0}"}, "data is 'own'; it must be one of vigor"),
        ({"data": "table", "root": "{0}/no.csv"}, "no.csv"),
        ({"data_settings": {"map": "a.tif"}}, "setting 'map' is unknown to vigor"),
        ({"data_settings": {"cities": ["Seattle"]}}, "Seattle"),
        ({"data": "table", "root": "{1}", "split": "cross-area"}, "split is 'cross-area'"),
        ({"data": "table", "root": "{1}", "data_settings": {"side_m": 0}}, "side_m is 0"),
        ({"data": "table", "root": "{1}", "data_settings": {"side_m": 500}}, "500 m"),
        ({"data": "table", "root": "{1}", "dataset": [1]}, "data is 'table', and a dataset"),
        ({"root": "{1}", "dataset": [1]}, "root is .*, and a dataset"),
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
    if "split" not in given and ("data" in given or "dataset" in given):
        copy = shutil.copytree(run, tmp_path / "run")
        with pytest.raises((ConfigError, DatasetError, OSError), match=said):
            calibrate(copy, cache=cache, device="cpu", workers=0, **given)


@pytest.mark.parametrize(
    ("camera", "kind"),
    [
        (
            "projection: equirectangular, hfov_deg: 180",
            "parts of panoramas",
        ),
        ("projection: pinhole, hfov_deg: 70", "pinhole ones"),
    ],
)
def test_images_that_show_less_than_a_runs(run, vigor, table, tmp_path, camera, kind):
    rows = table.read_text().splitlines()
    other = tmp_path / "photos.csv"
    other.write_text("\n".join([rows[0] + ",camera", *(row + ",part" for row in rows[1:])]) + "\n")
    # Of the files only their names: none is opened here.
    (tmp_path / "cameras.yaml").write_text(f"part: {{{camera}, width: 128, height: 64}}\n")
    config = RunFolder(run).load_config()
    with pytest.raises(ConfigError, match=f"images are {kind}, and the run's are whole panoramas"):
        config.with_data("table", str(other))
    of_parts = TrainConfig(data="table", root=str(other))
    assert of_parts.with_data("table", "elsewhere.csv").root == "elsewhere.csv"
    with pytest.raises(ConfigError, match=f"whole panoramas, and the run's are {kind}"):
        of_parts.with_data("vigor", str(vigor.root))


def test_tiles_are_as_large_as_in_training_where_they_are_large_enough(vigor, table, mapped):
    run = TrainConfig(data="vigor", root=str(vigor.root), tile_side_m=60.0)
    assert run.with_data("table", str(table)).data_settings["side_m"] == 60.0
    # Its tiles of 71.2 m are a little smaller, and then much: none is left out for that.
    larger = replace(run, tile_side_m=75.0).with_data("table", str(table))
    assert larger.data_settings["side_m"] == 75.0
    much_larger = replace(run, tile_side_m=90.0).with_data("table", str(table))
    assert much_larger.data_settings["side_m"] == pytest.approx(640 * 0.111262)
    asked = run.with_data("table", str(table), {"side_m": 50.0})
    assert asked.data_settings["side_m"] == 50.0
    # A run of a table on VIGOR, whose tiles are as they are.
    of_table = TrainConfig(data="table", root=str(table), tile_side_m=60.0)
    on_vigor = of_table.with_data("vigor", str(vigor.root), {"cities": ["Chicago"]})
    assert on_vigor.data_config().cities == ("Chicago",)
    assert set(on_vigor.data_settings) == {"labels", "cities"}


def test_on_a_map_alone_tiles_are_as_large_as_in_training(mapped, tmp_path):
    pytest.importorskip("rasterio")
    rows = ["id,ground,lat,lon,heading_deg"]
    rows += [
        f"{name},{mapped.folder / name},{lat},{lon},{heading_deg}"
        for name, (lat, lon, heading_deg) in mapped.poses.items()
    ]
    photos = tmp_path / "photos.csv"
    photos.write_text("\n".join(rows) + "\n")
    run = TrainConfig(data="vigor", root="city", tile_side_m=60.0, aerial_size=64)
    on_map = run.with_data("table", str(photos), {"map": str(mapped.map)})
    samples = on_map.dataset("test")
    assert len(samples) == len(mapped.poses)
    assert set(samples.tile_metres) == {60.0}


def test_a_page_shows_images_of_a_run_that_was_trained_in_other_styles(run):
    config = replace(RunFolder(run).load_config(), augment=True, restyle=0.5)
    assert len(DataExamples(config)) == 5
