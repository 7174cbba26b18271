"""Runs that are packed, that come with the package, and that others start from."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from click.testing import CliRunner
from PIL import Image
from slicematch.errors import ConfigError, RunError
from slicematch.localization.localizer import Localizer
from slicematch.runs import shipped
from slicematch.runs.config import TrainConfig
from slicematch.runs.folder import RunFolder, plan_run
from slicematch.runs.packed import pack
from slicematch.runs.start import network_settings
from slicematch.training.train import train

from slicemask.cli.main import main
from slicemask.errors import SpecError


@pytest.fixture(scope="module")
def run(config, cache, tmp_path_factory):
    return train(config, tmp_path_factory.mktemp("run") / "tiny", cache=cache, progress=False)


@pytest.fixture(scope="module")
def packed(run, tmp_path_factory):
    return pack(run, tmp_path_factory.mktemp("packed") / "small")


def _answer(run, config, cache):
    folder = Path(config.root) / "Chicago"
    localizer = Localizer.load(run, cache=cache, device="cpu")
    panorama, tile = (next((folder / kind).iterdir()) for kind in ("panorama", "satellite"))
    estimate = localizer.localize(Image.open(panorama), Image.open(tile))
    return estimate, localizer


def test_a_packed_run_answers_as_the_run_does(run, packed, config, cache):
    whole, small = (_answer(folder, config, cache) for folder in (run, packed))
    assert small[0].scores == pytest.approx(whole[0].scores, abs=2e-3)
    assert small[1].temperature == whole[1].temperature
    assert small[1].calibrated == whole[1].calibrated
    assert small[1].tile_side_m == whole[1].tile_side_m
    files = {path.name for path in packed.iterdir()}
    assert files == {"config.yaml", "weights.safetensors", "calibration.json", "stages.json"}
    assert str(config.root) not in (packed / "config.yaml").read_text()


def test_its_weights_are_half_as_large(packed, run):
    model = RunFolder(run).load_model()[1]
    floats = sum(w.numel() for w in model.state_dict().values() if w.is_floating_point())
    assert (packed / "weights.safetensors").stat().st_size < 2 * floats + 50_000


def test_it_holds_one_checkpoint(packed):
    with pytest.raises(RunError, match=r"last.ckpt: there is no such checkpoint"):
        RunFolder(packed).load_model("last")


def test_it_may_answer_with_another_grid(run, tmp_path):
    small = pack(run, tmp_path / "small", grid="5x5x8")
    assert RunFolder(small).load_config().test_grid == "5x5x8"
    with pytest.raises(SpecError, match="five"):
        pack(run, tmp_path / "other", grid="five")
    assert not (tmp_path / "other").exists()


def test_weights_beyond_half_precision_are_refused(run, tmp_path):
    content = torch.load(run / "checkpoints" / "best.ckpt", weights_only=True)
    key = next(key for key in content["state_dict"] if key.endswith("weight"))
    content["state_dict"][key].fill_(1e5)
    copy = tmp_path / "run"
    (copy / "checkpoints").mkdir(parents=True)
    (copy / "config.yaml").write_bytes((run / "config.yaml").read_bytes())
    torch.save(content, copy / "checkpoints" / "best.ckpt")
    with pytest.raises(RunError, match="too large for half precision"):
        pack(copy, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("content", [b"", b"\x08\x00\x00\x00\x00\x00\x00\x00{}      "])
def test_broken_weights_are_refused(packed, tmp_path, content):
    (tmp_path / "config.yaml").write_bytes((packed / "config.yaml").read_bytes())
    (tmp_path / "weights.safetensors").write_bytes(content)
    with pytest.raises(RunError, match=r"weights.safetensors: "):
        RunFolder(tmp_path).load_model()


def test_the_command(run, tmp_path):
    out = tmp_path / "out"
    done = CliRunner().invoke(main, ["pack", str(run), "--out", str(out), "--json"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.output)["path"] == str(out)
    again = CliRunner().invoke(main, ["pack", str(run), "--out", str(out)])
    assert again.exit_code == 1
    assert "is not empty" in again.output


def test_runs_that_come_with_the_package_go_by_name(packed, monkeypatch, tmp_path):
    monkeypatch.setattr(shipped, "_FOLDER", packed.parent)
    monkeypatch.chdir(tmp_path)
    assert shipped.shipped_runs() == ["small"]
    assert shipped.find_run("small") == packed
    (tmp_path / "small" / "evaluation").mkdir(parents=True)  # results of that run
    assert shipped.find_run("small") == packed
    (tmp_path / "small" / "config.yaml").touch()
    assert shipped.find_run("small") != packed
    with pytest.raises(RunError, match="or small, which comes with slicemask"):
        RunFolder(shipped.find_run("smal")).load_config()


def test_training_starts_from_a_run(packed, config, cache, tmp_path):
    """With frozen backbones nothing of them moves, statistics included; the rest does."""
    asked = {
        name: value
        for name, value in config.flat().items()
        if name in ("data", "root", "cities", "train_grid", "test_grid", "batch_size", "workers")
    }
    asked |= {"init": str(packed), "freeze_encoders": True, "epochs": 1, "accelerator": "cpu"}
    asked |= {"validation_fraction": 0.25, "heat_map_every": 0, "learning_rate": 1e-3}
    planned, out = plan_run(asked, out=tmp_path / "tuned")
    assert planned.pyramid == config.pyramid
    assert planned.bands == config.bands
    tuned = RunFolder(train(planned, out, cache=cache, progress=False)).load_model("last")[1]
    before = RunFolder(packed).load_model()[1].state_dict()
    moved = {name for name, value in tuned.state_dict().items() if not value.equal(before[name])}
    assert moved
    assert not [name for name in moved if "_encoder.backbone." in name]
    assert RunFolder(out).load_config().weights_source == "run small"


def test_backbones_learn_slowly_and_keep_their_statistics(config, cache, tmp_path):
    few = replace(config, weights="none", freeze_statistics=True, epochs=1, learning_rate=1e-3)
    started = RunFolder(train(replace(few, learning_rate=1e-30), tmp_path / "started", cache=cache,
                              progress=False)).load_model("last")[1].state_dict()  # fmt: skip

    def moved(name, rate):
        """By how much the backbones' and the other weights have moved, and which statistics."""
        run = train(replace(few, encoder_rate=rate), tmp_path / name, cache=cache, progress=False)
        away = {
            key: (value.double() - started[key]).abs().max().item()
            for key, value in RunFolder(run).load_model("last")[1].state_dict().items()
        }
        backbones = {key for key in away if "_encoder.backbone." in key}
        statistics = {key for key in backbones if "running_" in key or "num_batches" in key}
        others = set(away) - backbones
        return (
            max(away[key] for key in backbones - statistics),
            max(away[key] for key in others),
            {key for key in statistics if away[key] > 0},
        )

    fast, others, statistics = moved("fast", 1.0)
    slow, same, _ = moved("slow", 0.01)
    assert statistics == set()
    assert slow < fast / 10
    assert same > others / 3


def test_another_network_cannot_start_from_a_run(packed, config, cache, tmp_path):
    other = replace(config, init=str(packed), pyramid=16)
    with pytest.raises(ConfigError, match="whose network is another"):
        train(other, tmp_path / "run", cache=cache, progress=False)
    assert not (tmp_path / "run").exists()


def test_the_settings_of_a_network_are_taken_over(packed, config):
    settings = network_settings(packed)
    assert TrainConfig(data="vigor", root=config.root, **settings).slices == config.slices
