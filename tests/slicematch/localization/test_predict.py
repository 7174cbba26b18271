"""The command and the function that answer for one pair of images."""

import json

import pytest
from click.testing import CliRunner
from PIL import Image
from slicematch.errors import ConfigError
from slicematch.localization.predict import predict
from slicematch.localization.refinement import DEFAULT

from slicemask.cli.main import main


def test_predict_writes_geojson_and_says_how_sure_it_is(slicemask, images, localizer, tmp_path):
    pair = ["--ground", images[0], "--aerial", images[1]]
    place = ["--centre", "41.8,-87.6", "--metres-per-pixel", "0.9"]
    out = tmp_path / "pose.geojson"
    options = [*pair, *place, "--refine", "continuous", "--geojson", out]
    content = json.loads(slicemask("predict", *options, "--json").stdout)
    expected = localizer.localize(*images, refine="continuous", metres_per_pixel=0.9)
    assert content == {
        **expected.as_dict(0.9, (41.8, -87.6)), "refine": "continuous", "calibrated": False,
        "geojson": str(out),
    }  # fmt: skip
    point, area = json.loads(out.read_text())["features"]
    assert point["geometry"]["coordinates"] == [content["longitude"], content["latitude"]]
    assert area["geometry"]["type"] == "Polygon"

    text = slicemask("predict", *options).stdout
    assert f"latitude {content['latitude']:.7f}" in text
    assert f"probability {content['probability']:.1%} (uncalibrated), standard dev" in text
    assert str(out) in text.splitlines()
    assert "of the tile east" in slicemask("predict", *pair, "--refine", "none").stdout


PLACE = ("--centre", "1,2", "--metres-per-pixel", "1")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--geojson", "{0}/a.geojson"], "--geojson needs --centre and --metres-per-pixel"),
        (["--centre", "1,2"], "--centre needs --metres-per-pixel"),
        ([*PLACE, "--geojson", "{0}/a.txt"], "its suffix is .txt; name a file that ends in .geo"),
        ([*PLACE, "--geojson", "{0}/no/a.json"], "there is no such folder"),
        ([*PLACE, "--geojson", "{0}/a.json", "--out", "{0}/a.bmp"], "its suffix is .bmp"),
        (["--centre", "95,2", "--metres-per-pixel", "1"], "the tile's centre is 95,2"),
        (["--centre", "5,2", "--metres-per-pixel", "0"], "metres per pixel is 0.0"),
        (["--centre", "5", "--metres-per-pixel", "1"], "'5' is not lat,lon"),
        (["--centre", "5,2", "--metres-per-pixel", "1e300"], "it must be from 0.0001 to 1000"),
        (["--metres-per-pixel", "1e-13"], "metres per pixel is 1e-13"),
        (["--metres-per-pixel", "nan"], "metres per pixel is nan"),
        (["--refine", "finest"], "'finest' is not one of"),
        (["--truth", "0.5,0.5,0"], "--truth is drawn in the picture; it needs --out"),
        (["--truth", "5,5,nan", "--out", "{0}/a.png"], "the truth is not finite: u=5, v=5"),
        (["--truth", "5,5,0", "--out", "{0}/a.png"], "the truth lies outside the tile"),
    ],
)
def test_predict_says_what_it_lacks(slicemask, images, tmp_path, options, said):
    options = [option.format(tmp_path) for option in options]
    result = slicemask("predict", "--ground", images[0], "--aerial", images[1], *options)
    assert result.exit_code != 0
    assert said in result.stderr
    assert "Traceback" not in result.output
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("device", ["meta", "mps", "xpu", "cuda:99", "abacus"])
@pytest.mark.parametrize("command", ["predict", "evaluate", "benchmark"])
def test_devices_that_cannot_be(slicemask, images, command, device):
    pair = ["--ground", images[0], "--aerial", images[1]] if command == "predict" else []
    result = slicemask(command, *pair, "--device", device)
    assert result.exit_code == 1
    (line,) = result.stderr.splitlines()
    assert line.startswith(f"Error: device '{device}' cannot be used")


@pytest.mark.parametrize("command", ["predict", "evaluate"])
def test_the_commands_default_is_the_librarys(command):
    text = " ".join(CliRunner().invoke(main, [command, "--help"]).stdout.split())
    assert f"then gradients. [default: {DEFAULT}]" in text


def test_calibrating_a_run_without_a_validation_part(slicemask, run):
    result = CliRunner().invoke(main, ["calibrate", str(run)])
    assert result.exit_code == 1
    assert "was trained with validation_fraction 0" in result.stderr


def test_the_function_gives_what_the_command_prints(slicemask, run, cache, images, tmp_path):
    said = []
    prediction = predict(
        run, *images, cache=cache, device="cpu", metres_per_pixel=0.9, centre=(41.8, -87.6),
        out=tmp_path / "a.png", geojson=tmp_path / "a.json", truth=(0.5, 0.5, 0.0),
        progress=said.append,
    )  # fmt: skip
    assert said == [
        "reading the tile", "loading the run", "reading the ground image", "scoring poses",
        "drawing",
    ]  # fmt: skip
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.json", "a.png"]
    options = ["--ground", images[0], "--aerial", images[1], "--metres-per-pixel", 0.9]
    options += ["--centre", "41.8,-87.6"]
    content = prediction.as_dict()
    for name in ("geojson", "picture"):
        assert content.pop(name).startswith(str(tmp_path))
    assert json.loads(slicemask("predict", *options, "--json").stdout) == content
    lines = str(prediction).splitlines()
    assert slicemask("predict", *options).stdout.splitlines() == lines[:2]
    assert lines[2:] == [str(tmp_path / "a.json"), str(tmp_path / "a.png")]


@pytest.mark.parametrize(("height", "width"), [(127, 128), (128, 127)])
def test_a_tile_that_is_nearly_square_is_answered_and_drawn(
    run, cache, images, tmp_path, height, width
):
    """One tolerance for the answer and its files."""
    Image.open(images[1]).resize((width, height)).save(tmp_path / "tile.png")
    out, geojson = tmp_path / "a.png", tmp_path / "a.geojson"
    place = {"metres_per_pixel": 0.5, "centre": (41.8, -87.6), "out": out, "geojson": geojson}
    predict(run, images[0], tmp_path / "tile.png", cache=cache, device="cpu", **place)
    assert out.stat().st_size > 10_000
    assert json.loads(geojson.read_text())["type"] == "FeatureCollection"


@pytest.mark.parametrize(
    ("ground", "aerial", "more"),
    [
        ("ground.jpg", "oblong.png", []),
        ("cut.jpg", "tile.png", []),
        ("tile.png", "tile.png", []),
        ("ground.jpg", "tile.png", ["--place-prior", "0.0,0.0,0.001"]),
        ("ground.jpg", "tile.png", ["--bank", "nowhere.h5"]),
        ("ground.jpg", "tile.png", ["--grid", "3x3x4", "--bank", "some.h5"]),
    ],
)
def test_nothing_is_written_for_a_request_that_fails(
    slicemask, images, tmp_path, ground, aerial, more
):
    (tmp_path / "out").mkdir()
    (tmp_path / "ground.jpg").write_bytes(images[0].read_bytes())
    (tmp_path / "cut.jpg").write_bytes(images[0].read_bytes()[:300])
    tile = Image.open(images[1])
    tile.save(tmp_path / "tile.png")
    tile.crop((0, 0, 80, 70)).save(tmp_path / "oblong.png")
    result = slicemask(
        "predict", "--ground", tmp_path / ground, "--aerial", tmp_path / aerial, *PLACE, *more,
        "--out", tmp_path / "out" / "a.png", "--geojson", tmp_path / "out" / "a.json",
    )  # fmt: skip
    assert result.exit_code == 1
    assert len(result.stderr.splitlines()) == 1
    assert not list((tmp_path / "out").iterdir())


def test_one_file_for_two_outputs_is_refused(run, images, tmp_path):
    out = tmp_path / "a.png"
    with pytest.raises(ConfigError, match="GeoJSON needs the tile's centre"):
        predict(run, *images, geojson=tmp_path / "a.json")
    with pytest.raises(OSError, match=r"its suffix is \.png"):
        predict(run, *images, metres_per_pixel=1, centre=(1, 2), geojson=out, out=out)


@pytest.mark.parametrize(
    ("centre", "swapped"), [((-87.6, 41.9), "41.9,-87.6"), ((88.4, 22.6), "22.6,88.4")]
)
def test_a_centre_whose_latitude_is_beyond_all_maps(run, cache, images, caplog, centre, swapped):
    predict(run, *images, cache=cache, device="cpu", metres_per_pixel=1, centre=centre)
    assert f"if the two are swapped, give {swapped}" in caplog.text
    with pytest.raises(ConfigError, match=r"if the two are swapped, give 37\.8,-122\.4"):
        predict(run, *images, metres_per_pixel=1, centre=(-122.4, 37.8))


def test_ordinary_centres_pass_in_silence(run, cache, images, caplog):
    for centre in ((41.9, -87.6), (-77.8, 166.7), (85.0, 10.0)):
        predict(run, *images, cache=cache, device="cpu", metres_per_pixel=0.9, centre=centre)
    assert not caplog.records


def test_a_cache_that_does_not_exist_is_made(run, images, tmp_path):
    options = ["--device", "cpu", "--ground", images[0], "--aerial", images[1]]
    for folder in (tmp_path / "new", tmp_path / "new" / "er" / "est"):
        arguments = ["predict", run, "--cache", folder, *options]
        result = CliRunner().invoke(main, [str(argument) for argument in arguments])
        assert result.exit_code == 0, result.output
        assert len(list(folder.glob("*.h5"))) == 1


def test_caches_that_are_no_use_are_named(run, images, tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "empty").mkdir()
    options = ["--device", "cpu", "--ground", images[0], "--aerial", images[1]]
    arguments = ["predict", run, "--cache", tmp_path / "file" / "in", *options]
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code == 1
    (line,) = result.stderr.splitlines()
    assert str(tmp_path / "file") in line
