"""From a generated city to answers on its map, by the commands of docs/own-data.md."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from slicemask.cli.main import main

pytest.importorskip("trimesh")
pytest.importorskip("rasterio")
geopandas = pytest.importorskip("geopandas")

from slicematch.runs.folder import RunFolder  # noqa: E402

from slicemask.synth import generate_table  # noqa: E402

TINY = [
    "--encoder=test_resnet", "--weights=none", "--stride=8", "--batch-size=2", "--slices=8",
    "--ground-size=32,64", "--aerial-size=64", "--train-grid=3x3x4", "--test-grid=5x5x8",
    "--epochs=1", "--validation-fraction=0.4", "--workers=0", "--accelerator=cpu",
    "--heat-map-every=0",
]  # fmt: skip


@pytest.fixture(scope="module")
def city(tmp_path_factory):
    root = tmp_path_factory.mktemp("city") / "own"
    generate_table(
        root,
        panoramas=8,
        seed=2,
        panorama_size=(64, 32),
        image_size=(64, 48),
        tile_size=128,
        jobs=1,
    )
    return root


@pytest.fixture
def slicemask(cache, monkeypatch):
    monkeypatch.setenv("SLICEMASK_CACHE", str(cache))

    def run(*arguments):
        done = CliRunner().invoke(main, [str(argument) for argument in arguments])
        assert done.exit_code == 0, done.output
        return done.stdout

    return run


@pytest.mark.slow
@pytest.mark.parametrize("table", ["photos", "front"])
def test_train_evaluate_calibrate_and_locate(city, slicemask, tmp_path, table):
    run = tmp_path / "run"
    slicemask("train", "--data=table", f"--root={city / table}.csv", "--out", run, *TINY)
    config = RunFolder(run).load_config()
    assert config.tile_side_m == config.data_settings["side_m"] == 70.0
    if table == "front":
        # 50 pixels of focal length, and the principal point at 36 of 64.
        edges = np.degrees(np.arctan(np.array([-36.0, 28.0]) / 50.0))
        offsets = config.frustum().edge_offsets_deg()
        np.testing.assert_allclose(offsets[[0, -1]], edges)
        assert config.frustum().principal_point == pytest.approx(36 / 64)
    result = json.loads(slicemask("evaluate", run, "--device=cpu", "--json"))
    assert result["samples"] == 4
    moved = tmp_path / "elsewhere.csv"
    lines = (city / f"{table}.csv").read_text().splitlines()
    folder = "panoramas" if table == "photos" else "front"
    moved.write_text("\n".join(line.replace(f",{folder}/", f",{city}/{folder}/") for line in lines))
    (tmp_path / "cameras.yaml").write_text((city / "cameras.yaml").read_text())
    arguments = ["--root", moved, "--map", city / "map.tif", "--out", tmp_path / "again"]
    again = json.loads(slicemask("evaluate", run, "--device=cpu", "--json", *arguments))
    assert again["errors"] == result["errors"]
    assert json.loads(slicemask("calibrate", run, "--device=cpu", "--json"))["samples"] == 2
    answers = tmp_path / "answers.gpkg"
    slicemask(
        "locate", run, city / folder, "--map", city / "map.tif", "--out", answers, "--device=cpu"
    )
    found = geopandas.read_file(answers)
    assert len(found) == 8
    slicemask(
        "locate", run, moved, "--map", city / "map.tif", "--out", tmp_path / "b.csv",
        "--device=cpu",
    )  # fmt: skip
