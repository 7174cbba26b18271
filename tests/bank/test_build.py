"""Building: reuse and refusal, two builders at once, leftovers, memory, the masks themselves."""

import contextlib
import errno
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import filelock
import numpy as np
import pytest

import slicemask.bank.build as build
import slicemask.bank.rows as rows_module
import slicemask.bank.write as write
from slicemask import (
    BankError,
    BankExistsError,
    BankFormatError,
    Frustum,
    PoseGrid,
    SpecError,
    build_bank,
    open_bank,
)
from slicemask.bank.build import MemoryLimits

GRID = PoseGrid.parse("3x2x8")
FRUSTUM = Frustum(120, 3)


def files_in(folder):
    return sorted(path.name for path in folder.iterdir())


# Reuse and refusal


def test_a_bank_that_matches_is_reused(tmp_path):
    first = build_bank(GRID, FRUSTUM, 6, cache=tmp_path)
    before = first.path.stat()
    second = build_bank(GRID, FRUSTUM, 6, cache=tmp_path)
    assert (first.reused, second.reused) == (False, True)
    assert second.path == first.path
    assert (before.st_ino, before.st_mtime_ns) == (
        second.path.stat().st_ino,
        second.path.stat().st_mtime_ns,
    )
    assert files_in(tmp_path) == [first.path.name] == ["3x2x8_hfov120_n3_l6.h5"]


def test_force_builds_again(tmp_path):
    first = build_bank(GRID, FRUSTUM, 6, cache=tmp_path)
    content, inode = first.path.read_bytes(), first.path.stat().st_ino
    again = build_bank(GRID, FRUSTUM, 6, cache=tmp_path, force=True)
    assert not again.reused
    assert again.path.stat().st_ino != inode
    assert again.path.read_bytes() == content


@pytest.mark.parametrize(
    ("grid", "frustum", "cells", "engine", "words"),
    [
        (PoseGrid.parse("3x2x9"), FRUSTUM, 6, "shapely", ["3x2x8", "3x2x9"]),
        (PoseGrid(3, 2, 8, places="endpoints"), FRUSTUM, 6, "shapely", ["endpoints"]),
        (PoseGrid(3, 2, 8, (0, 0, 0.5, 1)), FRUSTUM, 6, "shapely", ["extent 0,0,0.5,1"]),
        (GRID, Frustum(121, 3), 6, "shapely", ["hfov 120 deg", "hfov 121 deg"]),
        (GRID, Frustum(120, 4), 6, "shapely", ["3 slices", "4 slices"]),
        (GRID, Frustum(120, 3, "pinhole"), 6, "shapely", ["equirectangular", "pinhole"]),
        (GRID, FRUSTUM, 7, "shapely", ["6x6 cells", "7x7 cells"]),
        (GRID, FRUSTUM, 6, "rays", ["engine shapely", "engine rays"]),
        (GRID.poses(), FRUSTUM, 6, "shapely", ["3x2x8", "48 poses"]),
    ],
)
def test_another_bank_is_refused_and_both_are_named(tmp_path, grid, frustum, cells, engine, words):
    out = build_bank(GRID, FRUSTUM, 6, out=tmp_path / "bank.h5").path
    content = out.read_bytes()
    with pytest.raises(BankExistsError) as caught:
        build_bank(grid, frustum, cells, engine=engine, out=out)
    assert all(word in str(caught.value) for word in [str(out), "--force", *words])
    assert out.read_bytes() == content
    assert not build_bank(grid, frustum, cells, engine=engine, out=out, force=True).reused
    with open_bank(out) as bank:
        assert bank.spec.frustum == frustum
    assert files_in(tmp_path) == ["bank.h5"]


def test_a_link_into_a_folder_that_is_missing_makes_none(tmp_path):
    link = tmp_path / "link.h5"
    link.symlink_to(tmp_path / "missing" / "bank.h5")
    with pytest.raises(BankError, match="there is no such folder"):
        build_bank(PoseGrid(1, 1, 2), out=link)
    assert list(tmp_path.iterdir()) == [link]


@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize("kind", ["text", "hdf5", "folder", "pipe"])
def test_a_foreign_file_is_never_replaced(tmp_path, kind, force):
    out = tmp_path / "bank.h5"
    if kind == "folder":
        out.mkdir()
    elif kind == "pipe":
        os.mkfifo(out)
    elif kind == "hdf5":
        import h5py

        with h5py.File(out, "w") as file:
            file["mine"] = np.arange(3)
    else:
        out.write_text("u,v\n")
    before = out.stat()
    with pytest.raises(BankError, match=r"bank\.h5: .*is "):
        build_bank(GRID, FRUSTUM, 6, out=out, force=force)
    after = out.stat()
    assert (after.st_ino, after.st_size, after.st_mtime_ns) == (
        before.st_ino,
        before.st_size,
        before.st_mtime_ns,
    )
    assert files_in(tmp_path) == ["bank.h5"]


def damage_middle(content):
    return content[:3000] + bytes([content[3000] ^ 1]) + content[3001:]


def cut_short(content):
    return content[:-100]


def cut_within_the_seal(content):
    return content[:100]


def new_version(content):
    return content.replace(b"slicemask-bank 1\n", b"slicemask-bank 2\n")


@pytest.mark.parametrize("damage", [damage_middle, cut_short, cut_within_the_seal, new_version])
def test_a_damaged_bank_is_refused_and_rebuilt_with_force(tmp_path, damage):
    out = build_bank(GRID, FRUSTUM, 6, out=tmp_path / "bank.h5").path
    whole = out.read_bytes()
    out.write_bytes(damage(whole))
    with pytest.raises(BankFormatError, match=r"bank\.h5: .*(--force|build it again)"):
        build_bank(GRID, FRUSTUM, 6, out=out)
    assert out.read_bytes() == damage(whole)
    assert not build_bank(GRID, FRUSTUM, 6, out=out, force=True).reused
    assert out.read_bytes() == whole


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"cells": 0}, "cells is 0"),
        ({"cells": 2.5}, "cells is 2.5"),
        ({"jobs": 0}, "jobs is 0"),
        ({"engine": "magic"}, "engine is 'magic'"),
        ({"poses": PoseGrid(99999, 99999, 99999)}, "bits"),
        ({"poses": PoseGrid(999999999, 999999999, 999999999)}, "bits"),
    ],
)
def test_impossible_arguments_leave_nothing(tmp_path, arguments, words):
    with pytest.raises(SpecError, match=words):
        build_bank(**{"poses": GRID, "frustum": FRUSTUM, "cells": 6, "cache": tmp_path} | arguments)
    assert files_in(tmp_path) == []


# Two builders at once, leftovers, interruption

BUILD = """
import sys
from slicemask import Frustum, PoseGrid, build_bank
result = build_bank(PoseGrid.parse(sys.argv[1]), Frustum(), 32, out=sys.argv[2])
print("reused" if result.reused else "built")
"""


def start_build(grid, out):
    return subprocess.Popen(
        [sys.executable, "-c", BUILD, grid, str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def wait_for(path, seconds=30.0):
    until = time.monotonic() + seconds
    while not path.exists():
        assert time.monotonic() < until, f"{path} did not come"
        time.sleep(0.001)


@pytest.mark.parametrize("stagger", [False, True])
def test_of_two_builders_one_builds_and_the_other_reuses(tmp_path, stagger):
    out = tmp_path / "bank.h5"
    first = start_build("11x11x32", out)
    if stagger:
        wait_for(tmp_path / ".bank.h5.partial")
    second = start_build("11x11x32", out)
    said = [builder.communicate(timeout=60) for builder in (first, second)]
    assert [builder.returncode for builder in (first, second)] == [0, 0], said
    assert sorted(out for out, _ in said) == ["built\n", "reused\n"]
    assert files_in(tmp_path) == ["bank.h5"]
    alone = build_bank(PoseGrid.parse("11x11x32"), out=tmp_path / "alone.h5").path
    assert out.read_bytes() == alone.read_bytes()


def test_a_builder_that_waits_says_so(tmp_path, caplog):
    out = tmp_path / "bank.h5"
    lock = filelock.FileLock(tmp_path / ".bank.h5.lock")
    with lock, ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(build_bank, GRID, FRUSTUM, 6, out=out)
        until = time.monotonic() + 30
        while not caplog.messages and time.monotonic() < until:
            time.sleep(0.01)
        assert not waiting.done()
        lock.release()
        assert not waiting.result(timeout=30).reused
    assert caplog.messages == [f"{out}: waiting until another builder of it ends"]
    assert files_in(tmp_path) == ["bank.h5"]


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="a folder where no file can be made")
def test_a_folder_that_takes_no_files_is_not_waited_for():
    with pytest.raises(BankError, match=r"/proc/x.h5: cannot be written: No such file"):
        build_bank(GRID, FRUSTUM, 6, out="/proc/x.h5")


def test_leftovers_of_a_killed_build_are_taken_over(tmp_path):
    out = tmp_path / "bank.h5"
    builder = start_build("21x21x64", out)
    wait_for(tmp_path / ".bank.h5.partial")
    builder.kill()
    builder.communicate(timeout=30)
    assert ".bank.h5.partial" in files_in(tmp_path)
    assert not out.exists()
    assert not build_bank(GRID, FRUSTUM, 6, out=out).reused
    assert files_in(tmp_path) == ["bank.h5"]
    with open_bank(out) as bank:
        assert bank.spec.grid == GRID


def test_an_interrupt_leaves_nothing(tmp_path):
    out = tmp_path / "bank.h5"
    builder = start_build("64x64x64", out)
    wait_for(tmp_path / ".bank.h5.partial")
    time.sleep(0.3)
    builder.send_signal(signal.SIGINT)
    said, complaint = builder.communicate(timeout=30)
    assert builder.returncode == -signal.SIGINT
    assert said == ""
    assert complaint.rstrip().endswith("KeyboardInterrupt")
    assert files_in(tmp_path) == []


def test_an_error_in_progress_leaves_nothing(tmp_path):
    def fail(done, total):
        if done:
            raise ArithmeticError(f"{done} of {total}")

    with pytest.raises(ArithmeticError, match="48 of 48"):
        build_bank(GRID, FRUSTUM, 6, cache=tmp_path, progress=fail)
    assert files_in(tmp_path) == []


def test_a_file_that_cannot_be_begun_leaves_nothing(tmp_path, monkeypatch):
    def fail(*_, **__):
        raise OSError(errno.ENOSPC, "no")

    monkeypatch.setattr(write.h5py, "File", fail)
    with pytest.raises(BankError, match=r"bank.h5: cannot be written: No space left on device"):
        build_bank(GRID, FRUSTUM, 6, out=tmp_path / "bank.h5")
    assert files_in(tmp_path) == []


@pytest.mark.parametrize("name", ["distinct_slices", "mask_rows", "_empty_index"])
def test_an_error_while_the_file_is_being_begun_leaves_nothing(tmp_path, monkeypatch, name):
    begin = write.BankWriter._begin

    def slowly(writer):
        time.sleep(0.3)
        begin(writer)

    def fail(*_, **__):
        raise ArithmeticError("no")

    monkeypatch.setattr(write.BankWriter, "_begin", slowly)
    monkeypatch.setattr(build, name, fail)
    with pytest.raises(ArithmeticError, match="no"):
        build_bank(GRID, FRUSTUM, 6, cache=tmp_path)
    assert files_in(tmp_path) == []


@pytest.mark.parametrize("only_folder", [False, True])
def test_what_cannot_be_synced(tmp_path, monkeypatch, only_folder):
    """A bank that may not be on the disk is none; a folder that cannot be synced is no matter."""
    sync = write.sync_to_disk

    def fail(path):
        if path.is_dir() or not only_folder:
            raise OSError(errno.EIO, "no")
        sync(path)

    monkeypatch.setattr(write, "sync_to_disk", fail)
    out = tmp_path / "bank.h5"
    if only_folder:
        assert open_bank(build_bank(GRID, FRUSTUM, 6, out=out).path).rows > 0
    else:
        with pytest.raises(BankError, match=r"bank.h5: cannot be written: Input/output error"):
            build_bank(GRID, FRUSTUM, 6, out=out)
    assert files_in(tmp_path) == (["bank.h5"] if only_folder else [])


def test_progress_counts_poses_to_the_last(tmp_path):
    seen = []
    build_bank(
        PoseGrid.parse("6x6x8"),
        FRUSTUM,
        6,
        cache=tmp_path,
        jobs=3,
        progress=lambda *counts: seen.append(counts),
        limits=MemoryLimits(batch_slices=64),
    )
    done = [count for count, _ in seen]
    assert {total for _, total in seen} == {288}
    assert len(done) > 3
    assert done == sorted(done)
    assert done[0] == 0
    assert done[-1] == 288


# Memory

PEAK = """
import re, sys
from pathlib import Path
from slicemask import Frustum, PoseGrid, build_bank
grid = PoseGrid.parse(sys.argv[1])
poses = grid.poses() if sys.argv[2] == "list" else grid
build_bank(poses, Frustum(), 64, engine="rays", cache=sys.argv[3], jobs=2)
# Not ru_maxrss, which a child process takes over from its parent.
print(int(re.search(r"VmHWM:\\s*(\\d+) kB", Path("/proc/self/status").read_text())[1]) / 1024)
"""


@pytest.mark.parametrize("kind", ["grid", "list"])
def test_memory_does_not_grow_with_the_poses(tmp_path, run_python, kind):
    peaks_mib = []
    for grid in ("16x16x16", "40x40x32"):
        ran = run_python(PEAK, grid, kind, tmp_path)
        assert ran.returncode == 0, ran.stderr
        peaks_mib.append(float(ran.stdout))
    # The larger one's 51,200 poses would be 12.5 GiB as dense masks, 0.8 GiB as dense rows.
    assert peaks_mib[1] < 450
    assert peaks_mib[1] - peaks_mib[0] < 120


# The masks

CASES = {
    "panorama": (PoseGrid.parse("3x3x8"), Frustum(360, 4)),
    "panorama of odd slices": (PoseGrid.parse("3x4x6"), Frustum(360, 7)),
    "whole panorama as one slice": (PoseGrid.parse("2x3x4"), Frustum(360, 1)),
    "half planes": (PoseGrid.parse("3x4x8"), Frustum(360, 2)),
    "half planes off the axes": (PoseGrid.parse("3x3x7"), Frustum(360, 2)),
    "one half plane": (PoseGrid.parse("4x4x8"), Frustum(180, 1)),
    "reflex": (PoseGrid.parse("3x3x8"), Frustum(300, 1)),
    "quarters": (PoseGrid.parse("4x4x4"), Frustum(180, 2)),
    "pinhole": (PoseGrid.parse("3x3x12"), Frustum(81.5, 5, "pinhole")),
    "wide pinhole": (PoseGrid.parse("2x2x5"), Frustum(170, 3, "pinhole")),
    "narrow": (PoseGrid.parse("3x3x9"), Frustum(7, 2)),
    "end points": (PoseGrid(3, 4, 8, places="endpoints"), Frustum(360, 8)),
    "end points, half planes": (PoseGrid(3, 3, 8, places="endpoints"), Frustum(360, 2)),
    "end points, reflex": (PoseGrid(3, 3, 8, places="endpoints"), Frustum(300, 1)),
    "end points, 270 degrees": (PoseGrid(2, 2, 8, places="endpoints"), Frustum(270, 1)),
    "one place, end points": (PoseGrid(1, 1, 8, places="endpoints"), Frustum(100, 2)),
    "extent": (PoseGrid(3, 3, 4, (0.2, 0.1, 0.8, 0.7)), Frustum(100, 3)),
    "extent to a corner": (PoseGrid(3, 2, 4, (0.5, 0.5, 1, 1), "endpoints"), Frustum(200, 2)),
    "headings that no symmetry keeps": (PoseGrid.parse("3x3x7"), Frustum(100, 3)),
    "places on the lattice": (PoseGrid(7, 7, 2, places="endpoints"), Frustum(90, 1)),
}


@pytest.mark.parametrize("engine", ["shapely", "rays"])
@pytest.mark.parametrize("case", CASES)
def test_masks_are_those_of_the_plain_loop(tmp_path, plain_masks, case, engine):
    grid, frustum = CASES[case]
    path = build_bank(grid, frustum, 6, engine=engine, cache=tmp_path).path
    with open_bank(path) as bank:
        masks = bank.masks(np.arange(len(bank)))
    # Exact to 1e-9 before they are rounded to float32.
    assert np.abs(masks - plain_masks(grid.poses(), frustum, 6)).max() <= 1e-9 + 2**-25


@pytest.mark.parametrize("cells", [1, 2, 3, 9])
def test_any_number_of_cells(tmp_path, plain_masks, cells):
    grid, frustum = PoseGrid.parse("3x3x6"), Frustum(210, 3)
    path = build_bank(grid, frustum, cells, cache=tmp_path).path
    with open_bank(path) as bank:
        masks = bank.masks(np.arange(len(bank)))
    assert np.abs(masks - plain_masks(grid.poses(), frustum, cells)).max() <= 1e-9 + 2**-25


def random_list(seed):
    """Poses with equal ones, images of others, and cameras on edges, corners and the centre."""
    rng = np.random.default_rng(seed)
    base = np.column_stack([rng.random((12, 2)), 360 * rng.random(12)])
    base[3:6, rng.integers(2)] = rng.integers(2)
    base[6, :2] = rng.integers(2, size=2)
    base[7, :2] = 0.5
    base[8:, 2] = 45.0 * rng.integers(8, size=4)
    mirrored = base * [-1, 1, -1] + [1, 0, 0]
    turned = np.column_stack([1 - base[:, 1], base[:, 0], base[:, 2] + 90])
    poses = np.concatenate([base, base[::-1], mirrored, turned])
    return poses[rng.permutation(len(poses))]


@pytest.mark.parametrize(
    "frustum",
    [Frustum(360, 5), Frustum(360, 2), Frustum(300, 1), Frustum(180, 1), Frustum(60, 3, "pinhole")],
    ids=str,
)
@pytest.mark.parametrize("seed", range(3))
def test_masks_of_lists_are_those_of_the_plain_loop(tmp_path, plain_masks, frustum, seed):
    poses = random_list(seed)
    path = build_bank(poses, frustum, 5, cache=tmp_path).path
    with open_bank(path) as bank:
        masks = bank.masks(np.arange(len(bank)))
        assert bank.rows <= 24 * frustum.slices * 3  # 12 poses, each with its two images
        assert np.allclose(bank.poses[:, :2], poses[:, :2], rtol=0, atol=0)
    assert np.abs(masks - plain_masks(poses, frustum, 5)).max() <= 1e-9 + 2**-25


@pytest.mark.parametrize("most", [1, 7, 1 << 16])
def test_a_list_of_a_grid_s_poses_gives_the_grid_s_masks(tmp_path, most):
    limits = MemoryLimits(batch_slices=most)
    grid, frustum = PoseGrid(4, 5, 6, places="endpoints"), Frustum(200, 4)
    order = np.random.default_rng(0).permutation(len(grid))
    paths = [
        build_bank(grid, frustum, 7, cache=tmp_path, limits=limits).path,
        build_bank(grid.poses(), frustum, 7, cache=tmp_path, limits=limits).path,
        build_bank(grid.poses()[order], frustum, 7, cache=tmp_path, limits=limits).path,
    ]
    masks, rows = [], []
    for path in paths:
        with open_bank(path) as bank:
            masks.append(bank.masks(np.arange(len(grid))))
            rows.append(bank.rows)
    assert np.array_equal(masks[0], masks[1])
    assert np.array_equal(masks[0][order], masks[2])
    assert rows[0] == rows[1] == rows[2]


# Nothing twice


@contextlib.contextmanager
def counted_sectors():
    """A list that grows by the number of sectors of each call of the rays engine."""
    asked, real = [], rows_module.engine_fractions

    def counting(engine, frustum):
        fractions = real(engine, frustum)

        def count(u, *rest):
            asked.append(len(u))
            return fractions(u, *rest)

        return count

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rows_module, "engine_fractions", counting)
        yield asked


@pytest.fixture(scope="module")
def default_bank(tmp_path_factory):
    """The default bank by the rays engine, and the number of sectors that were computed."""
    cache = tmp_path_factory.mktemp("default")
    with counted_sectors() as asked:
        path = build_bank(PoseGrid.parse("21x21x64"), engine="rays", cache=cache).path
    return path, sum(asked)


def test_the_default_grid_has_28224_distinct_slices(default_bank):
    path, _ = default_bank
    with open_bank(path) as bank:
        assert bank.rows == 28_224
        assert len(bank) * bank.spec.frustum.slices == 451_584
        assert np.array_equal(np.unique(bank.index), np.arange(28_224))
    assert path.stat().st_size < 8e6


def test_slice_n_of_a_heading_is_slice_n_plus_1_of_an_earlier_one(default_bank):
    with open_bank(default_bank[0]) as bank:
        index = bank.index.reshape(441, 64, 16)
    assert np.array_equal(index[:, 4:, :-1], index[:, :-4, 1:])
    assert np.array_equal(index[:, :4, :-1], index[:, -4:, 1:])


def test_an_eighth_of_the_distinct_slices_is_computed(default_bank):
    _, computed = default_bank
    # A few more than an eighth: places on the axes of symmetry have fewer images.
    assert 28_224 / 8 <= computed <= 28_224 / 8 * 1.15


@pytest.mark.parametrize(
    ("grid", "frustum", "rows"),
    [
        # All of the tile, whatever the pose.
        (PoseGrid.parse("3x4x5"), Frustum(360, 1), 1),
        # Four vertical lines and four horizontal ones, with two sides each.
        (PoseGrid.parse("4x4x4"), Frustum(180, 1), 16),
        (PoseGrid.parse("4x4x4"), Frustum(360, 2), 16),
        # From a corner, along the edges: all or nothing.
        (PoseGrid(2, 2, 4, places="endpoints"), Frustum(180, 1), 2),
        # Quadrants: from corners all or nothing, from edges 4 halves, from the centre 4 quarters.
        (PoseGrid(3, 3, 4, places="endpoints"), Frustum(360, 4), 2 + 4 + 4),
    ],
)
def test_slices_that_no_place_is_tied_to_are_one_row(tmp_path, grid, frustum, rows):
    path = build_bank(grid, frustum, 4, cache=tmp_path).path
    with open_bank(path) as bank:
        assert bank.rows == rows


def test_images_and_repetitions_cost_no_more_sectors(tmp_path):
    rng = np.random.default_rng(5)
    base = np.column_stack([rng.random((40, 2)), 360 * rng.random(40)])
    turned = np.column_stack([1 - base[:, 1], base[:, 0], base[:, 2] + 90])
    for poses in (base, np.concatenate([base, turned, base])):
        with counted_sectors() as asked:
            build_bank(poses, Frustum(100, 3), 8, engine="rays", cache=tmp_path)
        assert sum(asked) == 120
