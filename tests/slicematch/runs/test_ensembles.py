"""Ensembles: several networks, with slices, bands and cells of their own, that answer together."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from slicematch import evaluate, predict
from slicematch.errors import ConfigError, RunError
from slicematch.evaluation.calibration import calibrate
from slicematch.export.export import export
from slicematch.localization.localizer import Localizer
from slicematch.localization.members import weights_of
from slicematch.runs.config import TrainConfig
from slicematch.runs.packed import pack
from slicematch.training.train import train

from slicemask.cli.main import main


@pytest.fixture(scope="module")
def banded(config, cache, tmp_path_factory):
    return train(config, tmp_path_factory.mktemp("run") / "banded", cache=cache, progress=False)


@pytest.fixture(scope="module")
def whole(config, cache, tmp_path_factory):
    # Another number of slices, no bands, half as many cells, an attention map for each slice.
    other = replace(config, slices=6, bands=(), stride=16, pyramid=None, seed=3)
    return train(other, tmp_path_factory.mktemp("run") / "whole", cache=cache, progress=False)


@pytest.fixture(scope="module")
def ensemble(banded, whole, tmp_path_factory):
    return pack(banded, tmp_path_factory.mktemp("packed") / "both", members=[whole])


@pytest.fixture(scope="module")
def pair(config):
    folder = Path(config.root) / "Chicago"
    return tuple(sorted((folder / kind).iterdir())[0] for kind in ("panorama", "satellite"))


def _load(run, cache, **settings):
    return Localizer.load(run, cache=cache, device="cpu", **settings)


@pytest.mark.parametrize("prior", [{}, {"heading_prior": (30, 50), "place_prior": (0.5, 0.5, 0.3)}])
def test_it_holds_the_mean_of_what_its_networks_hold(ensemble, cache, pair, prior):
    both = _load(ensemble, cache)
    each = [_load(run, cache) for run in (ensemble, ensemble / "members" / "whole")]
    each[0] = each[0].alone()
    answers = [one.localize(*pair, **prior) for one in each]
    logits = np.mean(
        [answer.scores / one.temperature for one, answer in zip(each, answers, strict=True)], axis=0
    )
    answer = both.localize(*pair, **prior)
    np.testing.assert_allclose(answer.scores / both.temperature, logits, atol=1e-4)
    assert both.temperature == weights_of([one.temperature for one in each])[1]
    assert not np.allclose(answers[0].scores, answers[1].scores, atol=1e-3)


@pytest.mark.parametrize("refine", ["mean", "fine", "continuous"])
def test_a_refined_answer_is_scored_by_all_of_them(ensemble, cache, pair, refine):
    both = _load(ensemble, cache, refine=refine)
    estimate = both.localize(*pair)
    scorer = both.pair_scorer(both.encode_ground(pair[0]), both.encode_aerial(pair[1]))
    pose = torch.from_numpy(estimate.pose[None])
    assert scorer(pose).item() == pytest.approx(estimate.score, abs=1e-5)
    if refine != "mean":
        assert estimate.score >= estimate.heat_map.max() - 1e-6


def test_contributions_sum_to_the_score(ensemble, cache, pair):
    both = _load(ensemble, cache)
    scorer = both.pair_scorer(both.encode_ground(pair[0]), both.encode_aerial(pair[1]))
    poses = torch.tensor([[0.5, 0.5, 10.0], [0.1, 0.95, 200.0]], dtype=torch.float64)
    parts = scorer.contributions(poses)
    assert parts.shape == (2, 4, 2)
    np.testing.assert_allclose(parts.sum(dim=(1, 2)), scorer(poses), atol=1e-6)
    # Without the first network, those of 6 slices lie where 4 slices have their angles.
    of_other = scorer.scorers[1].contributions(poses)[..., 0]
    first = scorer.weights[0] * scorer.scorers[0].contributions(poses)
    spread = ((parts - first) / scorer.weights[1]).sum(dim=2)
    np.testing.assert_allclose(spread[:, 0], of_other[:, 0] + of_other[:, 1] / 2, atol=1e-6)
    np.testing.assert_allclose(spread[:, 3], of_other[:, 4] / 2 + of_other[:, 5], atol=1e-6)


def test_its_first_network_can_answer_alone(ensemble, banded, cache, pair):
    expected = _load(banded, cache)
    for one in (_load(ensemble, cache, alone=True), _load(ensemble, cache).alone()):
        assert one.calibrated
        assert one.temperature == expected.temperature
        assert one.alone() is one
        np.testing.assert_allclose(
            one.localize(*pair).scores, expected.localize(*pair).scores, atol=2e-3
        )


def test_encoded_images_of_other_networks_are_refused(ensemble, cache, pair):
    both = _load(ensemble, cache)
    tile = both.alone().encode_aerial(pair[1])
    with pytest.raises(ConfigError, match="encoded by 2 and 1 networks, and the run has 2"):
        both.estimate(both.encode_ground(pair[0]), tile.features, [64])


def test_a_bank_of_its_own_gives_all_networks_their_candidates(ensemble, cache, config, pair):
    from slicemask import PoseGrid, build_bank

    bank = build_bank(PoseGrid(2, 3, 4), _load(ensemble, cache).frustum, 8, cache=cache).path
    found = _load(ensemble, cache, bank=bank).localize(*pair, refine="none")
    expected = _load(ensemble, cache, grid="2x3x4").localize(*pair, refine="none")
    np.testing.assert_array_equal(found.scores, expected.scores)


def test_a_temperature_is_fitted_to_what_they_say_together(ensemble, cache, config, tmp_path):
    copy = tmp_path / "both"
    shutil.copytree(ensemble, copy)
    assert not _load(copy, cache).calibrated
    own = (copy / "calibration.json").read_text()
    fitted = calibrate(copy, root=config.root, device="cpu", workers=0, cache=cache)
    assert (copy / "calibration.json").read_text() == own
    assert json.loads((copy / "ensemble.json").read_text()) == fitted
    loaded = _load(copy, cache)
    assert loaded.calibrated
    assert loaded.temperature == fitted["temperature"]
    # Of networks with other temperatures, which weigh otherwise, it says nothing.
    other = copy / "members" / "whole" / "calibration.json"
    other.write_text(json.dumps(json.loads(other.read_text()) | {"temperature": 0.5}))
    assert not _load(copy, cache).calibrated
    assert loaded.alone().temperature == json.loads(own)["temperature"]


def test_it_is_evaluated_as_one(ensemble, cache, config, tmp_path):
    found, _ = evaluate(
        ensemble, root=config.root, device="cpu", workers=0, cache=cache, refine="none",
        out=tmp_path / "evaluation",
    )  # fmt: skip
    both = _load(ensemble, cache, refine="none")
    sample = both.config.dataset("test", config.root)[0]
    scores = both.scores(sample["ground"][None], sample["aerial"][None])[0]
    expected = both.within().poses[int(scores.argmax())]
    np.testing.assert_allclose(found.estimates[0], expected)
    lonely, _ = evaluate(
        ensemble / "members" / "whole", root=config.root, device="cpu", workers=0, cache=cache,
        refine="none", out=tmp_path / "lonely",
    )  # fmt: skip
    assert not np.allclose(found.estimates, lonely.estimates)


def test_files_are_of_its_first_network(ensemble, banded, cache, tmp_path, caplog):
    export(ensemble, tmp_path / "both", format="torch-export", cache=cache)
    export(banded, tmp_path / "first", format="torch-export", cache=cache)
    assert caplog.text.count("is an ensemble, and the files hold its first network alone") == 1
    assert str(ensemble / "members" / "whole") in caplog.text
    both, first = (np.load(tmp_path / name / "example.npz") for name in ("both", "first"))
    np.testing.assert_allclose(both["scores"], first["scores"], atol=2e-3)


def test_the_commands_make_one_and_use_it(banded, whole, pair, cache, tmp_path):
    out = tmp_path / "both"
    done = CliRunner().invoke(
        main, ["pack", str(banded), "--with", str(whole), "--out", str(out), "--json"]
    )
    assert done.exit_code == 0, done.output
    size = sum(file.stat().st_size for file in out.rglob("*") if file.is_file())
    assert json.loads(done.output) == {"path": str(out), "bytes": size}
    done = CliRunner().invoke(
        main, ["predict", str(out), *("--ground", str(pair[0])), *("--aerial", str(pair[1])),
               *("--cache", str(cache)), "--json"]
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    expected = predict(out, *pair, device="cpu", cache=cache).estimate.pose
    assert json.loads(done.output)["u"] == pytest.approx(expected[0])


def test_an_ensemble_is_packed_with_all_its_networks(ensemble, banded, config, cache, tmp_path):
    copy = tmp_path / "both"
    shutil.copytree(ensemble, copy)
    calibrate(copy, root=config.root, device="cpu", workers=0, cache=cache)
    again, three = pack(copy, tmp_path / "again"), pack(copy, tmp_path / "three", members=[banded])
    for found, expected in ((again, copy), (three, copy)):
        names = {file.relative_to(expected) for file in expected.rglob("*") if file.is_file()}
        assert names - {file.relative_to(found) for file in found.rglob("*")} <= {
            Path("ensemble.json")
        }
    assert (again / "ensemble.json").read_text() == (copy / "ensemble.json").read_text()
    assert not (three / "ensemble.json").exists()
    assert len(_load(three, cache).members) == 3


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"aerial_size": 128}, "aerial_size 128"),
        ({"ground_size": (48, 64)}, r"ground_size \(48, 64\)"),
        ({"elevations": (-30.0, 30.0)}, r"elevations \(-30.0, 30.0\)"),
        ({"image_mean": (0.1, 0.1, 0.1)}, "normalisation"),
        ({"heading_half_width_deg": 10.0}, "heading_half_width_deg 10.0"),
        ({"tile_side_m": 150.0}, "tile_side_m 150.0"),
        ({"data": "kitti", "data_settings": {}}, "data kitti"),
        ({"tile_side_m": None}, "tile_side_m None"),
    ],
)
def test_networks_that_see_other_images_are_refused(banded, whole, tmp_path, change, named):
    other = tmp_path / "other"
    shutil.copytree(whole, other)
    replace(TrainConfig.load(other / "config.yaml"), **change).save(other / "config.yaml")
    with pytest.raises(ConfigError, match=f"{other}: has {named}.* see the same images"):
        pack(banded, tmp_path / "both", members=[other])
    assert not (tmp_path / "both").exists()


def test_two_of_one_name_are_refused(banded, whole, tmp_path):
    with pytest.raises(ConfigError, match="another run of the name 'whole'"):
        pack(banded, tmp_path / "both", members=[whole, whole])
    assert not (tmp_path / "both").exists()


def test_a_run_is_named_by_its_folder_however_it_is_given(banded, whole, tmp_path, monkeypatch):
    monkeypatch.chdir(whole)
    (whole / "below").mkdir(exist_ok=True)
    for number, given in enumerate((".", "below/..", f"{whole}/")):
        both = pack(banded, tmp_path / str(number), members=[given])
        assert [path.name for path in (both / "members").iterdir()] == ["whole"]
        first = (both / "weights.safetensors").read_bytes()
        assert first != (both / "members" / "whole" / "weights.safetensors").read_bytes()


def test_an_ensemble_can_join_another_with_all_its_networks(
    ensemble, banded, whole, cache, tmp_path
):
    shutil.copytree(banded, tmp_path / "third")
    found = pack(tmp_path / "third", tmp_path / "all", members=[ensemble])
    assert sorted(path.name for path in (found / "members").iterdir()) == ["both", "whole"]
    assert not list((found / "members").glob("*/members"))
    assert len(_load(found, cache).members) == 3


def test_last_weights_are_packed_with_those_of_a_packed_run(banded, ensemble, cache, tmp_path):
    other = ensemble / "members" / "whole"
    found = pack(banded, tmp_path / "all", "last", members=[other])
    name = "weights.safetensors"
    assert (found / "members" / "whole" / name).read_bytes() == (other / name).read_bytes()


@pytest.mark.parametrize("spoilt", ["weights.safetensors", "calibration.json"])
def test_nothing_is_left_of_a_folder_that_cannot_be_packed(banded, ensemble, tmp_path, spoilt):
    other = tmp_path / "other"
    shutil.copytree(ensemble / "members" / "whole", other)
    (other / spoilt).write_text("{")
    with pytest.raises(RunError, match=spoilt):
        pack(banded, tmp_path / "both", members=[other])
    assert [path.name for path in tmp_path.iterdir()] == ["other"]


@pytest.mark.parametrize("lost", ["members", "members/whole/config.yaml"])
def test_what_is_left_of_an_ensemble_is_refused(ensemble, config, cache, tmp_path, lost):
    copy = tmp_path / "both"
    shutil.copytree(ensemble, copy)
    calibrate(copy, root=config.root, device="cpu", workers=0, cache=cache)
    shutil.rmtree(copy / lost) if lost == "members" else (copy / lost).unlink()
    with pytest.raises(RunError, match=r"copy the ensemble whole|has no config\.yaml"):
        _load(copy, cache)


def test_temperatures_that_are_not_fitted_are_not_weighed_against_fitted_ones(
    ensemble, cache, config, tmp_path
):
    copy = tmp_path / "both"
    shutil.copytree(ensemble, copy)
    (copy / "members" / "whole" / "calibration.json").unlink()
    loaded = _load(copy, cache)
    assert [member.weight for member in loaded.members] == [0.5, 0.5]
    assert loaded.temperature == config.tau


def test_networks_of_the_same_masks_share_them(banded, ensemble, cache, pair, tmp_path):
    shutil.copytree(banded, tmp_path / "twin")
    twins = _load(pack(banded, tmp_path / "both", members=[tmp_path / "twin"]), cache)
    assert twins.members[0].candidates is twins.members[1].candidates
    prior = {"heading_prior": (90, 60)}
    np.testing.assert_allclose(
        twins.localize(*pair, **prior).scores, twins.alone().localize(*pair, **prior).scores,
        atol=1e-6,
    )  # fmt: skip


def test_gradients_climb_in_inference_mode(ensemble, cache, pair):
    both = _load(ensemble, cache, refine="continuous")
    expected = both.localize(*pair)
    with torch.inference_mode():
        found = both.localize(*pair)
    np.testing.assert_allclose(found.pose, expected.pose, atol=1e-6)


def test_no_such_run_leaves_nothing(banded, tmp_path):
    with pytest.raises(RunError, match="is no run folder"):
        pack(banded, tmp_path / "both", members=[tmp_path / "nowhere"])
    assert not (tmp_path / "both").exists()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("members/whole/config.yaml", "data: vig"),
        ("members/whole/weights.safetensors", "no weights"),
        ("members/whole/calibration.json", "{"),
        ("ensemble.json", '{"temperature": -1}'),
    ],
)
def test_spoilt_files_are_named(ensemble, cache, tmp_path, name, content):
    copy = tmp_path / "both"
    shutil.copytree(ensemble, copy)
    (copy / name).write_text(content)
    with pytest.raises(RunError, match=name):
        _load(copy, cache)


def test_commands_can_ask_the_first_network_alone(ensemble, banded, pair, config, cache, tmp_path):
    asked = ["--ground", str(pair[0]), "--aerial", str(pair[1]), "--cache", str(cache), "--json"]
    answers = [
        json.loads(CliRunner().invoke(main, ["predict", str(run), *asked, *further]).stdout)
        for run, further in ((ensemble, []), (ensemble, ["--alone"]), (banded, ["--alone"]))
    ]
    assert answers[1]["u"] == pytest.approx(answers[2]["u"], abs=2e-3)
    assert answers[0]["score"] != pytest.approx(answers[1]["score"], abs=1e-4)
    done = CliRunner().invoke(
        main, ["evaluate", str(ensemble), "--alone", "--root", config.root, "--workers", "0",
               "--device", "cpu", "--cache", str(cache), "--json"]
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    folder = ensemble / "evaluation" / "same-area_test_4x4x8_best_mean_alone"
    assert json.loads((folder / "result.json").read_text())["networks"] == 1
