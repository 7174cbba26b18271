"""The run that comes with the package."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image
from slicematch import Localizer, evaluate
from slicematch.runs.folder import RunFolder
from slicematch.runs.shipped import find_run, shipped_pairs, shipped_runs

from slicemask.cli.main import main

RUN = "generated-city"
PAIRS = Path(__file__).parents[4] / "shared" / "data" / "real_pairs"


@pytest.fixture(scope="module")
def localizer(tmp_path_factory):
    return Localizer.load(RUN, cache=tmp_path_factory.mktemp("banks"), device="cpu")


def test_it_is_small_and_complete():
    assert RUN in shipped_runs()
    names = {path.name for path in find_run(RUN).iterdir()}
    parts = {"README.md", "calibration.json", "config.yaml", "examples", "stages.json"}
    parts |= {"weights.safetensors"}
    assert names == parts | {"ensemble.json", "members"}
    assert sum(path.stat().st_size for path in find_run(RUN).rglob("*")) < 10e6
    config = RunFolder(find_run(RUN)).load_config()
    assert "/" not in config.root
    assert config.bands == (6.0, 12.0, 24.0)
    members = RunFolder(find_run(RUN)).members()
    assert [one.path.name for one in members] == ["whole"]
    for one in members:
        assert {path.name for path in one.path.iterdir()} == parts - {"README.md", "examples"}
        assert "/" not in one.load_config().root
        assert one.load_config().bands == ()


def test_its_probabilities_are_calibrated_on_its_own_grid():
    run = RunFolder(find_run(RUN))
    config = run.load_config()
    for one in (run, *run.members()):
        fitted = one.load_calibration(one.load_config())
        assert fitted is not None
        assert fitted.matches(config.grid("test_grid"), "best")


def test_what_its_networks_say_together_is_calibrated(localizer):
    assert len(localizer.members) == 2
    assert localizer.calibrated
    assert localizer.alone().calibrated


def test_its_examples_are_answered(tmp_path):
    """The pose that comes with each is the one that is found, within what the card promises."""
    assert len(shipped_pairs(RUN)) == 3
    for number, pair in enumerate(shipped_pairs(RUN), 1):
        found = predict("--example", str(number), "--cache", str(tmp_path), "--json")
        assert found.exit_code == 0
        answer = json.loads(found.stdout)
        off = np.hypot(answer["u"] - pair.pose[0], answer["v"] - pair.pose[1])
        assert off * 512 * pair.metres_per_pixel < 5.0
        assert abs((answer["heading_deg"] - pair.pose[2] + 180) % 360 - 180) < 5.0


def test_the_truth_of_an_example_is_drawn(tmp_path):
    out = tmp_path / "answer.svg"
    found = predict("--example", "3", "--cache", str(tmp_path), "--out", str(out))
    assert found.exit_code == 0
    assert "truth" in out.read_text()


def test_wrong_examples_are_one_sentence(tmp_path):
    assert "generated-city comes with 1 to 3: 1, a street" in predict("--example", "4").output
    both = predict("--example", "1", "--ground", "pano.jpg").output
    assert "--example stands for --ground and --aerial; leave them out." in both
    assert "Missing option '--ground', or '--example'." in predict().output


def predict(*arguments):
    return CliRunner().invoke(main, ["predict", RUN, *arguments])


@pytest.mark.parametrize(
    "command",
    [
        ["locate", RUN, "photo.jpg", "--map", "ortho.tif", "--out", "answers.csv"],
        ["predict", RUN, "--ground", "photo.jpg", "--map", "ortho.tif"],
        ["evaluate", RUN, "--root", "nowhere"],
        ["train", "--init", RUN, "--data", "vigor", "--root", "nowhere"],
    ],
)
def test_all_commands_know_its_name(command, tmp_path, monkeypatch):
    """What they refuse is the data, which is not there."""
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main, [*command, "--cache", str(tmp_path)])
    assert result.exit_code == 1
    assert "ortho.tif" in result.output or "nowhere" in result.output
    assert "is no run folder" not in result.output


def test_its_files_stay_as_they_are(tmp_path):
    result = CliRunner().invoke(main, ["calibrate", RUN, "--root", str(tmp_path)])
    assert "generated-city comes with slicemask, whose files stay as they are" in result.output


def test_it_finds_cameras_in_a_generated_city(tmp_path):
    """A city that it was not trained on: most answers have the right heading."""
    pytest.importorskip("embreex")
    from slicemask.synth import generate_vigor

    city = tmp_path / "city"
    generate_vigor(
        city, cities=2, panoramas=8, seed=1234, panorama_size=(512, 256), tile_size=320, jobs=1
    )
    done, _ = evaluate(
        RUN, grid="9x9x32", root=str(city), out=tmp_path / "results", workers=0, device="cpu"
    )
    assert len(done.errors.heading_deg) == 8
    assert np.median(done.errors.heading_deg) < 20.0


@pytest.mark.skipif(not PAIRS.is_dir(), reason="the real pairs are not here")
def test_it_finds_a_real_camera(localizer):
    """A street of a suburb, whole panorama; tile of 72 m, the camera in its middle."""
    ground = Image.open(PAIRS / "suburb2_ground.jpg")
    tile = Image.open(PAIRS / "suburb2_aerial.jpg").crop((5, 5, 1195, 1195))
    estimate = localizer.localize(ground, tile, metres_per_pixel=0.0609)
    assert estimate.probabilities.sum() == pytest.approx(1.0, abs=1e-4)
    assert min(estimate.pose[2], 360.0 - estimate.pose[2]) < 10.0
    assert np.hypot(*(estimate.pose[:2] - 0.5)) * 72.5 < 5.0
