"""Writing a bank: streamed to a file that takes its name only when it is whole."""

import os
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType

import h5py
import numpy as np
from numpy.typing import NDArray

from slicemask.bank.seal import SEAL_BYTES, VERSION, write_seal
from slicemask.bank.spec import BankSpec

FORMAT = "slicemask-bank"
# The oldest file layout in which HDF5 checksums its own structures; any HDF5 from 1.10 reads it.
_LAYOUT = ("v110", "v110")
_CHUNK_VALUES = 1 << 15
# Level 1 deflates twice as fast as 4, for files that are 7 % larger.
_FILTERS = {"shuffle": True, "compression": "gzip", "compression_opts": 1, "fletcher32": True}


class BankWriter:
    """A bank being written to ``<target's folder>/.<target's name>.partial``.

    Used in a ``with`` statement: rows are added in order, `finish` adds the rest, and leaving the
    block without an error seals the file, brings it safely to disk and renames it to the target.
    Leaving with an error removes it.

    Parameters
    ----------
    target : path
        Where the bank goes; a file already there is replaced.
    spec : BankSpec
        What it holds; ``versions`` included.
    """

    def __init__(self, target: Path, spec: BankSpec):
        self.target = target
        self.partial = target.with_name(f".{target.name}.partial")
        self.spec = spec
        self.rows = 0
        self.nonzeros = 0

    def __enter__(self) -> "BankWriter":
        try:
            self._file = h5py.File(
                self.partial, "w", userblock_size=SEAL_BYTES, libver=_LAYOUT, locking=False
            )
            self._file.attrs["format"] = FORMAT
            self._file.attrs["version"] = VERSION
            self._file.attrs["spec"] = self.spec.to_json()
            group = self._file.create_group("masks")
            group.attrs["encoding-type"] = "csr_matrix"
            group.attrs["encoding-version"] = "0.1.0"
            self._data = self._dataset("masks/data", np.float32)
            self._indices = self._dataset("masks/indices", np.int32)
            self._indptr = self._dataset("masks/indptr", np.int64)
            _append(self._indptr, np.zeros(1, dtype=np.int64))
        except BaseException:
            self._discard()
            raise
        return self

    def _dataset(self, name: str, dtype: type, width: int | None = None) -> h5py.Dataset:
        tail = () if width is None else (width,)
        chunk = (max(1, _CHUNK_VALUES // (width or 1)), *tail)
        return self._file.create_dataset(
            name, (0, *tail), dtype, chunks=chunk, maxshape=(None, *tail), **_FILTERS
        )

    def add_rows(
        self, counts: NDArray[np.int64], indices: NDArray[np.int32], data: NDArray[np.float32]
    ) -> int:
        """Add CSR rows: nonzeros of each, cells, fractions. Give the first row's number."""
        first = self.rows
        _append(self._indices, indices)
        _append(self._data, data)
        _append(self._indptr, self.nonzeros + np.cumsum(counts))
        self.rows += len(counts)
        self.nonzeros += len(data)
        return first

    def finish(self, index: NDArray[np.int32], poses: Iterable[NDArray[np.float64]]) -> None:
        """Add the index [K, N], copied piece by piece, and the poses, in pieces [k, 3]."""
        dataset = self._dataset("index", np.int32, index.shape[1])
        step = dataset.chunks[0] * 16
        for start in range(0, len(index), step):
            _append(dataset, index[start : start + step])
        dataset = self._dataset("poses", np.float64, 3)
        for some in poses:
            _append(dataset, some)
        self._file["masks"].attrs["shape"] = np.array(
            [self.rows, self.spec.cells**2], dtype=np.int64
        )

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if kind is not None:
            self._discard()
            return
        try:
            self._file.close()
            write_seal(self.partial)
            _sync(self.partial)
            os.replace(self.partial, self.target)
        except BaseException:
            self._discard()
            raise
        _sync(self.target.parent)

    def _discard(self) -> None:
        try:
            if hasattr(self, "_file"):
                self._file.close()
        except (OSError, RuntimeError):
            # Closing writes what is buffered, which fails again on a full disk. The error that
            # brought us here is the one to report.
            return
        finally:
            self.partial.unlink(missing_ok=True)


def _append(dataset: h5py.Dataset, values: NDArray[np.generic]) -> None:
    start = len(dataset)
    dataset.resize(start + len(values), axis=0)
    dataset[start:] = values


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
