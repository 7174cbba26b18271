"""Building a bank: distinct slices of each batch, their masks, and the rows of the file."""

import os
import tempfile
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import filelock
import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

import slicemask
from slicemask.bank.batches import Batch, GridSource, ListSource, PoseSource, batches
from slicemask.bank.cache import bank_path
from slicemask.bank.read import open_bank
from slicemask.bank.seal import has_seal
from slicemask.bank.spec import BankSpec, PoseDigest
from slicemask.bank.threads import thread_count
from slicemask.bank.write import BankWriter
from slicemask.errors import BankError, BankExistsError, BankFormatError
from slicemask.geometry.distinct import (
    Images,
    Loose,
    distinct_loose,
    distinct_slices,
)
from slicemask.geometry.frustum import Frustum
from slicemask.geometry.masks import Engine, engine_fractions, tidy
from slicemask.geometry.poses import PoseGrid, check_poses
from slicemask.geometry.symmetry import SYMMETRIES

# Mask values that a batch may hold as dense arrays, and slices it may have: what bounds memory.
_DENSE_VALUES = 1 << 18
_BATCH_VALUES = 1 << 26
_BATCH_SLICES = 1 << 16
# Bytes of a new file that are written at once.
_ZEROS = 1 << 20

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class BuildResult:
    """What `build_bank` did.

    Parameters
    ----------
    path : Path
        The bank.
    reused : bool
        Whether it was there already and matched, so that nothing was computed.
    rows : int
        M, the number of distinct masks in it.
    """

    path: Path
    reused: bool
    rows: int


@dataclass(frozen=True)
class _Rows:
    """CSR rows: nonzeros of each row, their cells, and the fractions."""

    counts: NDArray[np.int64]
    indices: NDArray[np.int32]
    data: NDArray[np.float32]


def build_bank(
    poses: PoseGrid | ArrayLike,
    frustum: Frustum | None = None,
    cells: int = 32,
    *,
    engine: Engine = "shapely",
    out: str | Path | None = None,
    cache: str | Path | None = None,
    force: bool = False,
    jobs: int | None = None,
    progress: Progress | None = None,
) -> BuildResult:
    """Build the bank of poses' slice masks, or find it built.

    Memory is bounded: masks are streamed to the file, and of each pose of a list only some 50
    bytes are held. The same arguments and versions give the same bytes, whatever ``jobs`` is.

    Parameters
    ----------
    poses : PoseGrid or array [K, 3]
        The candidates: a grid, or u, v, heading_deg in the aerial frame.
    frustum : Frustum, optional
        Field of view and slices; 360 degrees in 16 slices by default.
    cells : int
        L, the cells along each side of the tile.
    engine : {"shapely", "rays"}
        What computes the masks.
    out : path, optional
        Where the bank goes. By default, a name that says what it holds, in the cache folder.
    cache : path, optional
        The cache folder; SLICEMASK_CACHE or ``./masks_cache`` by default.
    force : bool
        Build even if a bank is there, and replace it. A file that is no bank is never replaced.
    jobs : int, optional
        Threads; as many as there are processors by default.
    progress : callable, optional
        Called with (poses done, poses in all) as the work goes on.

    Returns
    -------
    result : BuildResult
        The path, and whether a matching bank was there already.

    Raises
    ------
    SpecError, PoseError
        If the arguments cannot be.
    BankExistsError
        If the output exists and holds something else.
    BankError
        If the bank cannot be written; nothing is left behind.
    """
    frustum = frustum or Frustum()
    jobs = thread_count(jobs)
    source: PoseSource
    if isinstance(poses, PoseGrid):
        spec = BankSpec(poses, frustum, cells, engine, versions=_versions(engine))
        source = GridSource(poses)
    else:
        checked = check_poses(poses)
        spec = BankSpec(PoseDigest.of(checked), frustum, cells, engine, versions=_versions(engine))
        source = ListSource(checked)
    path = bank_path(spec, out, cache)
    try:
        # One builder a bank: a second one waits here, and then finds the bank.
        lock = path.with_name(f".{path.name}.lock")
        with filelock.FileLock(lock):
            try:
                if path.exists():
                    rows = _reusable_rows(path, spec, force)
                    if rows is not None:
                        return BuildResult(path, reused=True, rows=rows)
                rows = _build(path, spec, source, jobs, progress)
            finally:
                lock.unlink(missing_ok=True)
    except BankError:
        raise
    except (OSError, RuntimeError) as error:  # h5py raises both
        raise BankError(f"{path}: cannot be written: {_reason(error)}") from error
    return BuildResult(path, reused=False, rows=rows)


def _versions(engine: Engine) -> dict[str, str]:
    versions = {
        "slicemask": slicemask.__version__,
        "numpy": np.__version__,
        "h5py": h5py.__version__,
        "hdf5": h5py.version.hdf5_version,
    }
    if engine == "shapely":
        import shapely

        versions |= {"shapely": shapely.__version__, "geos": shapely.geos_version_string}
    return versions


def _reusable_rows(path: Path, spec: BankSpec, force: bool) -> int | None:
    """Rows of the bank in the way if it is the one asked for, or None if it may be replaced.

    Raises BankExistsError if it is neither, and BankFormatError if it is damaged.
    """
    try:
        with open_bank(path) as bank:
            found, rows = bank.spec, bank.rows
    except BankFormatError as error:
        if not has_seal(path):
            raise BankExistsError(
                f"{path}: exists and is no slicemask bank, so it is not replaced; move it away "
                "or name another file with --out"
            ) from error
        if force:
            return None
        raise
    if force:
        return None
    if found != spec:
        raise BankExistsError(
            f"{path}: holds another bank ({found.summary()}) than the one asked for "
            f"({spec.summary()}); name another file with --out, or replace it with --force"
        )
    return rows


def _build(
    path: Path, spec: BankSpec, source: PoseSource, jobs: int, progress: Progress | None
) -> int:
    """Build the bank and give its number of rows."""
    total, slices = len(spec.poses), spec.frustum.slices
    most = min(_BATCH_SLICES, max(1, _BATCH_VALUES // spec.cells**2))
    work = batches(source, max(1, most // slices))
    done = 0
    with (
        BankWriter(path, spec) as writer,
        # The index is filled in batch by batch, out of order. A nameless file holds it: it is
        # gone with the process, and the system can page it out.
        tempfile.TemporaryFile(dir=path.parent) as scratch,
    ):
        # Written, not truncated, to its size: a full disk is an error here, and would be a crash
        # at some later store into a mapped hole.
        size = total * slices * 4
        for start in range(0, size, _ZEROS):
            scratch.write(bytes(min(_ZEROS, size - start)))
        scratch.flush()
        index = np.memmap(scratch, dtype=np.int32, mode="r+", shape=(total, slices))
        loose: list[Loose] = []
        loose_at: list[NDArray[np.int64]] = []
        found = 0
        for batch, number, free, rows in _in_order(work, spec, jobs):
            first = writer.add_rows(rows.counts, rows.indices, rows.data)
            placed = np.where(number >= 0, first + number, number)
            if len(free.shape):
                where = np.nonzero(number < 0)
                loose_at.append(batch.pose[where[0]] * slices + where[1])
                placed[where] += -found  # -1 - an index among all loose slices
                loose.append(free)
                found += len(free.shape)
            index[batch.pose] = placed
            done += len(batch.pose)
            if progress:
                progress(done, total)
        if found:
            images, row = distinct_loose(_joined_loose(loose))
            first = writer.rows
            for rows in _mask_rows(images, spec):
                writer.add_rows(rows.counts, rows.indices, rows.data)
            at = np.concatenate(loose_at)
            flat = index.reshape(-1)
            flat[at] = first + row[-1 - flat[at]]
        writer.finish(index, source.pieces())
    return writer.rows


def _joined_rows(pieces: Iterator[_Rows]) -> _Rows:
    parts = list(pieces)
    if not parts:
        return _Rows(np.zeros(0, np.int64), np.zeros(0, np.int32), np.zeros(0, np.float32))
    return _Rows(
        np.concatenate([part.counts for part in parts]),
        np.concatenate([part.indices for part in parts]),
        np.concatenate([part.data for part in parts]),
    )


def _joined_loose(loose: list[Loose]) -> Loose:
    return Loose(
        np.concatenate([some.shape for some in loose]),
        np.concatenate([some.left_deg for some in loose]),
        np.concatenate([some.offset for some in loose]),
    )


_Done = tuple[Batch, NDArray[np.int64], Loose, _Rows]


def _in_order(work: Iterator[Batch], spec: BankSpec, jobs: int) -> Iterator[_Done]:
    """Compute batches on threads, and yield them in order with few waiting."""

    def compute(batch: Batch) -> _Done:
        distinct = distinct_slices(batch.u, batch.v, batch.place, batch.heading_deg, spec.frustum)
        return (
            batch,
            distinct.slice_of,
            distinct.loose,
            _joined_rows(_mask_rows(distinct.wedges, spec)),
        )

    # NumPy and Shapely let go of the interpreter's lock while they work: threads are enough.
    pool = ThreadPoolExecutor(jobs)
    try:
        waiting: deque[Future[_Done]] = deque()
        for batch in work:
            waiting.append(pool.submit(compute, batch))
            # Enough for every thread to find work while the oldest batch is written.
            if len(waiting) > 2 * jobs:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)


def _mask_rows(images: Images, spec: BankSpec) -> Iterator[_Rows]:
    """CSR rows of slices that are images of sectors, in the slices' order, in pieces."""
    cells = spec.cells
    fractions = _sector_masks(images, spec)
    step = max(1, _DENSE_VALUES // cells**2)
    for start in range(0, len(images.sector), step):
        sector = images.sector[start : start + step]
        symmetry = images.symmetry[start : start + step]
        dense = np.empty((len(sector), cells, cells), dtype=np.float32)
        for number in np.unique(symmetry):
            some = np.flatnonzero(symmetry == number)
            moved = SYMMETRIES[number].masks(fractions[sector[some]])
            dense[some] = np.ascontiguousarray(moved)  # twice as fast as from a strided view
        flat = dense.reshape(-1)
        at = np.flatnonzero(flat != 0.0)
        row_starts = np.arange(len(sector) + 1) * cells**2
        counts = np.diff(np.searchsorted(at, row_starts))
        cell = at - np.repeat(row_starts[:-1], counts)
        yield _Rows(counts, cell.astype(np.int32), flat[at])


def _sector_masks(images: Images, spec: BankSpec) -> NDArray[np.float32]:
    """Masks of the sectors, float32 [R, L, L], without rounding noise."""
    cells = spec.cells
    masks = np.zeros((len(images.u), cells, cells), dtype=np.float32)
    width_deg = images.right_deg - images.left_deg
    masks[width_deg == 360.0] = 1.0
    engine = engine_fractions(spec.engine)
    partial = np.flatnonzero((width_deg > 0.0) & (width_deg < 360.0))
    step = max(1, _DENSE_VALUES // cells**2)
    for start in range(0, len(partial), step):
        some = partial[start : start + step]
        masks[some] = tidy(
            engine(
                images.u[some], images.v[some], images.left_deg[some], images.right_deg[some], cells
            )
        )
    return masks


def _reason(error: BaseException) -> str:
    """The system's own words for an error, which HDF5 buries in its message."""
    number = getattr(error, "errno", None)
    if number is None:
        for code in (28, 27, 13, 30, 122):  # no space, file too large, permission, read-only, quota
            if f"errno = {code}" in str(error):
                number = code
    return os.strerror(number) if number else str(error)
