"""Builds that do not come to their end: killed, interrupted, or out of disk space.

Each test runs this file as a program, which imports slicemask once and forks a fresh builder for
every moment it tries.
"""

import errno
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from slicemask import BankError, Frustum, PoseGrid, build_bank
from slicemask.bank.build import MemoryLimits

KILLS, INTERRUPTS, LIMITS, CROWDS = 100, 30, 24, 8
BUILT, REUSED, REFUSED, STOPPED, ELSE = 20, 21, 22, 23, 24
PLAN = {
    "poses": PoseGrid.parse("8x8x8"),
    "frustum": Frustum(300, 4),
    "cells": 16,
    "limits": MemoryLimits(index_bytes=0),  # an index in a file is one more thing to fail
}
OTHER = {"poses": PoseGrid.parse("2x2x4"), "frustum": Frustum(90, 2), "cells": 8}


def fork_builder(out, limit_bytes=None, force=True):
    """Start a build in a fork of this process, and return its id once the build begins."""
    ready, begun = os.pipe()
    child = os.fork()
    if child:
        os.close(begun)
        os.read(ready, 1)
        os.close(ready)
        return child
    os.close(ready)
    try:
        if limit_bytes is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit_bytes, limit_bytes))
        os.write(begun, b"!")
        result = build_bank(**PLAN, out=out, force=force, jobs=2)
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # from here on it is too late
    except KeyboardInterrupt:
        sys.exit(STOPPED)
    except BankError as error:
        # One sentence, which names the file and the system's reason.
        reasons = [os.strerror(number) for number in (errno.EFBIG, errno.ENOSPC)]
        said = str(error)
        one = "\n" not in said and said.startswith(str(out))
        sys.exit(REFUSED if one and any(reason in said for reason in reasons) else ELSE)
    # Interpreters end the usual way, so that HDF5 has its chance to crash at the end.
    sys.exit(REUSED if result.reused else BUILT)


def end_of(child):
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def begin(folder):
    """The bytes of the bank, those of another, and how long a build takes."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    whole = build_bank(**PLAN, out=folder / "whole").path.read_bytes()
    other = build_bank(**OTHER, out=folder / "other").path.read_bytes()
    seconds = []
    for _ in range(5):
        start = time.perf_counter()
        build_bank(**PLAN, out=folder / "whole", force=True, jobs=2)
        seconds.append(time.perf_counter() - start)
    work = folder / "work"
    work.mkdir()
    return work, whole, other, sorted(seconds)[2]


def stop(folder, how, times):
    """Stop builds at random moments, half of them over a bank that is there already."""
    work, whole, other, seconds = begin(folder)
    out = work / "bank.h5"
    rng = random.Random(7)
    wrong = []
    for case in range(times):
        before = other if case % 2 else None
        out.unlink(missing_ok=True)
        if before:
            out.write_bytes(before)
        child = fork_builder(out)
        time.sleep(rng.uniform(0, 1.2 * seconds))
        os.kill(child, how)
        end = end_of(child)
        content = out.read_bytes() if out.exists() else None
        if content not in (before, whole):
            wrong.append(f"case {case}: end {end}, {len(content or b'')} bytes")
        if how == signal.SIGINT:
            assert end in (STOPPED, BUILT), end
            assert sorted(path.name for path in work.iterdir()) in ([], ["bank.h5"])
    # Whatever the last one left, the next build takes over.
    assert end_of(fork_builder(out)) == BUILT
    assert out.read_bytes() == whole
    assert [path.name for path in work.iterdir()] == ["bank.h5"]
    return {"wrong": wrong}


def crowd(folder):
    """Start several builds of one bank at once; in every second crowd, kill one of them."""
    work, whole, _, seconds = begin(folder)
    out = work / "bank.h5"
    rng = random.Random(7)
    for case in range(CROWDS):
        builders = [fork_builder(out, force=False) for _ in range(5)]
        killed = []
        if case % 2:
            time.sleep(rng.uniform(0, seconds))
            killed = [builders.pop(0)]
            os.kill(killed[0], signal.SIGKILL)
        ends = sorted(map(end_of, builders))
        for child in killed:
            end_of(child)
        assert out.read_bytes() == whole
        # The killed one may have been the one that built.
        assert ends in ([BUILT] + [REUSED] * 4, [BUILT] + [REUSED] * 3, [REUSED] * 4), ends
        assert killed or len(ends) == 5
        assert killed or [path.name for path in work.iterdir()] == ["bank.h5"]
        out.unlink()
    return {"crowds": CROWDS}


def fill(folder):
    """Build under limits on the size of files, from nothing to almost enough."""
    work, whole, other, _ = begin(folder)
    out = work / "bank.h5"
    rng = random.Random(7)
    for case in range(LIMITS):
        limit = rng.randrange(len(whole)) if case % 2 else int(len(whole) ** rng.random())
        if case % 3 == 0:
            out.write_bytes(other)
        names = [path.name for path in work.iterdir()]
        end = end_of(fork_builder(out, limit))
        assert end == REFUSED, (limit, end)
        assert [path.name for path in work.iterdir()] == names, limit
        assert case % 3 or out.read_bytes() == other
        out.unlink(missing_ok=True)
    assert end_of(fork_builder(out, len(whole))) == BUILT
    return {"limits": LIMITS}


def fill_disk(folder):
    """Build on a file system that is too small, in a mount space of its own."""
    work, whole, _, _ = begin(folder)
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=256k", "none", work], check=True)
    out = work / "bank.h5"
    free = os.statvfs(work).f_bavail * os.statvfs(work).f_bsize
    ends = []
    for room in range(0, 3 * len(whole), len(whole) // 5):
        (work / "ballast").write_bytes(bytes(max(0, free - room)))
        ends.append(end_of(fork_builder(out)))
        if ends[-1] == BUILT:
            assert out.read_bytes() == whole
            out.unlink()
        assert [path.name for path in work.iterdir()] == ["ballast"]
    return {"ends": ends}


# The tests

TASKS = {
    "kill": lambda folder: stop(folder, signal.SIGKILL, KILLS),
    "interrupt": lambda folder: stop(folder, signal.SIGINT, INTERRUPTS),
    "crowd": crowd,
    "fill": fill,
    "fill_disk": fill_disk,
}


def run_task(task, folder, *before):
    ran = subprocess.run(
        [*before, sys.executable, __file__, task, str(folder)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    said = ran.stderr.splitlines()
    if task == "crowd":  # all but one of them wait
        said = [
            line for line in said if not line.endswith(": waiting until another builder of it ends")
        ]
    # No word from HDF5 or the interpreter, from any builder. (An interrupt may fall into a function
    # that Python calls on its own, such as a weak reference's, where it is reported and lost.)
    assert task == "interrupt" or not said
    assert "HDF5" not in ran.stderr
    assert "h5py" not in ran.stderr
    return json.loads(ran.stdout)


def test_a_killed_build_leaves_what_was_there_or_the_whole_bank(tmp_path):
    assert run_task("kill", tmp_path) == {"wrong": []}


def test_an_interrupted_build_leaves_nothing_behind(tmp_path):
    assert run_task("interrupt", tmp_path) == {"wrong": []}


def test_of_many_builders_at_once_one_builds(tmp_path):
    assert run_task("crowd", tmp_path) == {"crowds": CROWDS}


def test_no_room_for_a_file_is_an_error_and_leaves_nothing(tmp_path):
    assert run_task("fill", tmp_path) == {"limits": LIMITS}


def test_a_full_disk_is_an_error_and_leaves_nothing(tmp_path):
    alone = ["unshare", "--map-root-user", "--mount"]
    if shutil.which("unshare") is None or subprocess.run([*alone, "true"], check=False).returncode:
        pytest.skip("needs Linux and leave to mount a file system in a name space of its own")
    ends = run_task("fill_disk", tmp_path, *alone)["ends"]
    assert set(ends) == {REFUSED, BUILT}
    enough = ends.index(BUILT)
    assert set(ends[enough:]) == {BUILT}  # too little room, and then enough
    assert ends.count(REFUSED) >= 5


if __name__ == "__main__":
    print(json.dumps(TASKS[sys.argv[1]](Path(sys.argv[2]))))
