"""Damaged and hostile banks: refused in one sentence, or read as the very same values.

A worker process (this file, run as a program) opens thousands of mutated banks with little memory
to spare, so that a crash of HDF5, a hang or an absurd allocation fails a test and not the run.
"""

import json
import os
import random
import re
import resource
import subprocess
import sys
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest

from slicemask import BankError, BankFormatError, open_bank
from slicemask.bank.seal import SEAL_BYTES, write_seal

MEMORY_BYTES = 2 << 30  # of address space; the libraries take some 0.5 GiB of it
CASES = 600  # of each kind of random damage, for each of two banks


def read_all(path, check=True):
    """All that a bank gives: in pieces first, so that nothing is in memory yet, then whole."""
    with open_bank(path, check=check) as bank:
        some = bank.masks(len(bank) - 1)
        every = bank.masks(np.arange(len(bank)))
        matrix = bank.csr()
        values = [some, every, bank.index, bank.poses, matrix.toarray()]
        words = [bank.spec.to_json(), str(bank.rows), str(bank.nonzeros), bank.spec.summary()]
        return [value.tobytes() for value in values] + words


def outcome(path, expected, check=True):
    """ "same", "refused: why", or what else happened."""
    try:
        values = read_all(path, check)
    except BankError as error:
        text = str(error)
        if not text.startswith(str(path)) or len(text) > 1000 or "\n" in text:
            return f"badly said: {text}"
        return f"refused: {text}"
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return "same" if values == expected else "other values"


# Random damage to the bytes


def damaged(content, rng):
    """The content with one piece of random damage, drawn from many kinds."""
    content = bytearray(content)
    size = len(content)
    kind = rng.choice(
        ["flip", "flips", "byte", "cut", "extend", "zeros", "noise", "swap", "insert", "delete"]
    )
    # Half of the damage goes to the front, where the seal and the first structures are.
    at = rng.randrange(size if rng.random() < 0.5 else 1200)
    length = min(size - at, int(2 ** rng.uniform(0, 11)))
    if kind == "flip":
        content[at] ^= 1 << rng.randrange(8)
    elif kind == "flips":
        for _ in range(rng.randint(2, 40)):
            content[rng.randrange(size)] ^= 1 << rng.randrange(8)
    elif kind == "byte":
        content[at] = rng.choice([0, 1, 127, 128, 254, 255])
    elif kind == "cut":
        del content[rng.randrange(size) :]
    elif kind == "extend":
        content += rng.choice([bytes(length), rng.randbytes(length), content[:length]])
    elif kind == "zeros":
        content[at : at + length] = bytes(length)
    elif kind == "noise":
        content[at : at + length] = rng.randbytes(length)
    elif kind == "swap":
        to = rng.randrange(size - length + 1)
        first, second = content[at : at + length], content[to : to + length]
        content[at : at + length] = second
        content[to : to + length] = first
    elif kind == "insert":
        content[at:at] = rng.randbytes(length)
    else:
        del content[at : at + length]
    return kind, bytes(content)


def random_damage(bank, folder, seed, mode):
    """Outcomes of many damaged copies, counted; those that are wrong, in words."""
    content, expected = bank.read_bytes(), read_all(bank)
    path = folder / "damaged.h5"
    counts, wrong = {}, []
    for case in range(CASES):
        rng = random.Random(f"{seed}-{mode}-{case}")
        kind, altered = damaged(content, rng)
        progress(f"{mode} {bank.name} case {case} ({kind})")
        path.write_bytes(altered)
        if mode == "sealed again" and len(altered) >= SEAL_BYTES:
            write_seal(path, 1)
        found = outcome(path, expected, check=mode != "unchecked")
        word = found.split(":")[0]
        counts[f"{kind} {word}"] = counts.get(f"{kind} {word}", 0) + 1
        # Sealed and checked, any change of a byte is refused.
        allowed = {"refused"} if mode == "sealed" and altered != content else {"refused", "same"}
        if word not in allowed:
            wrong.append(f"case {case} ({kind}): {found}")
    return {"counts": counts, "wrong": wrong}


# Lies told through h5py, in otherwise sound files


def attribute(name, value, at="/"):
    def lie(file):
        file[at].attrs[name] = value

    return lie


def no_attribute(name, at="/"):
    def lie(file):
        del file[at].attrs[name]

    return lie


def spec(change):
    """The spec's JSON, changed as a dict in place or replaced."""

    def lie(file):
        content = json.loads(file.attrs["spec"])
        replaced = change(content)
        text = json.dumps(content) if replaced is None else replaced
        assert isinstance(text, str | bytes)
        file.attrs["spec"] = np.bytes_(text)

    return lie


def put(name, value, at):
    """One stored value, or several, set to another."""

    def lie(file):
        file[name][at] = value

    return lie


def dataset(name, change=lambda values: values, **options):
    """A dataset written again, with other values or stored another way."""

    def lie(file):
        values = change(file[name][...])
        del file[name]
        layout = {
            "chunks": tuple(max(1, min(n, 4096)) for n in values.shape),
            "maxshape": (None,) * values.ndim,
            "compression": "gzip",
            "shuffle": True,
            "fletcher32": True,
        } | options
        file.create_dataset(name, data=values, **layout)

    return lie


def declared(name, shape, **options):
    """A dataset that declares a size, and stores nothing."""

    def lie(file):
        dtype = file[name].dtype
        del file[name]
        file.create_dataset(name, shape=shape, dtype=dtype, **options)

    return lie


def resized(name, size):
    def lie(file):
        file[name].resize(size, axis=0)

    return lie


def link(name, target):
    def lie(file):
        if isinstance(target, h5py.ExternalLink) or not target.path.startswith("/kept"):
            del file[name]
        else:
            file.move(name, target.path)
        file[name] = target

    return lie


def removed(name):
    def lie(file):
        del file[name]

    return lie


def group_instead(name):
    def lie(file):
        del file[name]
        file.create_group(name)

    return lie


def virtual(file):
    values = file["poses"][...]
    del file["poses"]
    layout = h5py.VirtualLayout(shape=values.shape, dtype=values.dtype)
    layout[...] = h5py.VirtualSource("elsewhere.h5", "poses", shape=values.shape)
    file.create_virtual_dataset("poses", layout)


def external(file):
    shape = file["poses"].shape
    del file["poses"]
    zeros = [("/dev/zero", 0, 1 << 20)]
    file.create_dataset("poses", shape=shape, dtype=np.float64, external=zeros)


def huge_chunks(file):
    # Half a GiB of zeros in one chunk: half a MiB on disk, all of it once it is unpacked.
    values, packer = 1 << 27, zlib.compressobj(9)
    packed = b"".join(packer.compress(bytes(1 << 20)) for _ in range(values * 4 >> 20))
    packed += packer.flush()
    for name, dtype in (("masks/data", np.float32), ("masks/indices", np.int32)):
        del file[name]
        options = {"dtype": dtype, "compression": "gzip", "fletcher32": True}
        made = file.create_dataset(name, shape=(values,), chunks=(values,), **options)
        made.id.write_direct_chunk((0,), packed, filter_mask=2)  # without a checksum
    file["masks/indptr"][-1] = values


def huge_without_chunks(file):
    for name, dtype in (("masks/data", np.float32), ("masks/indices", np.int32)):
        del file[name]
        file.create_dataset(name, shape=(HUGE,), dtype=dtype)
    file["masks/indptr"][-1] = HUGE


def huge_and_consistent(file):
    for name in ("masks/data", "masks/indices"):
        file[name].resize(HUGE, axis=0)
    file["masks/indptr"][-1] = HUGE


def rows_without_end(file):
    for name, size in (("masks/data", 0), ("masks/indices", 0), ("masks/indptr", HUGE)):
        file[name][:] = 0
        file[name].resize(size, axis=0)
    file["index"][:] = 0
    shape = file["masks"].attrs["shape"]
    file["masks"].attrs["shape"] = [HUGE - 1, shape[1]]


def swap_two(values):
    values[[0, 1]] = values[[1, 0]]
    return values


HUGE = 1 << 40
LIES = {
    "another format": attribute("format", np.bytes_("slicemask-bunk")),
    "format of two": attribute("format", np.array([b"slicemask-bank"] * 2)),
    "no format": no_attribute("format"),
    "empty format": attribute("format", h5py.Empty("S4")),
    "version 2": attribute("version", 2),
    "version 0": attribute("version", 0),
    "version as text": attribute("version", "1"),
    "version NaN": attribute("version", np.nan),
    "version as a list": attribute("version", [1, 1]),
    "no version": no_attribute("version"),
    "no spec": no_attribute("spec"),
    "spec a number": attribute("spec", 5),
    "spec empty": attribute("spec", h5py.Empty("S4")),
    "spec no JSON": spec(lambda _: "{"),
    "spec nothing": spec(lambda _: " "),
    "spec a list": spec(lambda _: "[]"),
    "spec a text": spec(lambda _: '"grid"'),
    "spec null": spec(lambda _: "null"),
    "spec no UTF-8": spec(lambda _: b'{"cells": "\xff\xfe"}'),
    "spec nested deep": spec(lambda _: "[" * 50_000),
    "spec with a huge number": spec(lambda s: s.update(cells=10**300)),
    "spec with a number beyond float": spec(lambda s: s["frustum"].update(hfov_deg=10**400)),
    "spec with a number beyond reading": spec(lambda s: json.dumps(s)[:-1] + ',"n":' + "9" * 9999),
    "unknown key": spec(lambda s: s.update(colour="red")),
    "unknown key of the frustum": spec(lambda s: s["frustum"].update(tilt_deg=3)),
    "no frustum": spec(lambda s: s.__delitem__("frustum")),
    "frustum a list": spec(lambda s: s.update(frustum=[90, 2])),
    "cells 0": spec(lambda s: s.update(cells=0)),
    "cells as text": spec(lambda s: s.update(cells="5")),
    "more cells": spec(lambda s: s.update(cells=s["cells"] + 1)),
    "fewer cells": spec(lambda s: s.update(cells=s["cells"] - 1)),
    "most cells": spec(lambda s: s.update(cells=8192)),
    "more slices": spec(lambda s: s["frustum"].update(slices=s["frustum"]["slices"] + 1)),
    "fewer slices": spec(lambda s: s["frustum"].update(slices=1)),
    "hfov NaN": spec(lambda s: s["frustum"].update(hfov_deg=float("nan"))),
    "hfov 720": spec(lambda s: s["frustum"].update(hfov_deg=720)),
    "hfov as a list": spec(lambda s: s["frustum"].update(hfov_deg=[90])),
    "another projection": spec(lambda s: s["frustum"].update(projection="fisheye")),
    "another engine": spec(lambda s: s.update(engine="guess")),
    "versions a number": spec(lambda s: s.update(versions=5)),
    "versions of numbers": spec(lambda s: s.update(versions={"numpy": 2})),
    "poses both ways": spec(lambda s: s.update({"grid": {}, "poses": {}})),
    "poses a number": spec(lambda s: s.update({next(iter({"grid", "poses"} & set(s))): 7})),
    "no poses": spec(lambda s: s.__delitem__("grid" if "grid" in s else "poses")),
    "shape of other rows": attribute("shape", [3, 25], "masks"),
    "shape of other cells": attribute("shape", [HUGE, HUGE], "masks"),
    "shape of three": attribute("shape", [1, 2, 3], "masks"),
    "shape as text": attribute("shape", ["a", "b"], "masks"),
    "shape NaN": attribute("shape", [np.nan, np.nan], "masks"),
    "shape empty": attribute("shape", h5py.Empty("i8"), "masks"),
    "no shape": no_attribute("shape", "masks"),
    "masks gone": removed("masks"),
    "masks a dataset": lambda file: (removed("masks")(file), put_new(file, "masks")),
    "masks a soft link": link("masks", h5py.SoftLink("/kept")),
    "masks an external link": link("masks", h5py.ExternalLink("elsewhere.h5", "/masks")),
    "index of floats": dataset("index", lambda v: v.astype(np.float32)),
    "index of int64": dataset("index", lambda v: v.astype(np.int64)),
    "index of big-endian": dataset("index", lambda v: v.astype(">i4")),
    "index flat": dataset("index", lambda v: v.ravel()),
    "index transposed": dataset("index", lambda v: v.T),
    "index short": dataset("index", lambda v: v[:-1]),
    "index empty": dataset("index", lambda v: v[:0]),
    "index below": put("index", -1, (0, 0)),
    "index far below": put("index", np.iinfo(np.int32).min, (-1, 0)),
    "index beyond": put("index", 1 << 20, (-1, -1)),
    "index far beyond": put("index", np.iinfo(np.int32).max, (-1, 0)),
    "index huge": resized("index", HUGE),
    "poses float32": dataset("poses", lambda v: v.astype(np.float32)),
    "poses of four": dataset("poses", lambda v: np.pad(v, ((0, 0), (0, 1)))),
    "poses short": dataset("poses", lambda v: v[:-1]),
    "poses huge": resized("poses", HUGE),
    "poses swapped": dataset("poses", swap_two),
    "a pose NaN": put("poses", np.nan, (0, 0)),
    "a pose outside": put("poses", 1.5, (0, 1)),
    "a pose moved": put("poses", 0.123, (1, 0)),
    "poses virtual": virtual,
    "poses in another file": external,
    "indptr int32": dataset("masks/indptr", lambda v: v.astype(np.int32)),
    "indptr not from 0": put("masks/indptr", 1, 0),
    "indptr not to the end": put("masks/indptr", 0, -1),
    "indptr past the end": put("masks/indptr", HUGE, -1),
    "indptr going back": put("masks/indptr", 10**6, 3),
    "indptr negative": put("masks/indptr", -5, 3),
    "indptr wild": put("masks/indptr", HUGE, 2),
    "indptr short": dataset("masks/indptr", lambda v: v[:-1]),
    "indptr of one": dataset("masks/indptr", lambda v: v[:1]),
    "indptr empty": dataset("masks/indptr", lambda v: v[:0]),
    "indptr huge": resized("masks/indptr", HUGE),
    "indices descending": dataset("masks/indices", lambda v: v[::-1]),
    "indices all one": put("masks/indices", 1, slice(None)),
    "indices swapped": dataset("masks/indices", swap_two),
    "a cell below": put("masks/indices", -1, 0),
    "a cell beyond": put("masks/indices", 10_000, -1),
    "a cell far beyond": put("masks/indices", np.iinfo(np.int32).max, -1),
    "indices short": dataset("masks/indices", lambda v: v[:-1]),
    "indices int64": dataset("masks/indices", lambda v: v.astype(np.int64)),
    "indices huge": resized("masks/indices", HUGE),
    "data float64": dataset("masks/data", lambda v: v.astype(np.float64)),
    "data short": dataset("masks/data", lambda v: v[:-1]),
    "data flat no more": dataset("masks/data", lambda v: v[:, None]),
    "data a single number": lambda file: (removed("masks/data")(file), put_new(file, "masks/data")),
    "data huge": resized("masks/data", HUGE),
    "data huge, in one piece": declared("masks/data", (HUGE,)),
    "all in huge chunks": huge_chunks,
    "all huge, and without chunks": huge_without_chunks,
    "all huge, and stored nowhere": huge_and_consistent,
    "rows without end": rows_without_end,
    "data without chunks": dataset(
        "masks/data", chunks=None, maxshape=None, compression=None, shuffle=None, fletcher32=None
    ),
    "data without checksums": dataset("masks/data", fletcher32=False),
    "a fraction NaN": put("masks/data", np.nan, 0),
    "a fraction infinite": put("masks/data", np.inf, -1),
    "a fraction 0": put("masks/data", 0.0, 1),
    "a fraction below": put("masks/data", -0.25, 1),
    "a fraction above": put("masks/data", 1.25, 1),
    "data a group": group_instead("masks/data"),
    "data a soft link": link("masks/data", h5py.SoftLink("/kept")),
    "data a link to nothing": link("masks/data", h5py.SoftLink("/nothing")),
    "data a link to itself": link("masks/data", h5py.SoftLink("/masks/data")),
    "data an external link": link("masks/data", h5py.ExternalLink("elsewhere.h5", "/masks/data")),
    "index gone": removed("index"),
    "poses gone": removed("poses"),
    "data gone": removed("masks/data"),
    "indices gone": removed("masks/indices"),
    "indptr gone": removed("masks/indptr"),
}  # fmt: skip


def put_new(file, name):
    file[name] = 5


def told(bank, folder):
    """The outcome of every lie, of a file sealed as it was and of one sealed again."""
    expected = read_all(bank)
    elsewhere = folder / "elsewhere.h5"
    elsewhere.write_bytes(bank.read_bytes())
    path = folder / "lying.h5"
    outcomes = {}
    for name, lie in LIES.items():
        progress(f"lie: {name}")
        path.write_bytes(bank.read_bytes())
        with h5py.File(path, "r+", libver=("v110", "v110")) as file:
            lie(file)
        outcomes[name] = {"sealed": outcome(path, expected)}
        outcomes[name]["unchecked"] = outcome(path, expected, check=False)
        write_seal(path, 1)
        outcomes[name]["sealed again"] = outcome(path, expected)
    return outcomes


# The worker


def progress(words):
    """Say what is being tried, for the case that it is the last thing ever tried."""
    Path(os.environ["PROGRESS"]).write_text(words)


def work(task, bank, folder):
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    bank, folder = Path(bank), Path(folder)
    result = told(bank, folder) if task == "lies" else random_damage(bank, folder, 1, task)
    # Not ru_maxrss, which a child process takes over from its parent.
    status = Path("/proc/self/status").read_text()
    peak_mib = int(re.search(r"VmHWM:\s*(\d+) kB", status)[1]) / 1024
    print(json.dumps({"peak_mib": peak_mib, "result": result}))


def run_worker(task, bank, folder):
    last = folder / "progress.txt"
    try:
        ran = subprocess.run(
            [sys.executable, __file__, task, str(bank), str(folder)],
            capture_output=True,
            text=True,
            timeout=100,
            env={**os.environ, "PROGRESS": str(last)},
            check=False,
        )
    except subprocess.TimeoutExpired:
        pytest.fail(f"reading hangs: {last.read_text()}")
    assert ran.returncode == 0, f"{last.read_text()}: {ran.returncode} {ran.stderr}"
    answer = json.loads(ran.stdout)
    assert answer["peak_mib"] < 400
    return answer["result"]


@pytest.mark.parametrize("bank", ["listed", "gridded"])
@pytest.mark.parametrize("mode", ["sealed", "sealed again", "unchecked"])
def test_random_damage_is_refused_or_changes_nothing(request, tmp_path, bank, mode):
    result = run_worker(mode, request.getfixturevalue(bank), tmp_path)
    assert result["wrong"] == []
    assert sum(result["counts"].values()) == CASES
    refused = sum(n for word, n in result["counts"].items() if word.endswith("refused"))
    assert refused > CASES / 2


@pytest.fixture(scope="module", params=["listed", "gridded"])
def outcomes(request, tmp_path_factory):
    bank = request.getfixturevalue(request.param)
    return run_worker("lies", bank, tmp_path_factory.mktemp("lies"))


@pytest.mark.parametrize("lie", LIES)
def test_a_lie_is_refused_sealed_or_not(outcomes, lie):
    found = outcomes[lie]
    assert found["sealed"].startswith("refused: ")
    assert "altered" in found["sealed"] or "cut short" in found["sealed"]
    assert found["unchecked"].startswith("refused: ")
    assert found["sealed again"].startswith("refused: ")


def test_lies_are_told_by_their_object(outcomes):
    for name, place in {
        "index beyond": "/index",
        "poses short": "/poses",
        "data float64": "/masks/data",
        "indices descending": "/masks/indices",
        "indptr going back": "/masks/indptr",
        "a fraction NaN": "/masks/data",
        "shape of three": "/masks attribute shape",
        "version 2": "attribute version",
    }.items():
        said = outcomes[name]["sealed again"]
        assert f"lying.h5: {place}: expected " in said
        assert ", found " in said


SAYS = {
    "is empty, not a slicemask bank": lambda whole: b"",
    "is not a slicemask bank": lambda whole: b"u,v,heading_deg\n0.5,0.5,0\n",
    "is an HDF5 file but not a slicemask bank": lambda whole: whole[SEAL_BYTES:],
    "is cut short: expected a seal of 512 bytes, found 300": lambda whole: whole[:300],
    "is cut short: expected {size} bytes, found 5000": lambda whole: whole[:5000],
    "is altered: expected {size} bytes, found {more}": lambda whole: whole + b"!",
    "was altered after it was written: expected SHA-256": lambda whole: whole[:-1] + b"!",
    "its seal (first 512 bytes) was altered": lambda whole: whole[:511] + b"!" + whole[512:],
    "is a bank of version 7, and this slicemask reads versions 1 and 2": lambda whole: (
        whole.replace(b"slicemask-bank 1\n", b"slicemask-bank 7\n")
    ),
}


@pytest.mark.parametrize("words", SAYS)
def test_the_error_says_what_is_wrong(tmp_path, gridded, words):
    whole = gridded.read_bytes()
    path = tmp_path / "bank.h5"
    path.write_bytes(SAYS[words](whole))
    with pytest.raises(BankFormatError) as caught:
        open_bank(path)
    assert str(caught.value).startswith(
        f"{path}: {words.format(size=len(whole), more=len(whole) + 1)}"
    )


@pytest.mark.parametrize("kind", ["nothing", "folder", "pipe", "name too long"])
def test_what_is_no_file_is_refused(tmp_path, kind):
    path = tmp_path / ("x" * 5000 if kind == "name too long" else "bank.h5")
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    for check in (True, False):
        with pytest.raises(BankError):
            open_bank(path, check=check)


if __name__ == "__main__":
    work(*sys.argv[1:])
