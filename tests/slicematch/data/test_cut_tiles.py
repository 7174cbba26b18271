"""Tiles of a table, cut from a map."""

import json

import numpy as np
import pandas
import pytest
from click.testing import CliRunner
from PIL import Image
from slicematch.data.cut_tiles import cut_tiles
from slicematch.data.dataset import PoseDataset
from slicematch.data.errors import DatasetError
from slicematch.data.maps import AerialMap
from slicematch.data.table import TableConfig

from slicemask.cli.main import main
from slicemask.errors import OutputError

pytest.importorskip("rasterio")


@pytest.fixture
def table(mapped, tmp_path):
    """A table of the mapped photographs, with one that the map does not show."""
    names = sorted(mapped.poses)
    rows = pandas.DataFrame(
        {
            "ground": [str(mapped.folder / name) for name in [*names, names[0]]],
            "lat": [*(mapped.poses[name][0] for name in names), 48.0],
            "lon": [*(mapped.poses[name][1] for name in names), 2.0],
            "heading_deg": [*(mapped.poses[name][2] for name in names), 0.0],
            "weather": "dry",
        }
    )
    rows.to_csv(tmp_path / "photos.csv", index=False)
    return tmp_path / "photos.csv"


def test_the_new_table_trains_without_the_map(table, mapped, tmp_path):
    cut = cut_tiles(table, mapped.map, tmp_path / "cut", side_m=60.0, pixels=120)
    assert (cut.rows, cut.tiles) == (6, 6)
    assert [one["row"] for one in cut.left_out] == [f"{table}, line 8"]
    assert "does not show 48.0000" in cut.report()
    written = pandas.read_csv(cut.table)
    assert (written["weather"] == "dry").all()
    dataset = PoseDataset(
        TableConfig(root=cut.table, side_m=40.0, shift_m=5.0, ground_size=(32, 64), aerial_size=80),
        "test",
    )
    opened = AerialMap.open(mapped.map)
    for index in range(6):
        u, v, _ = dataset.pose(index)
        _, aerial = dataset.load(index)
        # The camera's own surroundings, in both: a tile around it, and the one that it stands in.
        row = written.iloc[index]
        around = opened.cut(row["lat"], row["lon"], 10.0, 20).image.astype(float)
        column, line = round(u * 80), round(v * 80)
        mean, std = (np.array(values) for values in ([0.485, 0.456, 0.406], [0.229, 0.224, 0.225]))
        shown = aerial.numpy().transpose(1, 2, 0) * std + mean
        shown = shown[line - 10 : line + 10, column - 10 : column + 10] * 255
        assert np.abs(shown - around).mean() < 12


def test_repeated_it_keeps_what_is_there(table, mapped, tmp_path):
    options = {"side_m": 60.0, "pixels": 60, "shared_m": 30.0}
    cut = cut_tiles(table, mapped.map, tmp_path / "cut", **options)
    files = sorted((tmp_path / "cut" / "tiles").iterdir())
    assert len(files) == cut.tiles <= 6
    Image.new("RGB", (60, 60)).save(files[0])
    files[1].unlink()
    black = files[0].read_bytes()
    cut_tiles(table, mapped.map, tmp_path / "cut", **options)
    assert files[0].read_bytes() == black
    assert files[1].is_file()
    with pytest.raises(OutputError, match="holds tiles that were cut otherwise"):
        cut_tiles(table, mapped.map, tmp_path / "cut", side_m=50.0)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "a.txt").write_text("mine")
    with pytest.raises(OutputError, match="is not empty and holds no tiles"):
        cut_tiles(table, mapped.map, tmp_path / "other")


def test_a_table_of_elsewhere_is_refused(mapped, tmp_path):
    (tmp_path / "t.csv").write_text("ground,lat,lon\na.jpg,48,2\n")
    with pytest.raises(DatasetError, match=r"none of its rows has a tile in the map; first: .*48"):
        cut_tiles(tmp_path / "t.csv", mapped.map, tmp_path / "cut")


def test_the_command(table, mapped, tmp_path):
    out = tmp_path / "cut"
    arguments = ["tiles", table, "--map", mapped.map, "--out", out, "--tile-side", "60m"]
    arguments += ["--pixels", "50", "--share-tiles", "0", "--json"]
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    content = json.loads(result.stdout)
    assert (content["rows"], len(content["left_out"])) == (6, 1)
    assert Image.open(next((out / "tiles").iterdir())).size == (50, 50)
