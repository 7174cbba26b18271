"""What a training says on its way where nobody watches a bar."""

import logging
import re
import subprocess
import sys

import pytest
import torch
from slicematch.training.progress import ProgressLines
from torch.utils.data import DataLoader

from slicemask.cli.messages import messages_on_stderr

import lightning.pytorch as lightning  # isort: skip  after the model's modules


class Clock:
    """A clock that each step and each validated batch moves on."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


class Module(lightning.LightningModule):
    """Learns nothing, in steps of given lengths."""

    def __init__(self, clock, step_s, validation_s):
        super().__init__()
        self.weight = torch.nn.Parameter(torch.zeros(()))
        self.clock, self.step_s, self.validation_s = clock, step_s, validation_s

    def configure_optimizers(self):
        return torch.optim.SGD(self.parameters(), lr=0.0)

    def training_step(self, batch, _):
        self.clock.now += self.step_s
        self.log("train/loss", self.weight + 0.5, on_step=True, on_epoch=True, batch_size=1)
        return self.weight

    def validation_step(self, batch, _):
        self.clock.now += self.validation_s
        self.log("validation/place_mean_m", 12.3456, batch_size=1)


def fit(caplog, *, step_s, validation_s=0.0, epochs=2, steps=4, checkpoint=None, folder=None):
    clock = Clock()
    data = DataLoader(torch.zeros(steps))
    trainer = lightning.Trainer(
        accelerator="cpu", max_epochs=epochs, logger=False, enable_progress_bar=False,
        enable_checkpointing=False, enable_model_summary=False, num_sanity_val_steps=0,
        callbacks=[ProgressLines(clock)], limit_val_batches=2 if validation_s else 0,
    )  # fmt: skip
    caplog.set_level("INFO", "slicematch.training")
    caplog.clear()
    trainer.fit(Module(clock, step_s, validation_s), data, data, ckpt_path=checkpoint)
    if folder is not None:
        trainer.save_checkpoint(folder / "last.ckpt")
    return [r.getMessage() for r in caplog.records if r.name == "slicematch.training.progress"]


def test_a_line_an_epoch(caplog):
    assert fit(caplog, step_s=2.0) == [
        "epoch 1 of 2: train/loss 0.5; about 8 s left",
        "epoch 2 of 2: train/loss 0.5",
    ]


def test_a_line_about_every_half_minute(caplog):
    assert fit(caplog, step_s=20.0, steps=6, validation_s=40.0, epochs=1) == [
        "epoch 1 of 1: 2 of 6 steps, about 80 s left",
        "epoch 1 of 1: 4 of 6 steps, about 40 s left",
        "epoch 1 of 1: 6 of 6 steps",
        "epoch 1 of 1: 1 of 2 batches validated",
        "epoch 1 of 1: 2 of 2 batches validated",
        "epoch 1 of 1: train/loss 0.5, validation/place_mean_m 12.35",
    ]


def test_a_resumed_run_counts_the_time_of_its_own_epochs(caplog, tmp_path):
    fit(caplog, step_s=1.0, epochs=2, folder=tmp_path)
    lines = fit(caplog, step_s=5.0, epochs=4, checkpoint=tmp_path / "last.ckpt")
    assert lines == [
        "epoch 3 of 4: train/loss 0.5; about 20 s left",
        "epoch 4 of 4: train/loss 0.5",
    ]


def test_messages_stand_on_stderr_once(capsys):
    log = logging.getLogger("slicematch.some.where")
    log.info("not yet")
    with messages_on_stderr("slicematch"):
        log.info("one")
        log.warning("two")
        log.info("one")
        log.debug("three")
    log.info("no more")
    assert capsys.readouterr().err == "one\ntwo\n"


@pytest.mark.parametrize("json", [[], ["--json"]])
def test_the_command_says_a_line_an_epoch_into_a_pipe(make_vigor_tree, tmp_path, json):
    make_vigor_tree(tmp_path / "vigor", 4, panorama_size=(64, 128), tile_pixels=64)
    done = subprocess.run(
        [
            sys.executable, "-m", "slicemask", "train", "--data=vigor",
            f"--root={tmp_path / 'vigor'}", "--cities=Chicago", "--encoder=test_resnet",
            "--weights=none", "--ground-size=32,64", "--aerial-size=64", "--train-grid=3x3x4",
            "--test-grid=3x3x4", "--slices=4", "--epochs=2", "--batch-size=2", "--workers=0",
            "--accelerator=cpu", "--heat-map-every=0", "--validation-fraction=0.5",
            "--out", tmp_path / "run", "--cache", tmp_path / "banks", *json,
        ],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    lines = [line for line in done.stderr.splitlines() if line.startswith("epoch")]
    assert len(lines) == 2
    assert re.fullmatch(
        r"epoch 1 of 2: train/loss \S+, validation/heading_mean_deg .*; about \d+ s left", lines[0]
    )
    assert re.fullmatch(r"epoch 2 of 2: train/loss \S+, validation/[^;]*", lines[1])
    assert "epoch 1 of" not in done.stdout
