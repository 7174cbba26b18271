"""The compiled loops: the masks that whole arrays give, and what happens where they cannot run."""

import logging
import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from slicemask import Frustum, slice_masks
from slicemask.geometry import compiled
from slicemask.geometry import masks as module

# As likely as any others: lattice lines, the tile's edges, the axes, diagonals, and next to them.
_coordinate = st.one_of(
    st.floats(0, 1),
    st.sampled_from([0.0, 1.0, 0.5, 1 / 3, 1e-12, 1 - 1e-12, 1e-7, 5e-324]),
    st.integers(0, 12).map(lambda k: k / 12),
)
_angle = st.one_of(
    st.floats(-720, 720),
    st.integers(-16, 16).map(lambda k: k * 22.5),
    st.sampled_from([90 - 1e-13, 90 + 1e-13, 1e-13, -1e-14, 1e-308, 179.99999999999997]),
)
_pose = st.tuples(_coordinate, _coordinate, _angle)
_range = st.one_of(st.floats(1e-6, 3), st.sampled_from([1 / 12, 0.25, 0.5, 1.0, 1.5, 2**0.5]))
_bands = st.lists(_range, max_size=4, unique=True).map(lambda some: tuple(sorted(some)))
_frusta = st.one_of(
    st.builds(
        lambda hfov, n, bands: Frustum(hfov, n, bands=bands),
        st.one_of(st.floats(1e-3, 360), st.sampled_from([90.0, 180.0, 360.0, 359.8])),
        st.integers(1, 9), _bands,
    ),
    st.builds(
        lambda hfov, n, bands: Frustum(hfov, n, "pinhole", bands),
        st.floats(1e-3, 179.8), st.integers(1, 9), _bands,
    ),
    st.builds(
        lambda cx, bands: Frustum.from_intrinsics(60, cx, 100, 4, bands),
        st.floats(-50, 150), _bands,
    ),
)  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def _numba_works():
    assert module._compiled() is compiled


def by_arrays(poses, frustum, cells):
    """The masks of poses one at a time, which are not worth compiled loops."""
    return np.concatenate([slice_masks([pose], frustum, cells, "rays") for pose in poses])


@settings(max_examples=400, deadline=None)
@given(st.lists(_pose, min_size=2, max_size=4), _frusta, st.integers(1, 12))
@example([(0.5, 0.5, 0.0), (0.0, 1.0, 45.0)], Frustum(360, 8, bands=(0.25, 0.5)), 4)
@example([(0.5, 0.5, 90.0)] * 2, Frustum(90, 1, "pinhole", (0.25,)), 4)
def test_they_give_what_arrays_give(poses, frustum, cells):
    masks = slice_masks(poses, frustum, cells, "rays")
    # What is below 1e-10 is 0, to either.
    assert np.abs(masks - by_arrays(poses, frustum, cells)).max() <= 2e-10
    assert masks.min() >= 0.0
    assert masks.max() <= 1.0


def test_they_are_what_runs(monkeypatch):
    poses, calls = [[0.5, 0.5, 10.0], [0.3, 0.2, 0.0]], []
    monkeypatch.setattr(compiled, "_write", lambda *arguments: calls.append(arguments))
    slice_masks(poses, Frustum(bands=(0.2,)), 4, "rays")
    assert len(calls) == 1
    slice_masks(poses[:1], Frustum(), 4, "rays")
    slice_masks(poses, Frustum(), 4, "shapely")
    assert len(calls) == 1


@pytest.mark.parametrize("frustum", [Frustum(360, 1), Frustum(360, 2), Frustum(181, 1)])
def test_slices_too_wide_for_them_are_left_to_arrays(frustum):
    assert not compiled.takes(frustum)
    poses = np.random.default_rng(0).random((20, 3)) * [1, 1, 360]
    masks = slice_masks(poses, frustum, 9, "rays")
    assert np.abs(masks - slice_masks(poses, frustum, 9)).max() <= 1e-9


def test_many_poses_are_done_in_parts(monkeypatch):
    poses = np.random.default_rng(0).random((50, 3)) * [1, 1, 360]
    whole = slice_masks(poses, Frustum(), 8, "rays")
    for name, value in (("_VALUES_AT_ONCE", 16 * 8 * 8 * 7), ("_SLICES_AT_ONCE", 16 * 3)):
        monkeypatch.setattr(compiled, name, value)
        assert np.array_equal(slice_masks(poses, Frustum(), 8, "rays"), whole)


def test_they_are_compiled_once_whatever_arrays_come():
    poses = np.random.default_rng(0).random((6, 3))
    frozen = poses.copy()
    frozen.flags.writeable = False
    expected = slice_masks(poses, Frustum(), 4, "rays")
    for some in (np.asfortranarray(poses), frozen, poses.tolist(), np.repeat(poses, 2, 0)[::2]):
        assert np.array_equal(slice_masks(some, Frustum(), 4, "rays"), expected)
    assert len(compiled._write.signatures) == 1


@pytest.fixture
def fresh_choice():
    """That what was found out about numba is found out again, and forgotten after the test."""
    module._compiled.cache_clear()
    yield
    module._compiled.cache_clear()


def test_without_numba_arrays_do_it(monkeypatch, fresh_choice, caplog):
    poses = np.random.default_rng(0).random((20, 3)) * [1, 1, 360]
    frustum = Frustum(bands=(0.1, 0.3))
    expected = slice_masks(poses, frustum, 8, "rays")
    module._compiled.cache_clear()
    monkeypatch.setattr(module, "find_spec", lambda name: None)
    monkeypatch.setattr(compiled, "_write", None)
    masks = slice_masks(poses, frustum, 8, "rays")
    assert np.abs(masks - expected).max() <= 1e-10
    assert not caplog.records


@pytest.mark.parametrize(
    "error",
    [
        ImportError("Numba needs NumPy 2.3 or less. Got NumPy 2.4.\nMore."),
        RuntimeError("cannot cache function '_write': no locator available"),
        OSError(28, "No space left on device"),
        EOFError(),  # a file of its cache that is cut short
    ],
)
def test_a_numba_that_cannot_be_used_is_done_without(monkeypatch, fresh_choice, caplog, error):
    def fail(*_):
        raise error

    monkeypatch.setattr(compiled, "_write", fail)
    poses = [[0.5, 0.5, 10.0], [0.3, 0.2, 0.0]]
    with caplog.at_level(logging.WARNING):
        masks = slice_masks(poses, Frustum(), 8, "rays")
    assert np.array_equal(masks, by_arrays(poses, Frustum(), 8))
    (record,) = caplog.records
    assert (str(error).partition("\n")[0] or "EOFError") in record.message
    assert "More" not in record.message


def test_numba_that_is_switched_off_is_done_without(monkeypatch, fresh_choice, caplog):
    monkeypatch.setattr("numba.config.DISABLE_JIT", True)
    monkeypatch.setattr(compiled, "_write", None)
    assert slice_masks([[0.5, 0.5, 0.0]] * 2, Frustum(), 4, "rays").sum() == 32.0
    assert not caplog.records


def test_a_picture_of_one_pose_does_not_load_numba():
    code = (
        "import sys; from slicemask import Frustum, slice_masks;"
        "slice_masks([[0.5, 0.5, 0]], Frustum(), 8, 'rays'); assert 'numba' not in sys.modules;"
        "slice_masks([[0.5, 0.5, 0]] * 2, Frustum(), 8, 'rays'); assert 'numba' in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, env=os.environ)
