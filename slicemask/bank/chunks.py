"""A chunk's bytes as HDF5 stores it: shuffled, deflated, and with its Fletcher-32 checksum.

HDF5 applies its filters one chunk at a time, under a lock. Applied here, they run on all threads,
and HDF5 stores the bytes unchanged. On reading, it reverses them and verifies the checksum.
"""

from typing import Any

import deflate
import numpy as np
from numpy.typing import NDArray

# libdeflate's low levels. For fractions 1 is the faster; for whole numbers, whose bytes repeat, 2.
_LEVEL, _LEVEL_WHOLE = 1, 2

# The same filters as options of h5py's `create_dataset`.
FILTERS: dict[str, Any] = {
    "shuffle": True,
    "compression": "gzip",
    "compression_opts": _LEVEL,
    "fletcher32": True,
}


def encode_chunk(values: NDArray[Any]) -> bytes:
    """Encode a complete chunk as HDF5 stores it with `FILTERS`.

    Parameters
    ----------
    values : array
        The chunk, of any shape and numeric type.

    Returns
    -------
    encoded : bytes
        For `h5py.h5d.DatasetID.write_direct_chunk`.
    """
    size = values.dtype.itemsize
    shuffled = np.empty((size, values.size), dtype=np.uint8)
    shuffled[:] = np.ascontiguousarray(values).reshape(-1).view(np.uint8).reshape(-1, size).T
    level = _LEVEL_WHOLE if values.dtype.kind == "i" else _LEVEL
    deflated = bytes(deflate.zlib_compress(shuffled.data, level))
    return deflated + fletcher32(deflated).to_bytes(4, "little")


def fletcher32(data: bytes) -> int:
    """Fletcher's checksum of 16-bit words, as HDF5 computes it.

    Words are big-endian, the last one padded with zeros. Sums are modulo 65535, with 65535
    instead of 0 unless all words are 0.
    """
    words = np.frombuffer(data + bytes(len(data) % 2), dtype="<u2").astype(np.int64)
    # These are little-endian: modulo 65535, a word times 256 has its two bytes the other way round,
    # and swapping the sums is cheaper than every word. The second sum adds up the first one after
    # each word.
    totals = 256 * int(words.sum()), 256 * int(words.cumsum().sum())
    first, second = ((total - 1) % 65535 + 1 if total else 0 for total in totals)
    return second << 16 | first
