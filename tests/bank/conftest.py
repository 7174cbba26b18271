"""Banks that the tests of this folder share."""

import os
import subprocess
import sys

import numpy as np
import pytest

from slicemask import Frustum, PoseGrid, build_bank

# Places inside the tile, on its edges and corners, at its centre; some poses are equal.
POSES = np.array(
    [
        [0.31, 0.47, 12.0],
        [0.69, 0.47, 348.0],
        [0.31, 0.53, 168.0],
        [0.5, 0.5, 0.0],
        [0.5, 0.5, 90.0],
        [0.0, 0.0, 0.0],
        [0.0, 0.0, 135.0],
        [1.0, 0.4, 45.0],
        [0.25, 1.0, 180.0],
        [0.31, 0.47, 12.0],
        [0.0625, 0.9375, 300.0],
    ]
)


@pytest.fixture(scope="session")
def poses():
    """Eleven poses that meet every kind of slice."""
    return POSES


@pytest.fixture(scope="session")
def listed(tmp_path_factory):
    """Path of a bank of `poses`: 3 slices of 50 degrees, 5 x 5 cells."""
    out = tmp_path_factory.mktemp("listed") / "listed.h5"
    return build_bank(POSES, Frustum(150, 3), 5, out=out).path


@pytest.fixture(scope="session")
def gridded(tmp_path_factory):
    """Path of a bank of a 5x4x8 grid: 4 pinhole slices, 8 x 8 cells."""
    out = tmp_path_factory.mktemp("gridded") / "gridded.h5"
    return build_bank(PoseGrid.parse("5x4x8"), Frustum(90, 4, "pinhole"), 8, out=out).path


@pytest.fixture(scope="session")
def run_python():
    """The function that runs a program in a fresh interpreter (see `run_program`)."""
    return run_program


def run_program(program, *arguments, timeout=120, env=None):
    """Run Python text in a fresh interpreter and return the completed process."""
    return subprocess.run(
        [sys.executable, "-c", program, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=timeout,
        env={**os.environ, **(env or {})},
        check=False,
    )
