"""Training over nodes: two processes on this machine that meet as two nodes do."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from slicematch.runs.config import TrainConfig
from slicematch.training.trainer import is_first_process

ROOT = Path(__file__).parents[3]


def config(**settings):
    return TrainConfig(data="vigor", root="x", encoder="test_convnext", **settings)


@pytest.mark.parametrize(
    ("environment", "first"),
    [
        ({}, True),
        ({"NODE_RANK": "1"}, False),
        ({"RANK": "2", "LOCAL_RANK": "0", "GROUP_RANK": "1"}, False),
        ({"SLURM_PROCID": "0", "LOCAL_RANK": "1"}, False),
        ({"SLURM_PROCID": "3"}, False),
    ],
)
def test_one_process_of_all_nodes_is_the_first(monkeypatch, environment, first):
    for name in ("RANK", "LOCAL_RANK", "NODE_RANK", "GROUP_RANK", "SLURM_PROCID"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert is_first_process(config(num_nodes=2)) == first
    assert is_first_process(config())  # that trains alone, in whatever job


@pytest.mark.slow
def test_two_nodes_take_the_steps_of_one_process(make_vigor_tree, tmp_path):
    tree = make_vigor_tree(tmp_path / "vigor", 4, panorama_size=(64, 128), tile_pixels=64)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    environment = {
        **os.environ,
        "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'model'}",
        "OMP_NUM_THREADS": "1",
        "MASTER_ADDR": "127.0.0.1",
        "MASTER_PORT": str(port),
    }

    def start(out, batch_size, *options, **more):
        return subprocess.Popen(
            [
                sys.executable, "-m", "slicemask", "train", "--data=vigor", f"--root={tree.root}",
                "--cities=Chicago", "--encoder=test_convnext", "--weights=none",
                "--ground-size=32,64", "--aerial-size=64", "--train-grid=3x3x4",
                "--test-grid=3x3x4", "--slices=4", "--epochs=2", f"--batch-size={batch_size}",
                "--learning-rate=0.001", "--validation-fraction=0", "--workers=0",
                "--heat-map-every=0", "--accelerator=cpu", "--cache", tmp_path / "banks", "--out",
                tmp_path / out, *options,
            ],
            env=environment | more, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip

    alone = start("alone", 2)
    assert alone.wait(600) == 0, alone.stdout.read()
    nodes = [start("nodes", 1, "--num-nodes=2", NODE_RANK=str(rank)) for rank in (1, 0)]
    for node in nodes:
        assert node.wait(600) == 0, node.stdout.read()
    losses = [
        [json.loads(line)["train/loss"] for line in (tmp_path / out / "metrics.jsonl").open()]
        for out in ("alone", "nodes")
    ]
    assert len(losses[0]) == 2
    assert losses[1] == pytest.approx(losses[0], rel=1e-3)
    assert losses[0][0] != pytest.approx(losses[0][1], rel=1e-3)  # which a standstill would meet
