"""Loader processes that lack a resource, or die: one sentence says so, and nobody waits for ever.

Each lack is a real one, in a process of its own.
"""

import os
import signal
import subprocess
import sys
import textwrap

import pytest
import torch
from slicematch.data.dataset import BadSampleLog
from slicematch.data.errors import DatasetError, LoaderError
from slicematch.data.loading import PoseLoader, raise_lack_of_resources
from torch.utils.data import Dataset

from slicemask.errors import ImageError

SCRIPT = """
import ctypes, multiprocessing.popen_fork, multiprocessing.resource_sharer
import multiprocessing.synchronize, os, resource, signal, sys
import numpy as np, torch
from slicematch.data.errors import LoaderError
from slicematch.data.loading import PoseLoader
torch.set_num_threads(1)

class Samples(torch.utils.data.Dataset):
    def __len__(self):
        return 24
    def __getitem__(self, index):
        return {{name: torch.ones({values}) for name in "abcde"}}

{lack}
try:
    for batch in PoseLoader(Samples(), 2, num_workers={workers}):
        pass
except LoaderError as error:
    print(error)
"""
UNSHARE = """
libc = ctypes.CDLL(None, use_errno=True)
if libc.unshare(0x00020000) or libc.mount(b"none", b"/", None, 0x44000, None) or libc.mount(
    b"tmpfs", b"/dev/shm", b"tmpfs", 0, b"size=256k"
):
    print("not allowed")
    sys.exit()
"""
NO_PROCESSES = """
resource.setrlimit(resource.RLIMIT_NPROC, (1, 1))
if os.getuid() == 0:  # whom no limit stops
    os.setresuid(65534, 65534, 65534)
"""
LITTLE_MEMORY = """
pages = int(open("/proc/self/statm").read().split()[0])
limit = pages * resource.getpagesize() + (300 << 20)
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
"""


class Fatal(Dataset):
    """Samples of which one ends the process that reads it."""

    def __init__(self, how):
        self.how = how

    def __len__(self):
        return 8

    def __getitem__(self, index):
        if index == 5:
            self.how()
        return torch.zeros(2)


def run(lack, workers=2, values=1000):
    code = SCRIPT.format(lack=textwrap.dedent(lack), workers=workers, values=values)
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr
    if "not allowed" in done.stdout:
        pytest.skip("this process may not mount a file system of its own")
    return done


@pytest.mark.skipif(sys.platform != "linux", reason="limits as Linux has them")
@pytest.mark.parametrize("files", [16, 24, 28, 36, 40])
def test_too_few_open_files(files):
    done = run(f"resource.setrlimit(resource.RLIMIT_NOFILE, ({files}, {files}))", workers=4)
    assert done.stdout == (
        "open files ran out while 4 processes loaded images; allow more (ulimit -n 4096), or load "
        "in fewer processes (--workers 0 for none)\n"
    )
    assert done.stderr == ""


@pytest.mark.skipif(sys.platform != "linux", reason="limits as Linux has them")
@pytest.mark.parametrize(
    ("lack", "values", "said"),
    [
        (UNSHARE, 20_000, "shared memory (/dev/shm) ran out while 2 processes loaded images; give"),
        (NO_PROCESSES, 10, "processes or threads ran out while 2 processes loaded images; allow"),
        (LITTLE_MEMORY, 30_000_000, "memory ran out while 2 processes loaded images; choose small"),
    ],
)
def test_other_lacks(lack, values, said):
    done = run(lack, values=values)
    assert done.stdout.startswith(said)
    assert done.stdout.count("\n") == 1
    assert done.stderr == ""


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize(
    ("how", "said"),
    [
        (lambda: os.kill(os.getpid(), signal.SIGKILL), "memory ran out while 1 process loaded"),
        (lambda: os.kill(os.getpid(), signal.SIGBUS), r"shared memory \(/dev/shm\) ran out while"),
        (lambda: os.kill(os.getpid(), signal.SIGSEGV), "a process that loads images .* SIGSEGV;"),
        (lambda: os._exit(3), "a process that loads images ended by exit status 3; what it was"),
    ],
)
def test_a_worker_that_is_killed(how, said):
    before = signal.getsignal(signal.SIGCHLD)
    loader = PoseLoader(Fatal(how), 2, num_workers=1)
    batches = iter(loader)
    assert len(batches) == len(loader) == 4
    with pytest.raises(LoaderError, match=said) as caught:
        list(batches)
    assert "\n" not in str(caught.value)
    assert signal.getsignal(signal.SIGCHLD) == before


def test_errors_of_the_samples_stay_what_they_are():
    def refuse():
        raise DatasetError("none of the 8 samples is readable")

    def fail():
        raise RuntimeError("a fault of the program")

    for workers in (0, 1):
        with pytest.raises(DatasetError, match=r"^none of the 8 samples is readable$"):
            list(PoseLoader(Fatal(refuse), 2, num_workers=workers))
        with pytest.raises(RuntimeError, match="a fault of the program") as caught:
            list(PoseLoader(Fatal(fail), 2, num_workers=workers))
        assert not isinstance(caught.value, LoaderError)


def test_an_image_is_not_unreadable_for_want_of_open_files():
    for cause, raised in (
        (OSError(24, "Too many open files"), OSError),
        (MemoryError(), MemoryError),
    ):
        with pytest.raises(raised) as caught:
            raise_lack_of_resources(chained(cause))
        assert caught.value is cause
    raise_lack_of_resources(chained(OSError(2, "No such file")))
    raise_lack_of_resources(chained(ValueError("a broken file")))


def chained(cause):
    try:
        raise ImageError("is unreadable as an image") from cause
    except ImageError as error:
        return error


def test_a_list_of_bad_samples_that_cannot_be_written(tmp_path):
    log = BadSampleLog(tmp_path / "bad_samples.jsonl")
    log.path.unlink()
    log.path.mkdir()
    log.entries = dict  # what is there cannot be read either
    with pytest.raises(DatasetError, match=r"bad_samples.jsonl: sample a is unreadable and"):
        log.record("a", ImageError("broken"))
