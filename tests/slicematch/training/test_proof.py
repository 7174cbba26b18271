"""From the command line alone: a small model learns eight pairs of VIGOR, and of KITTI.

Training starts from random weights, is killed on the way and resumed; then all eight test samples
are scored best within one grid step of the truth. (That a resumed run repeats an uninterrupted
one exactly is in test_runs.py.)
"""

import importlib.metadata
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.testing import CliRunner

from slicemask.cli.main import main
from slicemask.cli.run_options import _is_installed, _model_packages

SMALL = [
    "--encoder=test_resnet", "--weights=none", "--stride=8", "--batch-size=8",
    "--learning-rate=3e-3", "--validation-fraction=0", "--workers=0", "--accelerator=cpu",
    "--heat-map-every=40",
]  # fmt: skip


@pytest.fixture
def slicemask(tmp_path):
    """Runs the command with banks of its own; with `wait=False` it gives the process."""
    (tmp_path / "banks").mkdir()
    # One thread: it is enough here, and tests beside each other do not starve.
    environment = {
        **os.environ,
        "OMP_NUM_THREADS": "1",
        "SLICEMASK_CACHE": str(tmp_path / "banks"),
    }

    def run(*arguments, wait=True):
        process = subprocess.Popen(
            [sys.executable, "-m", "slicemask", *map(str, arguments)],
            env=environment,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        if not wait:
            return process
        out, errors = process.communicate(timeout=240)
        assert process.returncode == 0, errors
        return out

    return run


def train_with_a_kill(slicemask, run, *options):
    """Train; kill the process once some epochs are done; resume to the end."""
    process = slicemask("train", *options, "--out", run, wait=False)
    metrics = run / "metrics.jsonl"
    deadline = time.monotonic() + 120
    while not metrics.exists() or len(metrics.read_text().splitlines()) < 5:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    done = len(metrics.read_text().splitlines())
    result = json.loads(slicemask("train", "--out", run, "--resume", "--json"))
    lines = [json.loads(line) for line in metrics.read_text().splitlines()]
    assert [line["epoch"] for line in lines] == list(range(result["epochs"]))
    assert done < result["epochs"]


def check_eight_of_eight(result, step):
    """Every estimate lies within one grid step (u, v, degrees) of the truth."""
    assert result["samples"] == 8
    samples = json.loads(Path(result["folder"], "result.json").read_text())["per_sample"]
    assert len(samples) == 8
    for sample in samples:
        assert abs(sample["u"] - sample["true_u"]) <= step[0], sample
        assert abs(sample["v"] - sample["true_v"]) <= step[1], sample
        assert sample["error_heading_deg"] <= step[2], sample


@pytest.mark.slow
def test_eight_pairs_of_vigor(make_vigor_tree, slicemask, tmp_path):
    tree = make_vigor_tree(tmp_path / "vigor", 8, panorama_size=(128, 256), tile_pixels=160)
    run = tmp_path / "run"
    train_with_a_kill(
        slicemask, run, "--data=vigor", f"--root={tree.root}", "--cities=Chicago",
        "--ground-size=32,128", "--aerial-size=96", "--train-grid=7x7x16", "--test-grid=7x7x16",
        "--epochs=70", *SMALL,
    )  # fmt: skip
    assert (run / "heat_maps" / "epoch_0040.png").stat().st_size > 10_000
    result = json.loads(slicemask("evaluate", run, "--json"))
    check_eight_of_eight(result, (1 / 7, 1 / 7, 360 / 16))
    # A random guess is 20 m off; the oracle among the candidates is below 4 m.
    assert result["errors"]["place_mean_m"] < result["oracle"]["place_mean_m"] + 2

    panorama, tile, d0, d1 = tree.labels["Chicago"][3]
    picture = tmp_path / "overlay.png"
    city = tree.root / "Chicago"
    answer = slicemask(
        "predict", run, "--json", "--ground", city / "panorama" / panorama,
        "--aerial", city / "satellite" / tile, "--metres-per-pixel", 4 * 0.111262,
        "--truth", f"{0.5 - d1 / 640},{0.5 + d0 / 640},0", "--out", picture,
    )  # fmt: skip
    predicted = json.loads(answer)
    # The panorama as it lies in the tree faces north.
    assert min(predicted["heading_deg"], 360 - predicted["heading_deg"]) <= 360 / 16
    metres = 640 * 0.111262
    assert abs(predicted["east_m"] - -d1 / 640 * metres) <= metres / 7
    assert abs(predicted["north_m"] - -d0 / 640 * metres) <= metres / 7
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_eight_pairs_of_kitti(make_kitti_tree, slicemask, tmp_path):
    tree = make_kitti_tree(tmp_path / "kitti", 8, tile_pixels=1024, blocks=22)
    run = tmp_path / "run"
    train_with_a_kill(
        slicemask, run, "--data=kitti", f"--root={tree.root}", "--heading-prior=10",
        "--ground-size=32,128", "--aerial-size=128", "--train-grid=7x7x64",
        "--test-grid=5x5x32", "--epochs=100", *SMALL,
    )  # fmt: skip
    result = json.loads(slicemask("evaluate", run, "--split", "cross-area", "--json"))
    assert result["heading_prior"] == [90.0, 10.0]
    check_eight_of_eight(result, (0.48 / 5, 0.48 / 5, 360 / 32))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["evaluate", "{0}"], "is no run folder"),
        (["predict", "{0}", "--ground", "a.jpg", "--aerial", "b.png"], "is no run folder"),
        (["train", "--data", "vigor"], "setting 'root' is missing"),
        (["train", "--data", "vigor", "--root", "{0}"], "the label file is missing"),
        (["train", "--data", "kitti", "--root", "{0}/no"], "/no: there is no such folder; name"),
        (["train", "--config", "{0}/no.yaml"], "no.yaml: there is no such file"),
        (["train", "--data", "vigor", "--root", "{0}", "--slices", "0"], "slices is 0"),
    ],
)
def test_the_commands_say_in_a_sentence_what_is_wrong(tmp_path, arguments, said):
    result = CliRunner().invoke(main, [text.format(tmp_path) for text in arguments])
    assert result.exit_code == 1
    assert result.stderr.startswith("Error: ")
    assert said in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_without_torch_the_commands_say_what_to_install(monkeypatch):
    find = importlib.metadata.distribution

    def found(name):
        if name == "torch":
            raise importlib.metadata.PackageNotFoundError(name)
        return find(name)

    monkeypatch.setattr(importlib.metadata, "distribution", found)
    result = CliRunner().invoke(main, ["evaluate", "run"])
    assert result.exit_code == 1
    assert "this command needs torch; install: pip install 'slicemask[model]'" in result.stderr


def test_what_the_model_needs_is_what_the_package_says():
    packages = _model_packages()
    assert {"torch", "timm", "lightning", "pyproj", "safetensors", "pyyaml"} <= {*packages}
    assert not {"numpy", "pytest", "trimesh"} & {*packages}
    assert all(map(_is_installed, packages))
    assert not _is_installed("no-such-package-of-anyone")


def test_two_devices(make_vigor_tree, slicemask, tmp_path):
    tree = make_vigor_tree(tmp_path / "vigor", 4, panorama_size=(64, 128), tile_pixels=64)
    out = slicemask(
        "train", "--data=vigor", f"--root={tree.root}", "--cities=Chicago", *SMALL,
        "--ground-size=32,64", "--aerial-size=64", "--train-grid=3x3x4", "--test-grid=3x3x4",
        "--slices=4", "--epochs=1", "--batch-size=1", "--devices=2", "--out", tmp_path / "run",
        "--json",
    )  # fmt: skip
    # Four samples on two devices, one a step: two steps.
    assert json.loads(out)["last_epoch"]["step"] == 2
