"""The bank file, version 1: every object as the conventions say, readable without slicemask."""

import hashlib
import itertools
import json
import os
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from anndata.io import read_elem

import slicemask
from slicemask import (
    BankFormatError,
    BankSpec,
    Frustum,
    PoseGrid,
    build_bank,
    open_bank,
    slice_masks,
)
from slicemask.bank.build import MemoryLimits

TINY = Path(__file__).parent / "data" / "tiny_v1.h5"
DATASETS = {
    "masks/data": np.float32,
    "masks/indices": np.int32,
    "masks/indptr": np.int64,
    "index": np.int32,
    "poses": np.float64,
}


@pytest.fixture(params=["listed", "gridded"])
def path(request):
    return request.getfixturevalue(request.param)


def test_objects_and_dtypes_are_those_of_the_format(path):
    with h5py.File(path) as file:
        found = {}
        file.visititems(lambda name, thing: found.update({name: thing}))
        assert set(found) == {"masks", *DATASETS}
        assert isinstance(found["masks"], h5py.Group)
        for name, dtype in DATASETS.items():
            assert file[name].dtype == np.dtype(dtype), name
            assert file[name].dtype.byteorder in "=<", name


def test_datasets_are_chunked_shuffled_compressed_and_checksummed(path):
    with h5py.File(path) as file:
        for name in DATASETS:
            dataset = file[name]
            assert dataset.chunks is not None
            assert dataset.shuffle
            assert dataset.compression == "gzip"
            assert dataset.fletcher32


def test_attributes_are_those_of_the_format(path):
    with h5py.File(path) as file:
        assert set(file.attrs) == {"format", "version", "spec"}
        assert file.attrs["format"] == b"slicemask-bank"
        assert file.attrs["version"] == 1
        assert set(file["masks"].attrs) == {"encoding-type", "encoding-version", "shape"}
        assert file["masks"].attrs["encoding-type"] == "csr_matrix"
        assert file["masks"].attrs["encoding-version"] == "0.1.0"
        cells = json.loads(file.attrs["spec"])["cells"]
        rows = len(file["masks/indptr"]) - 1
        assert file["masks"].attrs["shape"].tolist() == [rows, cells * cells]


def test_the_seal_is_three_lines_that_vouch_for_the_rest(path):
    content = path.read_bytes()
    lines = content[:512].rstrip(b"\0").decode().splitlines()
    assert lines == [
        "slicemask-bank 1",
        f"bytes {len(content)}",
        f"sha256 {hashlib.sha256(content[512:]).hexdigest()}",
    ]
    assert content[512:520] == b"\x89HDF\r\n\x1a\n"


def test_h5py_alone_gives_the_masks(path):
    with h5py.File(path) as file:
        spec = json.loads(file.attrs["spec"])
        poses, index = file["poses"][:], file["index"][:]
        data, cell, start = (file[f"masks/{name}"][:] for name in ("data", "indices", "indptr"))
    cells, frustum = spec["cells"], Frustum(**spec["frustum"])
    dense = np.zeros((len(start) - 1, cells * cells), dtype=np.float32)
    for row, (first, last) in enumerate(itertools.pairwise(start)):
        dense[row, cell[first:last]] = data[first:last]
    masks = dense[index].reshape(len(poses), frustum.slices, cells, cells)
    assert np.abs(masks - slice_masks(poses, frustum, cells)).max() < 1e-7


def test_anndata_reads_the_masks(path):
    with h5py.File(path) as file:
        found = read_elem(file["masks"])
    with open_bank(path) as bank:
        expected = bank.csr()
    assert found.dtype == np.float32
    assert found.shape == expected.shape
    for name in ("data", "indices", "indptr"):
        assert np.array_equal(getattr(found, name), getattr(expected, name)), name


def test_rows_ascend_hold_no_zeros_and_are_all_used(path):
    with h5py.File(path) as file:
        data, cell, start = (file[f"masks/{name}"][:] for name in ("data", "indices", "indptr"))
        index = file["index"][:]
    assert start[0] == 0
    assert start[-1] == len(data) == len(cell)
    for first, last in itertools.pairwise(start):
        assert (np.diff(cell[first:last]) > 0).all()
    assert data.min() > 0.0
    assert data.max() <= 1.0
    assert np.array_equal(np.unique(index), np.arange(len(start) - 1))


def test_rows_are_the_distinct_slices(gridded):
    # Inside the tile a slice is its place and its edges. (Where one cell holds two slices whole,
    # their masks may be equal; they are two slices for all that.)
    with open_bank(gridded) as bank:
        left = bank.poses[:, 2:] + bank.spec.frustum.edge_offsets_deg()[:-1]
        right = bank.poses[:, 2:] + bank.spec.frustum.edge_offsets_deg()[1:]
        place = np.repeat(bank.poses[:, None, :2], bank.spec.frustum.slices, axis=1)
        slices = np.concatenate([place, (left % 360)[..., None], (right - left)[..., None]], axis=2)
        slices = slices.reshape(-1, 4).round(9)
        assert len(np.unique(slices, axis=0)) == bank.rows
        pairs = np.column_stack([slices, bank.index.ravel()])
        assert len(np.unique(pairs, axis=0)) == bank.rows


def test_no_two_rows_are_equal(listed):
    with open_bank(listed) as bank:
        dense = bank.csr().toarray()
    assert len(np.unique(dense.round(6), axis=0)) == len(dense)


def test_poses_of_a_grid_are_the_grid_s(gridded):
    grid = PoseGrid.parse("5x4x8")
    with open_bank(gridded) as bank:
        assert len(bank) == 160
        assert bank.spec.grid == grid
        assert np.array_equal(bank.poses, grid.poses())
        k = grid.index(3, 2, 5)
        assert bank.poses[k].tolist() == [2.5 / 4, 3.5 / 5, 225.0]


def test_poses_of_a_list_are_the_list_in_its_order(listed, poses):
    with open_bank(listed) as bank:
        assert bank.spec.grid is None
        assert np.array_equal(bank.poses, poses)
        assert np.array_equal(bank.index[0], bank.index[9])  # equal poses, equal rows


def test_masks_come_pose_by_pose_and_together(path):
    with open_bank(path) as bank:
        every = bank.masks(np.arange(len(bank)))
    with open_bank(path) as bank:  # a fresh one has nothing in memory
        assert np.array_equal(bank.masks(3), every[3])
        assert np.array_equal(bank.masks([[2, 0], [2, 9]]), every[[[2, 0], [2, 9]]])
        assert bank.masks([]).shape == (0, *every.shape[1:])
        rows = bank.csr().toarray()[bank.index]
    assert np.array_equal(rows.reshape(every.shape), every)


@pytest.mark.parametrize(("pose", "words"), [(-1, "-1"), (160, "0 to 159"), (1.5, "whole number")])
def test_a_pose_that_is_not_there_is_named(gridded, pose, words):
    with open_bank(gridded) as bank, pytest.raises(slicemask.PoseError, match=words):
        bank.masks(pose)


def test_a_closed_bank_says_so(gridded):
    bank = open_bank(gridded)
    bank.close()
    with pytest.raises(slicemask.BankError, match="closed"):
        _ = bank.poses


def test_the_spec_is_complete(path, tmp_path):
    with open_bank(path) as bank:
        spec, poses = bank.spec, bank.poses
    again = build_bank(
        spec.grid or poses, spec.frustum, spec.cells, engine=spec.engine, out=tmp_path / "again.h5"
    ).path
    assert again.read_bytes() == path.read_bytes()
    assert BankSpec.from_json(spec.to_json()) == spec
    assert spec.versions["slicemask"] == slicemask.__version__
    assert {"numpy", "h5py", "hdf5", "shapely", "geos"} <= set(spec.versions)


@pytest.mark.parametrize(
    "digest",
    [
        {"count": 0, "sha256": "0" * 64},
        {"count": 2**31, "sha256": "0" * 64},
        {"count": "3", "sha256": "0" * 64},
        {"count": 3, "sha256": 5},
        {"count": 3, "sha256": "0" * 63},
    ],
)
def test_a_spec_with_an_impossible_digest_is_refused(digest):
    text = json.dumps({"poses": digest, "frustum": {}, "cells": 2})
    with pytest.raises(BankFormatError, match="the spec cannot be read"):
        BankSpec.from_json(text)


@pytest.mark.parametrize("engine", ["shapely", "rays"])
def test_the_same_bytes_whatever_the_threads_the_folder_and_the_process(
    tmp_path, run_python, engine
):
    grid, frustum = PoseGrid.parse("15x9x16"), Frustum(200, 5)  # more than one batch
    one = build_bank(grid, frustum, 24, engine=engine, out=tmp_path / "one.h5", jobs=1).path
    (tmp_path / "elsewhere").mkdir()
    two = build_bank(grid, frustum, 24, engine=engine, cache=tmp_path / "elsewhere", jobs=3).path
    three = tmp_path / "three.h5"
    program = (
        "import sys; from slicemask import *\n"
        "build_bank(PoseGrid.parse('15x9x16'), Frustum(200, 5), 24, engine=sys.argv[1],"
        " out=sys.argv[2], jobs=2)"
    )
    ran = run_python(program, engine, three, env={"PYTHONHASHSEED": "7"})
    assert ran.returncode == 0, ran.stderr
    assert one.read_bytes() == two.read_bytes() == three.read_bytes()


def test_the_same_bytes_when_many_batches_race(tmp_path):
    grid, frustum = PoseGrid.parse("12x12x8"), Frustum(300, 4)
    limits = MemoryLimits(batch_slices=64)
    one = build_bank(grid, frustum, 16, out=tmp_path / "one.h5", jobs=1, limits=limits).path
    two = build_bank(grid, frustum, 16, out=tmp_path / "two.h5", jobs=4, limits=limits).path
    assert one.read_bytes() == two.read_bytes()


def test_the_same_bytes_where_the_index_is_too_large_for_memory(tmp_path):
    grid, frustum = PoseGrid.parse("5x4x8"), Frustum(300, 4)
    one = build_bank(grid, frustum, 16, out=tmp_path / "one.h5").path
    limits = MemoryLimits(index_bytes=0)
    two = build_bank(grid, frustum, 16, out=tmp_path / "two.h5", limits=limits).path
    assert one.read_bytes() == two.read_bytes()
    assert sorted(os.listdir(tmp_path)) == ["one.h5", "two.h5"]


# The masks of tiny_v1.h5, worked out by hand: four poses, two slices of 90 degrees, 2 x 2 cells.
TINY_POSES = [[0.5, 0.5, 0.0], [0.5, 0.5, 90.0], [0.0, 0.0, 0.0], [0.0, 0.0, 135.0]]
TINY_MASKS = [
    [[[1.0, 0.0], [0.0, 0.0]], [[0.0, 1.0], [0.0, 0.0]]],
    [[[0.0, 1.0], [0.0, 0.0]], [[0.0, 0.0], [0.0, 1.0]]],
    [[[0.0, 0.0], [0.0, 0.0]], [[0.0, 0.0], [0.0, 0.0]]],
    [[[0.5, 1.0], [0.0, 0.5]], [[0.5, 0.0], [1.0, 0.5]]],
]


def test_a_bank_of_version_1_is_read_for_ever():
    with open_bank(TINY) as bank:
        assert bank.poses.tolist() == TINY_POSES
        assert bank.masks(range(4)).tolist() == TINY_MASKS
        assert bank.csr().toarray()[bank.index].reshape(4, 2, 2, 2).tolist() == TINY_MASKS
        assert bank.rows == 6
        assert bank.spec.frustum == Frustum(hfov_deg=180.0, slices=2)
        assert bank.spec.cells == 2


def test_a_bank_of_version_1_is_reused(tmp_path):
    path = Path(shutil.copy(TINY, tmp_path / "tiny.h5"))
    assert build_bank(TINY_POSES, Frustum(180, 2), 2, out=path).reused
    assert path.read_bytes() == TINY.read_bytes()
