"""Run folders: training, exact resuming, and opening what may be hostile."""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from hashlib import sha256

import pytest
import torch
from click.testing import CliRunner
from safetensors.torch import save_file
from slicematch.data.errors import DatasetError
from slicematch.devices import choose_device
from slicematch.errors import ConfigError, RunError
from slicematch.evaluation.calibration import calibrate
from slicematch.localization.localizer import Localizer
from slicematch.runs.config import TrainConfig
from slicematch.runs.folder import RunFolder, plan_run
from slicematch.training.train import train

from slicemask.cli.main import main

import timm  # isort: skip  after the model's modules


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    """Sums are made in one order, and tests beside each other do not starve."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("banks")


@pytest.fixture(scope="module")
def config(make_vigor_tree, tmp_path_factory):
    root = tmp_path_factory.mktemp("data") / "vigor"
    make_vigor_tree(root, 8, panorama_size=(64, 128), tile_pixels=64)
    return TrainConfig(
        data="vigor",
        root=str(root),
        data_settings={"cities": ["Chicago"]},
        encoder="test_convnext",
        weights="none",
        stride=16,
        ground_size=(32, 64),
        aerial_size=64,
        slices=4,
        train_grid="3x3x4",
        test_grid="4x4x8",
        learning_rate=1e-3,
        batch_size=2,
        epochs=4,
        validation_fraction=0.25,
        heat_map_every=0,
        workers=0,
        accelerator="cpu",
    )


def metrics(run):
    return [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]


def weights(run, which="last"):
    return RunFolder(run).load_model(which)[1].state_dict()


def test_a_run_leaves_what_its_folder_promises(config, tmp_path, cache):
    config = replace(config, heat_map_every=2)
    run = train(config, tmp_path / "run", cache=cache, progress=False)
    # What only the encoder and the data say is filled in.
    assert RunFolder(run).load_config() == replace(
        config,
        hfov_deg=360.0,
        image_mean=(0.5, 0.5, 0.5),  # timm's for this encoder
        image_std=(0.5, 0.5, 0.5),
        tile_side_m=640 * 0.111262,
    )
    lines = metrics(run)
    assert [line["epoch"] for line in lines] == [0, 1, 2, 3]
    assert [line["step"] for line in lines] == [3, 6, 9, 12]
    assert {"train/loss", "validation/place_mean_m", "validation/heading_median_deg"} <= set(
        lines[0]
    )
    best = min(range(4), key=lambda epoch: lines[epoch]["validation/place_mean_m"])
    checkpoint = torch.load(run / "checkpoints" / "best.ckpt", weights_only=True)
    assert checkpoint["epoch"] == best
    assert sorted(path.name for path in (run / "heat_maps").iterdir()) == [
        "epoch_0002.png",
        "epoch_0004.png",
    ]
    assert list((run / "tensorboard").glob("events.out.tfevents.*"))


def test_training_fits_a_temperature_on_the_validation_part(config, tmp_path, cache):
    run = train(replace(config, epochs=1), tmp_path / "run", cache=cache, progress=False)
    content = json.loads((run / "calibration.json").read_text())
    assert (content["samples"], content["grid"], content["checkpoint"]) == (2, "4x4x8", "best")
    assert content["nll"] <= content["nll_of_tau"]
    assert Localizer.load(run, cache=cache).temperature == content["temperature"]
    assert content["caution"].startswith("fitted to only 2 validation samples")
    # Held near the loss's tau of 0.1, however the two turn out: any fit lies in [1e-4, 10].
    assert 0.1 * (1e-4 / 0.1) ** (2 / 30) <= content["temperature"] <= 0.1 * 100 ** (2 / 30)
    result = CliRunner().invoke(main, ["calibrate", str(run), "--cache", str(cache)])
    assert "caution: fitted to only 2 validation samples" in result.stdout
    # Fitted again later it is the same, to another grid another one.
    (run / "calibration.json").unlink()
    assert calibrate(run, cache=cache) == content
    assert calibrate(run, cache=cache, grid="2x2x2")["grid"] == "2x2x2"
    with pytest.raises(ConfigError, match="workers is -1; it must be at least 0"):
        calibrate(run, cache=cache, workers=-1)
    assert not list(run.glob("*.part*"))

    unseen = replace(config, epochs=1, validation_fraction=0.0)
    run = train(unseen, tmp_path / "other", cache=cache, progress=False)
    assert not (run / "calibration.json").exists()
    with pytest.raises(ConfigError, match="was trained with validation_fraction 0"):
        calibrate(run, cache=cache)


def test_a_temperature_is_fitted_to_fewer_samples_of_many_candidates(
    config, tmp_path, cache, monkeypatch
):
    run = train(replace(config, epochs=1), tmp_path / "run", cache=cache, progress=False)
    for most, samples in ((4 * 4 * 8 * 2, 2), (4 * 4 * 8 * 2 - 1, 1), (1, 1)):
        monkeypatch.setattr("slicematch.evaluation.calibration.MOST_SCORES", most)
        assert calibrate(run, cache=cache)["samples"] == samples


def test_jitter_and_near_negatives_change_the_losses(config, tmp_path, cache):
    config = replace(config, epochs=1)
    losses = {
        metrics(train(replace(config, **settings), tmp_path / name, cache=cache, progress=False))[
            0
        ]["train/loss"]
        for name, settings in (
            ("plain", {}),
            ("jitter", {"grid_jitter": True}),
            ("near", {"near_negatives": 2}),
        )
    }
    assert len(losses) == 3


class Killed(BaseException):
    """What a kill is to the process: nothing in it catches this."""


@pytest.mark.parametrize(
    ("epoch", "changes"),
    [
        (0, {"workers": 0}),
        (2, {"workers": 0}),
        (2, {"workers": 1}),
        (2, {"schedule": "one-cycle", "augment": True}),
        (2, {"schedule": "one-cycle", "encoder_rate": 0.2, "augment": True, "restyle": 0.5}),
        (2, {"grid_jitter": True, "near_negatives": 2}),
    ],
)
def test_a_killed_run_resumes_with_the_same_losses(
    config, tmp_path, cache, monkeypatch, epoch, changes
):
    config = replace(config, **changes)
    whole = train(config, tmp_path / "whole", cache=cache, progress=False)

    # The kill comes in the middle of an epoch.
    from slicematch.training.module import TrainingModule

    step = TrainingModule.training_step

    def killed_step(self, batch, number):
        if self.current_epoch == epoch and number == 1:
            raise Killed
        return step(self, batch, number)

    with monkeypatch.context() as patch:
        patch.setattr(TrainingModule, "training_step", killed_step)
        with pytest.raises(Killed):
            train(config, tmp_path / "cut", cache=cache, progress=False)
    assert (tmp_path / "cut" / "checkpoints" / "last.ckpt").exists() == (epoch > 0)
    torch.rand(7)  # the process's own random state does not matter

    resumed = train(config, tmp_path / "cut", resume=True, cache=cache, progress=False)
    assert metrics(resumed) == metrics(whole)
    for which in ("best", "last"):
        expected = weights(whole, which)
        assert all(torch.equal(expected[k], v) for k, v in weights(resumed, which).items())


def test_a_finished_run_trains_on_for_more_epochs(config, tmp_path, cache):
    config = replace(config, epochs=2)
    whole = train(replace(config, epochs=3), tmp_path / "whole", cache=cache, progress=False)
    train(config, tmp_path / "run", cache=cache, progress=False)
    more = replace(config, epochs=3)
    run = train(more, tmp_path / "run", resume=True, cache=cache, progress=False)
    assert metrics(run) == metrics(whole)


def test_one_cycle_goes_up_and_then_down_to_almost_nothing(config, tmp_path, cache):
    config = replace(config, schedule="one-cycle")
    run = train(config, tmp_path / "run", cache=cache, progress=False)
    (state,) = torch.load(run / "checkpoints" / "last.ckpt", weights_only=True)["lr_schedulers"]
    assert state["total_steps"] == state["last_epoch"] == 12
    assert state["_last_lr"][0] < 0.03 * config.learning_rate
    with pytest.raises(RunError, match="was trained with epochs 4, and 5 is asked for"):
        train(replace(config, epochs=5), run, resume=True, cache=cache, progress=False)


@pytest.mark.parametrize("validation_fraction", [0.0, 0.25])
def test_a_run_that_diverges_stops_and_keeps_the_epochs_before(
    config, tmp_path, cache, monkeypatch, validation_fraction
):
    config = replace(config, epochs=2, validation_fraction=validation_fraction)
    with pytest.raises(RunError, match=r"loss of epoch 0 is not finite: .*rate 1e\+30 has diverge"):
        train(replace(config, learning_rate=1e30), tmp_path / "a", cache=cache, progress=False)
    assert not (tmp_path / "a" / "calibration.json").exists()

    # In the second epoch, the first one's checkpoints stay.
    from slicematch.training.module import TrainingModule

    step = TrainingModule.training_step

    def diverging_step(self, batch, number):
        if self.current_epoch == 1:
            with torch.no_grad():
                next(self.model.parameters()).fill_(torch.inf)
        return step(self, batch, number)

    monkeypatch.setattr(TrainingModule, "training_step", diverging_step)
    with pytest.raises(RunError, match=r"loss of epoch 1 is not finite"):
        train(config, tmp_path / "b", cache=cache, progress=False)
    assert [line["epoch"] for line in metrics(tmp_path / "b")] == [0]
    for which in ("best", "last"):
        assert all(value.isfinite().all() for value in weights(tmp_path / "b", which).values())


def test_an_epoch_whose_last_step_diverges_leaves_no_checkpoint(config, tmp_path, cache):
    config = replace(config, batch_size=8, learning_rate=1e30, epochs=1)  # one step
    with pytest.raises(RunError, match=r"validation score of epoch 0 is not finite"):
        train(config, tmp_path / "run", cache=cache, progress=False)
    assert not (tmp_path / "run" / "checkpoints").exists()


def test_losses_differ_from_seed_to_seed(config, tmp_path, cache):
    config = replace(config, epochs=1)
    one, again, other = (
        metrics(train(replace(config, seed=seed), tmp_path / name, cache=cache, progress=False))
        for name, seed in (("one", 0), ("again", 0), ("other", 1))
    )
    assert one == again
    assert one != other


@pytest.mark.parametrize("precision", ["bf16-mixed"])
def test_mixed_precision(config, tmp_path, cache, precision):
    config = replace(config, precision=precision, epochs=1)
    full = train(replace(config, precision="32-true"), tmp_path / "a", cache=cache, progress=False)
    mixed = train(config, tmp_path / "b", cache=cache, progress=False)
    one, other = (metrics(run)[0]["train/loss"] for run in (full, mixed))
    assert one != other
    assert one == pytest.approx(other, rel=0.05)


def test_training_without_validation_keeps_the_checkpoint_of_least_loss(config, tmp_path, cache):
    config = replace(config, validation_fraction=0.0)
    run = train(config, tmp_path / "run", cache=cache, progress=False)
    losses = [line["train/loss"] for line in metrics(run)]
    checkpoint = torch.load(run / "checkpoints" / "best.ckpt", weights_only=True)
    assert checkpoint["epoch"] == losses.index(min(losses))


@pytest.mark.parametrize(
    "settings",
    [
        {"heading_half_width_deg": 0.0, "train_grid": "3x3x1", "test_grid": "4x4x1"},
        {"heading_half_width_deg": 45.0, "place_prior": (0.5, 0.5, 0.4)},
        {"cross_view_attention": False, "alpha": None},
        {"grid_jitter": True, "near_negatives": 3},
        {"grid_jitter": True, "near_negatives": 3, "heading_half_width_deg": 0.0},
    ],
)
def test_priors_and_ablations_train(config, tmp_path, cache, settings):
    config = replace(config, **settings, epochs=1)
    run = train(config, tmp_path / "run", cache=cache, progress=False)
    assert 0 < metrics(run)[0]["train/loss"] < 20


def test_an_unreadable_sample_leaves_a_trace_and_the_epoch_goes_on(config, tmp_path, cache):
    root = shutil.copytree(config.root, tmp_path / "vigor")
    broken = sorted((root / "Chicago" / "panorama").iterdir())[0]
    broken.write_bytes(broken.read_bytes()[:100])
    config = replace(config, root=str(root), epochs=1, validation_fraction=0.0)
    run = train(config, tmp_path / "run", cache=cache, progress=False)
    assert metrics(run)[0]["step"] == 4
    assert broken.name in (run / "bad_samples.jsonl").read_text()

    with pytest.raises(DatasetError, match="more than 0 samples are unreadable"):
        train(replace(config, max_bad_samples=0), tmp_path / "b", cache=cache, progress=False)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({}, []),
        ({"extent": (0.45, 0.45, 0.55, 0.55)}, ["8 of the 8 true places"]),
    ],
)
def test_true_places_outside_the_grid_are_counted_at_the_start(
    config, tmp_path, cache, caplog, settings, said
):
    config = replace(config, epochs=1, **settings)
    train(config, tmp_path / "run", cache=cache, progress=False)
    found = [record.message for record in caplog.records if "true places" in record.message]
    assert len(found) == len(said)
    assert all(message.startswith(text) for message, text in zip(found, said, strict=True))


def test_nothing_is_overwritten_and_nothing_left_behind(config, tmp_path, cache):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(RunError, match="is not empty"):
        train(config, folder, cache=cache, progress=False)
    with pytest.raises(DatasetError, match="there is no such folder"):
        train(replace(config, root="nowhere"), tmp_path / "b", cache=cache, progress=False)
    assert not (tmp_path / "b").exists()


def test_machines_that_are_not_there(config, tmp_path, cache):
    for settings, said in (
        ({"accelerator": "abacus"}, "device 'abacus' cannot be used; choose auto, cpu, cuda"),
        ({"accelerator": "mps"}, "device 'mps' cannot be used; choose auto, cpu, cuda"),
        ({"devices": 99}, "devices is 99; on the CPU each is a process, so it must be at most"),
    ):
        with pytest.raises(ConfigError, match=said):
            train(replace(config, **settings), tmp_path / "r", cache=cache, progress=False)
        assert not (tmp_path / "r").exists()
    with pytest.raises(ConfigError, match="device 'mps:0' cannot be used; choose auto, cpu, cuda"):
        choose_device("mps:0")


@pytest.mark.skipif(torch.cuda.is_available(), reason="auto is CUDA here")
@pytest.mark.filterwarnings("ignore:GPU available but not used")
def test_auto_is_never_mps(config, tmp_path, cache, monkeypatch):
    """A Mac, as Lightning sees one."""
    from lightning.pytorch.accelerators import MPSAccelerator

    monkeypatch.setattr(MPSAccelerator, "is_available", staticmethod(lambda: True))
    config = replace(config, accelerator="auto", epochs=1)
    train(config, tmp_path / "run", cache=cache, progress=False)
    assert choose_device("auto") == torch.device("cpu")


def test_settings_asked_for_go_before_the_file_and_the_run(tmp_path):
    run = tmp_path / "run"
    run.mkdir()
    TrainConfig(data="vigor", root="a", tau=0.3, slices=8, seed=5).save(run / "config.yaml")
    (tmp_path / "my.yaml").write_text("tau: 0.2\nslices: 4\n")
    config, folder = plan_run({"slices": 2}, tmp_path / "my.yaml", run, resume=True)
    assert (config.root, config.seed, config.tau, config.slices) == ("a", 5, 0.2, 2)
    assert folder == run
    with pytest.raises(ConfigError, match="setting 'data' is missing"):
        plan_run({"slices": 2}, tmp_path / "my.yaml", run)
    assert str(plan_run({"data": "kitti", "root": "b"})[1]) == os.path.join("runs", "kitti")


def test_a_run_goes_on_with_the_mean_it_began_with(config, tmp_path, cache):
    """Runs of before hold none, and took ImageNet's."""
    config = replace(config, epochs=1)
    own = replace(config, image_mean=(0.1, 0.2, 0.3), image_std=(0.4, 0.5, 0.6))
    imagenet = ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
    for name, settings, expected in (
        ("own", own, ((0.1, 0.2, 0.3), (0.4, 0.5, 0.6))),
        ("old", replace(config, image_mean=imagenet[0], image_std=imagenet[1]), imagenet),
    ):
        run = train(settings, tmp_path / name, cache=cache, progress=False)
        file = run / "config.yaml"
        kept = file.read_text().splitlines(keepends=True)
        if name == "old":
            new = "image_mean", "image_std", "weights_source", "tile_side_m"
            kept = [line for line in kept if not line.startswith(new)]
            file.write_text("".join(kept))
            assert RunFolder(run).load_config().image_mean is None
        more = replace(config, epochs=2)
        train(more, run, resume=True, cache=cache, progress=False)
        after = RunFolder(run).load_config()
        assert after.normalisation() == (after.image_mean, after.image_std) == expected
        assert after.tile_side_m == pytest.approx(640 * 0.111262)
    other = replace(own, image_mean=(0.5, 0.5, 0.5), epochs=3)
    with pytest.raises(RunError, match=r"was trained with image_mean \(0.1, 0.2, 0.3\)"):
        train(other, tmp_path / "own", resume=True, cache=cache, progress=False)


def test_a_run_keeps_where_its_weights_come_from(config, tmp_path, cache, caplog):
    file = tmp_path / "mine.safetensors"
    save_file(timm.create_model("test_convnext").state_dict(), file)
    caplog.set_level("INFO", "slicematch.training")
    config = replace(config, weights=str(file), epochs=1)
    run = train(config, tmp_path / "run", cache=cache, progress=False)
    source = f"mine.safetensors (sha256 {sha256(file.read_bytes()).hexdigest()[:12]})"
    assert RunFolder(run).load_config().weights_source == source
    said = [record.getMessage() for record in caplog.records if "weights" in record.getMessage()]
    assert said == [f"the encoders start from the weights {source}"]
    file.unlink()  # a resumed run does not ask for them
    train(replace(config, epochs=2), run, resume=True, cache=cache, progress=False)
    assert RunFolder(run).load_config().weights_source == source


@pytest.mark.parametrize(("batch_size", "left"), [(1, 1), (5, 1), (7, None), (2, None)])
def test_images_of_one_cell_train_in_batches_that_their_normalisation_takes(
    config, tmp_path, cache, batch_size, left
):
    """Of 6 samples to train with, a batch of 5 leaves one."""
    config = replace(
        config, encoder="test_resnet", ground_size=(16, 64), aerial_size=16, epochs=1,
        batch_size=batch_size,
    )  # fmt: skip
    if left is None:
        run = train(config, tmp_path / "run", cache=cache, progress=False)
        assert Localizer.load(run, cache=cache).model.cells == 1
        return
    with pytest.raises(ConfigError, match=f"of 6 samples a batch of {left} is left"):
        train(config, tmp_path / "run", cache=cache, progress=False)
    assert not (tmp_path / "run").exists()


def test_resuming_with_other_settings_is_refused(finished, cache):
    config = replace(RunFolder(finished).load_config(), tau=0.2)
    with pytest.raises(RunError, match=r"was trained with tau 0.1, and 0.2 is asked for"):
        train(config, finished, resume=True, cache=cache, progress=False)


class Trap:
    """A pickle that makes a folder when it is loaded."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


@pytest.fixture(scope="module")
def finished(config, tmp_path_factory, cache):
    config = replace(config, epochs=1, validation_fraction=0.0)
    return train(config, tmp_path_factory.mktemp("runs") / "run", cache=cache, progress=False)


@pytest.fixture
def run(finished, tmp_path):
    """A copy of a finished run, to be spoilt."""
    return shutil.copytree(finished, tmp_path / "run")


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (
            lambda folder: shutil.copy(folder / "best.ckpt", folder / "last.ckpt"),
            "last.ckpt: holds weights but no optimizer_states, so it cannot be resumed from",
        ),
        (lambda folder: spoil_weights(folder / "last.ckpt"), "the run has diverged"),
    ],
)
def test_what_cannot_be_resumed_is_left_as_it_was(run, cache, spoil, said):
    spoil(run / "checkpoints")
    (run / "bad_samples.jsonl").write_text('{"name": "a", "error": "b"}\n')
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    config = replace(RunFolder(run).load_config(), epochs=2)
    with pytest.raises(RunError, match=said):
        train(config, run, resume=True, cache=cache, progress=False)
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before


def test_a_run_that_was_moved_knows_its_best_epoch_again(config, tmp_path, cache):
    config = replace(config, epochs=1)
    train(config, tmp_path / "run", cache=cache, progress=False)
    run = (tmp_path / "run").rename(tmp_path / "moved")
    last = torch.load(run / "checkpoints" / "last.ckpt", weights_only=True)
    (state,) = (s for s in last["callbacks"].values() if s["best_model_path"].endswith("best.ckpt"))
    assert state["best_model_score"] == metrics(run)[0]["validation/place_mean_m"]
    state["best_model_score"].zero_()  # no epoch can be better
    state["kth_value"].zero_()
    for score in state["best_k_models"].values():
        score.zero_()
    torch.save(last, run / "checkpoints" / "last.ckpt")
    before = (run / "checkpoints" / "best.ckpt").read_bytes()
    train(replace(config, epochs=3), run, resume=True, cache=cache, progress=False)
    assert (run / "checkpoints" / "best.ckpt").read_bytes() == before
    assert sorted(path.name for path in (run / "checkpoints").iterdir()) == [
        "best.ckpt",
        "last.ckpt",
    ]


def test_a_resumed_run_keeps_its_list_of_bad_samples(run, cache):
    (run / "bad_samples.jsonl").write_text('{"name": "a", "error": "b"}\n')
    config = replace(RunFolder(run).load_config(), epochs=2)
    train(config, run, resume=True, cache=cache, progress=False)
    assert (run / "bad_samples.jsonl").read_text() == '{"name": "a", "error": "b"}\n'


def test_a_hostile_checkpoint_runs_nothing(run, tmp_path, cache):
    sprung = tmp_path / "sprung"
    for which in ("best", "last"):
        path = run / "checkpoints" / f"{which}.ckpt"
        content = torch.load(path, weights_only=True)
        torch.save({**content, "callbacks": Trap(sprung)}, path)
        with pytest.raises(RunError, match=f"{which}.ckpt: is not a checkpoint of plain values"):
            Localizer.load(run, checkpoint=which, cache=cache)
    config = RunFolder(run).load_config()
    with pytest.raises(RunError, match=r"last.ckpt: is not a checkpoint of plain values"):
        train(replace(config, epochs=2), run, resume=True, cache=cache, progress=False)
    assert not sprung.exists()


def spoil_weights(path):
    content = torch.load(path, weights_only=True)
    next(iter(content["state_dict"].values())).fill_(torch.nan)
    torch.save(content, path)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda run: shutil.rmtree(run / "checkpoints"), "there is no such checkpoint"),
        (lambda run: (run / "config.yaml").unlink(), "is no run folder"),
        (lambda run: (run / "checkpoints/best.ckpt").write_bytes(b"x"), "is not a checkpoint"),
        (lambda run: torch.save([1], run / "checkpoints/best.ckpt"), "holds no weights"),
        (lambda run: torch.save({"state_dict": {"a": 1}}, run / "checkpoints/best.ckpt"), "fit"),
        (
            lambda run: (run / "config.yaml").write_text(
                (run / "config.yaml").read_text().replace("test_convnext", "test_resnet")
            ),
            "does not fit",
        ),
        (lambda run: (run / "config.yaml").open("a").write("evil: 1\n"), "'evil' is unknown"),
        (lambda run: (run / "config.yaml").write_text("tau: 1"), "is cut short, it lacks data"),
        (lambda run: spoil_weights(run / "checkpoints/best.ckpt"), "the run has diverged"),
    ],
)
def test_spoilt_runs_are_refused_in_one_sentence(run, cache, spoil, said):
    spoil(run)
    with pytest.raises((RunError, ConfigError), match=said) as caught:
        Localizer.load(run, cache=cache)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("spoilt", ['{"name": "b", "err', '{"name": "b"', "\0\0\0"])
def test_half_a_line_of_a_list_of_bad_samples(run, cache, spoilt):
    """As a kill leaves it: the run goes on, and the list is whole again."""
    (run / "bad_samples.jsonl").write_text('{"name": "a", "error": "b"}\n' + spoilt)
    config = replace(RunFolder(run).load_config(), epochs=2)
    train(config, run, resume=True, cache=cache, progress=False)
    assert (run / "bad_samples.jsonl").read_text() == '{"name": "a", "error": "b"}\n'


def cut(count):
    return lambda content: content[:-count]


@pytest.mark.parametrize(
    ("spoil", "epochs"),
    [
        (lambda content: content + b'{"epoch": 1, "st', [0, 1]),
        (lambda content: content + b'{"epoch": 1, "step": 8}\n', [0, 1]),
        (cut(1), [1]),
        (cut(20), [1]),
        (lambda content: b"\0" * len(content), [1]),
        (lambda content: b"", [1]),
    ],
)
def test_half_a_line_of_metrics(run, cache, spoil, epochs):
    file = run / "metrics.jsonl"
    file.write_bytes(spoil(file.read_bytes()))
    config = replace(RunFolder(run).load_config(), epochs=2)
    train(config, run, resume=True, cache=cache, progress=False)
    assert [line["epoch"] for line in metrics(run)] == epochs
    assert metrics(run) == RunFolder(run).load_metrics()


@pytest.mark.parametrize("spoil", [lambda run: (run / "metrics.jsonl").write_text("{"), None])
def test_the_command_says_what_the_metrics_hold(run, cache, spoil):
    options = ["train", "--out", str(run), "--resume", "--cache", str(cache), "--json"]
    if spoil is not None:
        spoil(run)
    result = CliRunner().invoke(main, options)
    assert result.exit_code == 0, result.output
    content = json.loads(result.stdout)
    assert content["epochs"] == (1 if spoil is None else 0)
    assert content["last_epoch"] == (metrics(run)[0] if spoil is None else {})


@pytest.mark.parametrize("content", ["", '{\n "temperature": 0.', "[]", "\0\0"])
def test_a_spoilt_calibration_is_written_anew(config, tmp_path, cache, content):
    run = train(replace(config, epochs=1), tmp_path / "run", cache=cache, progress=False)
    file = run / "calibration.json"
    whole = file.read_text()
    file.write_text(content)
    with pytest.raises(RunError, match="write it again with `slicemask calibrate`"):
        Localizer.load(run, cache=cache)
    calibrate(run, cache=cache)
    assert file.read_text() == whole
    file.write_text(content)
    train(replace(config, epochs=2), run, resume=True, cache=cache, progress=False)
    assert Localizer.load(run, cache=cache).calibrated


def test_settings_that_are_cut_short_anywhere_are_refused(run, cache):
    """Defaults never stand in for what a run was trained with."""
    file = run / "config.yaml"
    whole = file.read_bytes()
    kept = RunFolder(run).load_config()
    before = {path: path.read_bytes() for path in run.rglob("*") if path != file and path.is_file()}
    for length in range(0, len(whole), 7):
        file.write_bytes(whole[:length])
        if whole[:length].endswith(b"\n") and b"\ndevices" in whole[:length]:
            assert RunFolder(run).load_config() == kept  # the data set says the rest again
            continue
        with pytest.raises((RunError, ConfigError), match=r"config.yaml") as caught:
            RunFolder(run).load_config()
        assert "\n" not in str(caught.value)
    file.write_bytes(whole[: whole.index(b"learning_rate")])
    with pytest.raises(RunError, match=r"config.yaml: is cut short, it lacks learning_rate; put"):
        plan_run({}, None, run, resume=True)
    assert {path: path.read_bytes() for path in before} == before


def test_labels_off_their_tile_are_counted_aloud_once_a_part(config, tmp_path, cache):
    root = shutil.copytree(config.root, tmp_path / "vigor")
    file = root / "splits__corrected" / "Chicago" / "same_area_balanced_train__corrected.txt"
    lines = file.read_text().splitlines()
    fields = lines[0].split()
    fields[2] = "330.0"  # of the 320 pixels from the tile's centre to its edge
    file.write_text("\n".join([" ".join(fields), *lines[1:]]))
    replace(config, root=str(root), epochs=1).save(tmp_path / "my.yaml")
    arguments = ["train", "--config", tmp_path / "my.yaml", "--out", tmp_path / "run"]
    done = subprocess.run(
        [sys.executable, "-m", "slicemask", *map(str, arguments), "--cache", str(cache)],
        capture_output=True,
        text=True,
        check=True,
    )
    said = [line for line in done.stderr.splitlines() if "off its tile" in line]
    assert said == [
        f"1 of the {part} part's labels are left out, since the camera stands off its tile"
        for part in ("train", "validation")
    ]
