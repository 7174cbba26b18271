"""Precisions: refused or warned of where a device takes for ever to compute in them."""

import logging

import pytest
import torch
from slicematch import devices
from slicematch.errors import ConfigError

CPU = torch.device("cpu")


@pytest.mark.parametrize(("has_bf16", "warnings"), [(False, 1), (True, 0)])
def test_a_processor_without_instructions_for_bf16_is_warned_of(
    monkeypatch, caplog, has_bf16, warnings
):
    monkeypatch.setattr(devices, "_has_bf16", lambda: has_bf16)
    with caplog.at_level(logging.WARNING):
        assert devices.check_precision("bf16-mixed", CPU) == "bf16-mixed"
        devices.check_precision("32-true", CPU)
        devices.check_precision("bf16-mixed", torch.device("cuda"))
    assert len(caplog.records) == warnings


def test_torch_says_whether_there_are_instructions_for_bf16():
    assert devices._has_bf16() in (True, False)


def test_training_refuses_what_answers_refuse(tmp_path):
    from slicematch.runs.config import TrainConfig
    from slicematch.runs.folder import RunFolder
    from slicematch.training.trainer import make_trainer

    config = TrainConfig(data="vigor", root=".", precision="16-mixed", accelerator="cpu")
    with pytest.raises(ConfigError, match="16-mixed' is for GPUs"):
        make_trainer(config, RunFolder(tmp_path), [], progress=False)
