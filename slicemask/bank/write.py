"""Writing a bank: streamed to a file that takes its name only when it is whole."""

import io
import math
import os
import secrets
from collections import deque
from collections.abc import Iterable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from slicemask.bank.chunks import FILTERS, encode_chunk
from slicemask.bank.seal import SEAL_BYTES, write_seal
from slicemask.bank.spec import BankSpec
from slicemask.files import sync_to_disk

FORMAT = "slicemask-bank"
# The oldest file layout in which HDF5 checksums its own structures; any HDF5 from 1.10 reads it.
_LAYOUT = ("v110", "v110")
_CHUNK_VALUES = 1 << 15
# Chunks that may wait to be deflated or written.
_MOST_WAITING = 32


class _Sink(io.FileIO):
    """The file that HDF5 writes to, which never fails as far as HDF5 can see.

    HDF5 cannot let go of a file that it failed to write: closing it fails as well, and then the
    interpreter crashes at its end. So a failure, such as a full disk, is kept in ``error``, and
    from then on, or once ``abandoned``, HDF5 writes into nothing.
    """

    def __init__(self, path: Path):
        super().__init__(path, "w+")
        self.abandoned = False
        self.error: OSError | None = None

    def write(self, data: Any, /) -> int:
        view = memoryview(data)
        try:
            while len(view) and not self.abandoned:
                view = view[super().write(view) or 0 :]
        except OSError as error:
            self.error, self.abandoned = error, True
        return len(data)

    def truncate(self, size: int | None = None, /) -> int:
        try:
            if not self.abandoned:
                return super().truncate(size)
        except OSError as error:
            self.error, self.abandoned = error, True
        return size or 0


class _Column:
    """A dataset that is written chunk by chunk, and its next chunk, zero where nothing is yet."""

    def __init__(self, dataset: h5py.Dataset):
        self.dataset = dataset
        self.sent = 0  # values in earlier chunks
        self.chunk: NDArray[Any] = np.zeros(dataset.chunks, dataset.dtype)
        self.filled = 0


class BankWriter:
    """A bank being written to a temporary file beside its target.

    Used in a ``with`` statement: rows are added in order, `finish` adds the rest, and leaving the
    block without an error seals the file, brings it safely to disk and renames it to the target.
    Leaving with an error removes it. If the file cannot be created, `add_rows` raises that.

    Parameters
    ----------
    target : path
        Where the bank goes; a file already there is replaced.
    spec : BankSpec
        What it holds; ``versions`` included.
    pool : ThreadPoolExecutor
        The threads that create the file and deflate its chunks.
    locked : bool
        Whether no other builder of the target is at work. Then the temporary file is
        ``.<target's name>.partial``, which takes the place of one that a killed builder left;
        otherwise it has a name of its own.
    """

    def __init__(self, target: Path, spec: BankSpec, pool: ThreadPoolExecutor, locked: bool = True):
        self.target = target
        own = "" if locked else f".{secrets.token_hex(4)}"
        self.partial = target.with_name(f".{target.name}{own}.partial")
        self.spec = spec
        self.rows = 0
        self.nonzeros = 0
        self._sink: _Sink | None = None
        self._begun: Future[None]
        self._open = ExitStack()
        self._pool = pool
        # Chunks on their way, in the order in which they go to the file.
        self._waiting: deque[tuple[h5py.Dataset, int, int, Future[bytes]]] = deque()

    def __enter__(self) -> "BankWriter":
        # Beside the caller's work: the first rows take a while to come.
        self._begun = self._pool.submit(self._begin)
        return self

    def _begin(self) -> None:
        self._sink = self._open.enter_context(_Sink(self.partial))
        self._file = h5py.File(
            self._sink, "w", userblock_size=SEAL_BYTES, libver=_LAYOUT, locking=False
        )
        self._open.callback(self._file.close)
        # A bytes attribute, unlike a str, lies where HDF5 keeps a checksum.
        self._file.attrs["format"] = np.bytes_(FORMAT)
        self._file.attrs["version"] = self.spec.version
        self._file.attrs["spec"] = np.bytes_(self.spec.to_json())
        group = self._file.create_group("masks")
        group.attrs["encoding-type"] = "csr_matrix"
        group.attrs["encoding-version"] = "0.1.0"
        self._data = self._column("masks/data", np.float32)
        self._indices = self._column("masks/indices", np.int32)
        self._indptr = self._column("masks/indptr", np.int64)
        self._append(self._indptr, np.zeros(1, dtype=np.int64))

    def _column(self, name: str, dtype: type, *tail: int) -> _Column:
        chunk = (max(1, _CHUNK_VALUES // math.prod(tail)), *tail)
        return _Column(
            self._file.create_dataset(
                name, (0, *tail), dtype, chunks=chunk, maxshape=(None, *tail), **FILTERS
            )
        )

    def _append(self, column: _Column, values: NDArray[Any]) -> None:
        """Add values to a column."""
        while len(values):
            room = len(column.chunk) - column.filled
            some, values = values[:room], values[room:]
            column.chunk[column.filled : column.filled + len(some)] = some
            column.filled += len(some)
            if column.filled == len(column.chunk):
                self._send(column)

    def _send(self, column: _Column) -> None:
        """Have a column's chunk deflated, and begin the next; write those that come next."""
        start, stop = column.sent, column.sent + column.filled
        packed = self._pool.submit(encode_chunk, column.chunk)
        self._waiting.append((column.dataset, start, stop, packed))
        column.chunk, column.filled, column.sent = np.zeros_like(column.chunk), 0, stop
        self._write(_MOST_WAITING)

    def _write(self, most_waiting: int) -> None:
        """Write chunks in their order, until no more than that many are waiting."""
        while len(self._waiting) > most_waiting:
            dataset, start, stop, packed = self._waiting.popleft()
            dataset.resize(stop, axis=0)
            dataset.id.write_direct_chunk((start,) + (0,) * (dataset.ndim - 1), packed.result())

    def add_rows(
        self, counts: NDArray[np.int64], indices: NDArray[np.int32], data: NDArray[np.float32]
    ) -> None:
        """Add CSR rows: nonzeros of each, cells, fractions."""
        self._begun.result()
        self._append(self._indices, indices)
        self._append(self._data, data)
        self._append(self._indptr, self.nonzeros + np.cumsum(counts))
        self.rows += len(counts)
        self.nonzeros += len(data)
        self._raise_failure()

    def finish(self, index: NDArray[np.int32], poses: Iterable[NDArray[np.float64]]) -> None:
        """Add the index [K, N] or [K, N, B], piece by piece, and the poses, in pieces [k, 3]."""
        self._begun.result()
        index_column = self._column("index", np.int32, *index.shape[1:])
        self._append(index_column, index)
        poses_column = self._column("poses", np.float64, 3)
        for some in poses:
            self._append(poses_column, some)
        for column in (self._data, self._indices, self._indptr, index_column, poses_column):
            if column.filled:
                self._send(column)
        self._write(0)
        self._file["masks"].attrs["shape"] = np.array(
            [self.rows, self.spec.cells**2], dtype=np.int64
        )

    def _raise_failure(self) -> None:
        if self._sink is not None and self._sink.error is not None:
            raise self._sink.error

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
            self._open.close()
            self._raise_failure()
            # The disk has its work while the bytes are summed up.
            with ThreadPoolExecutor(1) as beside:
                synced = beside.submit(sync_to_disk, self.partial)
                write_seal(self.partial, self.spec.version)
            synced.result()
            sync_to_disk(self.partial)
            os.replace(self.partial, self.target)
        except BaseException:
            self._discard()
            raise
        # The bank is complete. Not every system can sync a folder, to make its name safe as well.
        with suppress(OSError):
            sync_to_disk(self.target.parent)

    def _discard(self) -> None:
        """Let go of the file, and remove it."""
        with suppress(CancelledError):
            self._begun.exception()
        if self._sink is not None:
            self._sink.abandoned = True
        try:
            self._open.close()
        finally:
            self.partial.unlink(missing_ok=True)
