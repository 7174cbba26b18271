"""Builds on file systems that lack locks, fsync or atomic rename, or that may not be written to."""

import errno
import os
import shutil
import subprocess
import sys

import pytest

from slicemask import BankError, Frustum, PoseGrid, build_bank, open_bank

GRID = PoseGrid.parse("3x2x8")
FRUSTUM = Frustum(120, 3)

# What a system call answers instead of working, as on such a file system.
SHIM = """
#include <errno.h>
int flock(int file, int operation) { (void)file; (void)operation; errno = NUMBER; return -1; }
"""
BUILD = """
import sys
from concurrent.futures import ThreadPoolExecutor
from slicemask import Frustum, PoseGrid, build_bank
def build(jobs):
    return build_bank(PoseGrid.parse("3x2x8"), Frustum(120, 3), 6, out=sys.argv[1], jobs=jobs)
builders = int(sys.argv[2])
with ThreadPoolExecutor(builders) as pool:
    results = list(pool.map(build, [1] * builders))
print(len({result.rows for result in results}))
"""


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The bytes of the bank that every test builds."""
    out = tmp_path_factory.mktemp("whole") / "bank.h5"
    return build_bank(GRID, FRUSTUM, 6, out=out).path.read_bytes()


@pytest.mark.skipif(sys.platform != "linux", reason="preloads a library as Linux does")
@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
@pytest.mark.parametrize("builders", [1, 2])
@pytest.mark.parametrize("name", ["ENOSYS", "ENOLCK", "EOPNOTSUPP"])
def test_where_there_are_no_locks_a_bank_is_built_and_nothing_left(
    tmp_path, run_python, whole, name, builders
):
    (tmp_path / "shim.c").write_text(SHIM.replace("NUMBER", name))
    shim = tmp_path / "shim.so"
    subprocess.run(["cc", "-shared", "-fPIC", "-o", shim, tmp_path / "shim.c"], check=True)
    folder = tmp_path / "banks"
    folder.mkdir()
    out = folder / "bank.h5"
    ran = run_python(BUILD, out, builders, env={"LD_PRELOAD": str(shim)}, timeout=60)
    assert (ran.returncode, ran.stdout) == (0, "1\n"), ran.stderr
    lines = ran.stderr.splitlines()
    assert 1 <= len(lines) <= builders
    assert all("its file system has no file locks" in line for line in lines)
    assert os.listdir(folder) == ["bank.h5"]
    assert out.read_bytes() == whole


@pytest.mark.parametrize("number", [errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP])
def test_locks_that_fail_only_when_they_are_taken(tmp_path, monkeypatch, caplog, whole, number):
    import filelock

    def fail(*_, **__):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(filelock.FileLock, "acquire", fail)
    out = build_bank(GRID, FRUSTUM, 6, out=tmp_path / "bank.h5").path
    assert out.read_bytes() == whole
    assert len(caplog.messages) == 1
    assert os.listdir(tmp_path) == ["bank.h5"]


def failing(function, number, when=lambda *arguments: True):
    def fail(*arguments, **options):
        if when(*arguments):
            raise OSError(number, os.strerror(number))
        return function(*arguments, **options)

    return fail


@pytest.mark.parametrize("number", [errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP])
def test_where_there_is_no_fsync_a_bank_is_built(tmp_path, monkeypatch, whole, number):
    monkeypatch.setattr(os, "fsync", failing(os.fsync, number))
    assert build_bank(GRID, FRUSTUM, 6, out=tmp_path / "bank.h5").path.read_bytes() == whole
    assert os.listdir(tmp_path) == ["bank.h5"]


@pytest.mark.parametrize("number", [errno.EXDEV, errno.EPERM, errno.EEXIST, errno.ENOSYS])
@pytest.mark.parametrize("existing", [False, True])
def test_where_a_file_cannot_be_renamed_a_sentence_names_a_way_round(
    tmp_path, monkeypatch, number, existing
):
    out = tmp_path / "bank.h5"
    if existing:
        build_bank(PoseGrid(1, 1, 2), FRUSTUM, 6, out=out)
    before = out.read_bytes() if existing else None
    monkeypatch.setattr(os, "replace", failing(os.replace, number))
    with pytest.raises(BankError, match=r"cannot be written: .*with --cache, or .* with --out$"):
        build_bank(GRID, FRUSTUM, 6, out=out, force=True)
    assert os.listdir(tmp_path) == (["bank.h5"] if existing else [])
    assert not existing or out.read_bytes() == before


def test_hard_links_are_not_needed(tmp_path, monkeypatch, whole):
    monkeypatch.setattr(os, "link", failing(os.link, errno.EPERM))
    assert build_bank(GRID, FRUSTUM, 6, out=tmp_path / "bank.h5").path.read_bytes() == whole


# The cache folder


@pytest.mark.parametrize("cache", ["new", "new/er/est"])
def test_a_cache_folder_that_is_missing_is_made(tmp_path, cache):
    result = build_bank(GRID, FRUSTUM, 6, cache=tmp_path / cache)
    assert result.path.parent == tmp_path / cache
    assert open_bank(result.path).rows == result.rows


@pytest.mark.parametrize("cache", ["new", "new/er/est"])
def test_a_folder_that_was_made_for_a_failed_build_is_removed(tmp_path, cache):
    def fail(done, total):
        raise ArithmeticError("no")

    with pytest.raises(ArithmeticError):
        build_bank(GRID, FRUSTUM, 6, cache=tmp_path / cache, progress=fail)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("cache", ["file", "file/new"])
def test_a_cache_that_is_a_file_is_named(tmp_path, cache):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(BankError, match=r"file: is not a folder; name another one with --cache"):
        build_bank(GRID, FRUSTUM, 6, cache=tmp_path / cache)
    assert (tmp_path / "file").read_text() == "mine"


READ_ONLY = """
import subprocess, sys
from slicemask import BankError, Frustum, PoseGrid, build_bank
folder, cache = sys.argv[1:]
subprocess.run(["mount", "-t", "tmpfs", "-o", "ro", "none", folder], check=True)
try:
    build_bank(PoseGrid.parse("3x2x8"), Frustum(120, 3), 6, cache=cache)
except BankError as error:
    print(error)
"""


@pytest.mark.parametrize("cache", ["", "new", "new/er"])
def test_a_read_only_cache_is_told_with_its_remedy(tmp_path, cache):
    alone = ["unshare", "--map-root-user", "--mount"]
    if shutil.which("unshare") is None or subprocess.run([*alone, "true"], check=False).returncode:
        pytest.skip("needs Linux and leave to mount a file system in a name space of its own")
    ran = subprocess.run(
        [*alone, sys.executable, "-c", READ_ONLY, tmp_path, tmp_path / cache],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (ran.returncode, ran.stderr) == (0, "")
    assert ran.stdout.startswith(str(tmp_path / cache))
    assert "Read-only file system; name another folder with --cache" in ran.stdout
    assert ran.stdout.count("\n") == 1


def test_an_empty_file_in_a_bank_s_place_is_replaced_by_force(tmp_path, whole):
    out = tmp_path / "3x2x8_hfov120_n3_l6.h5"
    out.touch()
    with pytest.raises(BankError, match=r"exists and is empty, .*; remove it, or .* --force"):
        build_bank(GRID, FRUSTUM, 6, cache=tmp_path)
    assert out.read_bytes() == b""
    with pytest.raises(BankError, match=r"is empty, not a slicemask bank; remove it, or .*--force"):
        open_bank(out)
    assert not build_bank(GRID, FRUSTUM, 6, cache=tmp_path, force=True).reused
    assert out.read_bytes() == whole
