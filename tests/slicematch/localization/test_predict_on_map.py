"""One photograph on a map."""

import json

import pandas
import pytest
from click.testing import CliRunner
from PIL import Image
from slicematch import Priors, predict_on_map
from slicematch.data.errors import SampleError
from slicematch.data.maps import AerialMap
from slicematch.errors import ConfigError
from slicematch.localization.geodesy import offset_position

from slicemask.cli.main import main

pytest.importorskip("rasterio")


@pytest.fixture
def call(run, cache, mapped):
    """Run `slicemask predict` on the map; give its result."""
    photo = sorted(mapped.folder.iterdir())[0]

    def invoke(*arguments, ground=photo):
        arguments = ["predict", run, "--ground", ground, *arguments]
        arguments += ["--cache", cache, "--device", "cpu"]
        return CliRunner().invoke(main, [str(argument) for argument in arguments])

    return invoke


def test_the_answer_is_that_of_the_tile_around_the_place(call, mapped, localizer, tmp_path):
    near, side_m = (51.9991, 4.3733), localizer.tile_side_m
    result = call(
        "--map", mapped.map, "--near", "51.9991,4.3733", "--within", "30m", "--heading", "90+-60",
        "--json", "--geojson", tmp_path / "a.geojson", "--out", tmp_path / "a.png",
        "--answers", tmp_path / "a.csv",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    content = json.loads(result.stdout)
    tile = AerialMap.open(mapped.map).cut(*near, side_m, 64)
    photo = sorted(mapped.folder.iterdir())[0]
    prior = (0.5, 0.5, 30 / side_m)
    expected = localizer.localize(
        photo, tile.image, (90.0, 60.0), prior, metres_per_pixel=side_m / 64
    )
    assert (content["u"], content["v"]) == pytest.approx(tuple(expected.pose[:2]), abs=1e-6)
    place = offset_position(near, *expected.offset_m(side_m / 64))
    assert (content["latitude"], content["longitude"]) == pytest.approx(place, abs=1e-9)
    x, y = AerialMap.open(mapped.map).to_map([place[0]], [place[1]])
    assert (content["x"], content["y"]) == pytest.approx((x[0], y[0]), abs=1e-3)
    assert content["crs"] == "EPSG:32631"
    assert (tmp_path / "a.png").stat().st_size > 10_000
    points = json.loads((tmp_path / "a.geojson").read_text())["features"]
    assert points[0]["geometry"]["coordinates"] == [content["longitude"], content["latitude"]]
    (row,) = pandas.read_csv(tmp_path / "a.csv").to_dict("records")
    assert (row["lat"], row["lon"]) == pytest.approx(place, abs=1e-8)
    assert (row["prior_within_m"], row["prior_heading_half_width_deg"]) == (30.0, 60.0)
    text = call("--map", mapped.map).stdout
    assert "on the map at" in text
    assert "(EPSG:32631)" in text


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([], "Missing option '--aerial', or '--map'"),
        (["--near", "1,2"], "Missing option '--aerial', or '--map'"),
        (["--aerial", "a.png", "--map", "{map}"], "--aerial and --map both say where"),
        (["--aerial", "a.png", "--within", "5m"], "--within goes with --map"),
        (["--map", "{map}", "--centre", "1,2"], "--centre goes with --aerial; with --map, say"),
        (["--map", "{map}", "--near", "48.8,2.3"], "does not show 48.800000,2.300000"),
        (["--map", "{map}", "--near", "4.3735,51.9990"], "if the two are swapped, give 51.999000"),
        (["--map", "{map}", "--near", "91,0"], "the place is 91,0; it must be a latitude"),
        (["--map", "{map}", "--within", "0m"], "within is 0 m; it must be above 0"),
        (["--map", "{map}", "--within", "0.1m"], "no candidate pose agrees"),
        (["--map", "{map}", "--heading", "0+-181"], "headings are within 181 degrees"),
        (["--map", "{map}", "--tile-side", "190m"], "may differ 2 times at most"),
        (["--map", "none.tif"], "there is no such file; name a map"),
        (["--map", "{map}", "--answers", "a.xlsx"], "its suffix is .xlsx"),
    ],
)
def test_what_is_refused(call, mapped, options, said):
    result = call(*(option.format(map=mapped.map) for option in options))
    assert result.exit_code != 0
    assert said in result.stderr
    assert "Traceback" not in result.output


def test_a_photograph_that_says_nothing_of_its_place(call, run, mapped, tmp_path):
    Image.new("RGB", (128, 64)).save(tmp_path / "plain.jpg")
    result = call("--map", mapped.map, ground=tmp_path / "plain.jpg")
    assert result.exit_code == 1
    assert "say where (--near LAT,LON)" in result.stderr
    with pytest.raises(SampleError, match="says nothing of where it was taken"):
        predict_on_map(run, tmp_path / "plain.jpg", mapped.map)
    with pytest.raises(ConfigError, match="an image in memory says nothing of its place"):
        predict_on_map(run, Image.new("RGB", (128, 64)), mapped.map)
    with pytest.raises(ConfigError, match="within is -1 m"):
        Priors(within_m=-1.0)
