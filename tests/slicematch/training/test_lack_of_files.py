"""Commands that load images, under ``ulimit -n``: one sentence, no traceback, no waiting."""

import os
import subprocess
import sys

import pytest

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="limits as Linux has them"),
]

SETTINGS = [
    "--cities=Chicago", "--encoder=test_resnet", "--weights=none", "--ground-size=32,64",
    "--aerial-size=64", "--train-grid=3x3x4", "--test-grid=3x3x4", "--slices=4", "--epochs=1",
    "--batch-size=2", "--accelerator=cpu", "--heat-map-every=0", "--validation-fraction=0.5",
]  # fmt: skip


@pytest.fixture(scope="module")
def trained(make_vigor_tree, tmp_path_factory):
    """A data tree of 40 pairs, a run on it, and the cache of its banks."""
    folder = tmp_path_factory.mktemp("lack")
    make_vigor_tree(folder / "vigor", 40, panorama_size=(64, 128), tile_pixels=64)
    done = slicemask(folder, "train", "--out", folder / "run", "--workers=0")
    assert done.returncode == 0, done.stderr
    return folder


def slicemask(folder, command, *options, files=1024):
    """Run a command that may open so many files."""
    data = ["--data=vigor", *SETTINGS] if command == "train" else []
    return subprocess.run(
        [
            "bash", "-c", f'ulimit -n {files} && exec "$@"', "bash", sys.executable, "-m",
            "slicemask", command, *map(str, options), *data, f"--root={folder / 'vigor'}",
            f"--cache={folder}",
        ],
        capture_output=True, text=True, timeout=180, check=False,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )  # fmt: skip


@pytest.mark.parametrize("command", ["train", "evaluate", "calibrate"])
@pytest.mark.parametrize("files", [28, 32])
def test_one_sentence(trained, tmp_path, command, files):
    where = ["--out", tmp_path / "out"] if command != "calibrate" else []
    run = [] if command == "train" else [trained / "run"]
    done = slicemask(trained, command, *run, *where, "--workers=4", files=files)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == (
        "Error: open files ran out while 4 processes loaded images; allow more (ulimit -n 4096), "
        "or load in fewer processes (--workers 0 for none)"
    )
    assert "Traceback" not in done.stderr
    # And by the remedy it works.
    done = slicemask(trained, command, *run, "--workers=0", *_out(command, tmp_path), files=files)
    assert done.returncode == 0, done.stderr


def _out(command, folder):
    return [] if command == "calibrate" else ["--out", folder / "again"]
