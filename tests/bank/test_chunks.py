"""Chunks filtered by slicemask, against HDF5: it must read them, and sum as they are summed."""

import h5py
import numpy as np
import pytest

from slicemask.bank.chunks import FILTERS, encode_chunk, fletcher32

CHUNKS = {
    "zeros": np.zeros(1 << 12, dtype=np.int32),
    "ones": np.ones(1 << 12, dtype=np.float32),
    "random": np.random.default_rng(0).random(1 << 15),
    "rows": np.arange(3 << 10, dtype=np.int64).reshape(-1, 3),
    "one value": np.array([7], dtype=np.int32),
}
# Deflated lengths both odd and even.
CHUNKS |= {f"{n} values": np.random.default_rng(n).random(n, dtype=np.float32) for n in range(2, 9)}


@pytest.fixture
def file():
    with h5py.File("chunks", "w", driver="core", backing_store=False) as file:
        yield file


def _dataset(file, values):
    return file.create_dataset("x", values.shape, values.dtype, chunks=values.shape, **FILTERS)


@pytest.mark.parametrize("values", CHUNKS.values(), ids=CHUNKS)
def test_hdf5_reads_a_stored_chunk(file, values):
    dataset = _dataset(file, values)
    dataset.id.write_direct_chunk((0,) * values.ndim, encode_chunk(values))
    assert np.array_equal(dataset[:], values)


@pytest.mark.parametrize("values", CHUNKS.values(), ids=CHUNKS)
def test_the_checksum_is_hdf5_s(file, values):
    dataset = _dataset(file, values)
    dataset[:] = values
    _, chunk = dataset.id.read_direct_chunk((0,) * values.ndim)
    assert int.from_bytes(chunk[-4:], "little") == fletcher32(chunk[:-4])


@pytest.mark.parametrize("data", [b"", b"\0", b"\0" * 7, b"\xff\xff", b"\xff" * 7, b"\xff\xfe\0\1"])
def test_the_checksum_at_its_turns(file, data):
    dataset = file.create_dataset("x", (len(data) + 1,), np.uint8, chunks=True, fletcher32=True)
    values = np.frombuffer(data + b"\0", dtype=np.uint8)
    dataset[:] = values
    _, chunk = dataset.id.read_direct_chunk((0,))
    assert int.from_bytes(chunk[-4:], "little") == fletcher32(chunk[:-4])


def test_hdf5_refuses_a_wrong_sum(file):
    values = CHUNKS["random"]
    dataset = _dataset(file, values)
    chunk = bytearray(encode_chunk(values))
    chunk[-1] ^= 1
    dataset.id.write_direct_chunk((0,), bytes(chunk))
    with pytest.raises(OSError, match="filter returned failure"):
        dataset[:]
