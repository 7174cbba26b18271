"""Building a bank: distinct slices of each batch, their masks, and the rows of the file."""

import contextlib
import functools
import math
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import deflate
import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from slicemask._version import __version__
from slicemask.bank.batches import GridSource, ListSource, PoseSource
from slicemask.bank.cache import bank_path, ensure_cache_dir
from slicemask.bank.lock import build_lock
from slicemask.bank.read import open_bank
from slicemask.bank.rows import map_ordered, mask_rows, split_by_size
from slicemask.bank.seal import has_seal
from slicemask.bank.spec import BankSpec, PoseDigest
from slicemask.bank.write import BankWriter
from slicemask.errors import BankError, BankExistsError
from slicemask.geometry.distinct import (
    SectorOrbit,
    UnanchoredSlices,
    distinct_slices,
    distinct_unanchored,
)
from slicemask.geometry.frustum import Frustum
from slicemask.geometry.masks import Engine, engine_fractions
from slicemask.geometry.poses import PoseGrid, check_poses
from slicemask.interrupts import CancelCheck, run_cancellable
from slicemask.threads import thread_count

# Bytes of a new file that are written at once.
_ZEROS = 1 << 20

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class MemoryLimits:
    """What bounds the memory of a build.

    The bounds of a batch determine the order of the bank's rows, and so its bytes; the masks are
    the same whatever they are.

    Parameters
    ----------
    batch_slices : int
        Slices in a batch, at most; more only if those of one place and its images are more.
    batch_values : int
        Cells of a batch's masks, at most.
    index_bytes : int
        Size of an index that is held in memory, at most; a larger one is kept in a file.
    """

    batch_slices: int = 1 << 16
    batch_values: int = 1 << 26
    index_bytes: int = 1 << 24


_DEFAULT_LIMITS = MemoryLimits()


@dataclass(frozen=True)
class BuildResult:
    """What `build_bank` did.

    Parameters
    ----------
    path : Path
        The bank.
    reused : bool
        Whether it existed already and matched, so that nothing was computed.
    rows : int
        M, the number of distinct masks in it.
    """

    path: Path
    reused: bool
    rows: int


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
    limits: MemoryLimits = _DEFAULT_LIMITS,
) -> BuildResult:
    """Build the bank of poses' slice masks, or reuse the one that exists.

    Memory is bounded: masks are streamed to the file, and of a grid's poses nothing is held but
    their index, and that only up to 16 MiB. Of a list, its poses and some 100 bytes for each are
    held. The same arguments and versions give the same bytes, whatever ``jobs`` is.

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
        The cache folder; SLICEMASK_CACHE or ``./masks_cache`` by default. It is made if missing.
    force : bool
        Build even if a bank exists, and replace it. A file that is not a bank is never replaced,
        unless it is empty.
    jobs : int, optional
        Threads; as many as there are processors by default.
    progress : callable, optional
        Called with (poses done, poses in all) as the work goes on, from the thread that builds.
    limits : MemoryLimits, optional
        What bounds memory.

    Returns
    -------
    result : BuildResult
        The path, and whether a matching bank existed already.

    Raises
    ------
    SpecError, PoseError
        If an argument is invalid.
    BankExistsError
        If the output exists and holds something else.
    BankError
        If the bank cannot be written; nothing is left behind.
    """
    frustum = frustum or Frustum()
    jobs = thread_count(jobs)
    source: PoseSource
    if isinstance(poses, PoseGrid):
        spec = BankSpec(poses, frustum, cells, engine)
        source = GridSource(poses)
    else:
        checked = check_poses(poses)
        spec = BankSpec(PoseDigest.of(checked), frustum, cells, engine)
        source = ListSource(checked)
    path = bank_path(spec, out, cache)

    def build(check: CancelCheck) -> BuildResult:
        # Reusing a bank needs no lock, nor a folder that may be written to.
        rows = None if force else _reusable_rows(path, spec, force=False)
        if rows is not None:
            return BuildResult(path, reused=True, rows=rows)
        # A second builder waits here, and then finds the bank.
        with ensure_cache_dir(path.parent), build_lock(path, check) as locked:
            rows = _reusable_rows(path, spec, force)
            if rows is not None:
                return BuildResult(path, reused=True, rows=rows)
            written = replace(spec, versions=_versions(engine))
            return BuildResult(
                path, False, _build(path, written, source, jobs, progress, limits, check, locked)
            )

    try:
        return run_cancellable(build)
    except BankError:
        raise
    except (OSError, RuntimeError) as error:  # h5py raises both
        raise BankError(
            f"{path}: cannot be written: {_reason(error)}; name another folder with --cache, or "
            "another file with --out"
        ) from error


def _versions(engine: Engine) -> dict[str, str]:
    versions = {
        "slicemask": __version__,
        "numpy": np.__version__,
        "h5py": h5py.__version__,
        "hdf5": h5py.version.hdf5_version,
        "deflate": deflate.__version__,
    }
    if engine == "shapely":
        import shapely

        versions |= {"shapely": shapely.__version__, "geos": shapely.geos_version_string}
    return versions


def _reusable_rows(path: Path, spec: BankSpec, force: bool) -> int | None:
    """Rows of the existing bank if it is the one asked for; None if it is to be built.

    Raises BankExistsError if it is another, and BankFormatError if it is damaged.
    """
    if not path.exists():
        return None
    if path.is_file():
        try:
            sealed = has_seal(path)
        except OSError as error:
            raise BankExistsError(
                f"{path}: exists and cannot be read ({error.strerror}), so it is not replaced; "
                "move it away or name another file with --out"
            ) from error
        if path.stat().st_size == 0:  # nothing to lose
            if force:
                return None
            raise BankExistsError(
                f"{path}: exists and is empty, as a crash or a full disk may leave it; remove it, "
                "or replace it with --force"
            )
        if not sealed:
            raise BankExistsError(
                f"{path}: exists and is not a slicemask bank, so it is not replaced; move it away "
                "or name another file with --out"
            )
        if force:  # sound or not
            return None
    with open_bank(path) as bank:
        found, rows = bank.spec, bank.rows
    if found != spec:
        raise BankExistsError(
            f"{path}: holds another bank ({found.summary()}) than the one asked for "
            f"({spec.summary()}); name another file with --out, or replace it with --force"
        )
    return rows


def _build(
    path: Path,
    spec: BankSpec,
    source: PoseSource,
    jobs: int,
    progress: Progress | None,
    limits: MemoryLimits,
    check: CancelCheck,
    locked: bool,
) -> int:
    """Build the bank and return its number of rows."""
    total, masks = len(spec.poses), math.prod(spec.frustum.mask_axes)
    pool = ThreadPoolExecutor(jobs)
    with BankWriter(path, spec, pool, locked) as writer, contextlib.ExitStack() as after:
        # After an error, work that no thread has started is dropped.
        after.callback(pool.shutdown, cancel_futures=True)
        # The engine is imported while the first slices are found; an error would recur with them.
        pool.submit(engine_fractions, spec.engine, spec.frustum)
        index = after.enter_context(_empty_index((total, masks), path.parent, limits))
        compute = functools.partial(
            mask_rows, frustum=spec.frustum, cells=spec.cells, engine=spec.engine
        )
        pieces = _pieces(source, spec, index, limits)
        if progress:
            progress(0, total)
        # Enough waits for every thread to find work while the oldest results are written.
        for fraction_done, parts in map_ordered(compute, pieces, pool, 2 * jobs + 8):
            check()
            for rows in parts:
                writer.add_rows(rows.counts, rows.indices, rows.data)
            if progress:
                progress(round(fraction_done * total), total)
        writer.finish(index.reshape(total, *spec.frustum.mask_axes), source.pieces())
    return writer.rows


@contextlib.contextmanager
def _empty_index(
    shape: tuple[int, int], folder: Path, limits: MemoryLimits
) -> Iterator[NDArray[np.int32]]:
    """An index to be filled in batch by batch, out of order: in a file if it is large.

    The file has no name: it is gone with the process, and the system can page it out.
    """
    size = 4 * shape[0] * shape[1]
    if size <= limits.index_bytes:
        yield np.zeros(shape, dtype=np.int32)
        return
    import tempfile  # takes long to load

    with tempfile.TemporaryFile(dir=folder) as scratch:
        # Written, not truncated, to its size: a full disk is an error here, and would be a crash
        # at some later store into a mapped hole.
        for start in range(0, size, _ZEROS):
            scratch.write(bytes(min(_ZEROS, size - start)))
        scratch.flush()
        yield np.memmap(scratch, dtype=np.int32, mode="r+", shape=shape)


def _pieces(
    source: PoseSource, spec: BankSpec, index: NDArray[np.int32], limits: MemoryLimits
) -> Iterator[tuple[float, SectorOrbit]]:
    """Distinct slices whose masks are the bank's rows, in order and in pieces; fills the index.

    The index is [K, N * B]. With each piece comes the fraction of the work that is done after it,
    in [0, 1].
    """
    masks = index.shape[1]
    most = min(limits.batch_slices, max(1, limits.batch_values // spec.cells**2))
    rows, found, done = 0, 0, 0.0
    unanchored: list[UnanchoredSlices] = []
    unanchored_at: list[NDArray[np.int64]] = []
    for batch in source.batches(max(1, most // masks)):
        distinct = distinct_slices(batch.u, batch.v, batch.place, batch.heading_deg, spec.frustum)
        number = distinct.mask_of
        anchored = number >= 0
        # An unanchored slice is -1 minus its number among all batches' until its row is known.
        placed = np.where(anchored, rows + number, number - found)
        index[batch.pose] = placed
        if not anchored.all():
            pose, n = np.nonzero(~anchored)
            unanchored_at.append(batch.pose[pose] * masks + n)
            unanchored.append(distinct.unanchored)
            found += len(distinct.unanchored.shape)
        orbit = distinct.anchored
        rows += orbit.rows
        for piece in split_by_size(orbit, spec.cells):
            done += np.count_nonzero(anchored) * len(piece.sector) / len(orbit.sector) / index.size
            yield done, piece
    if unanchored:
        orbit, row = distinct_unanchored(UnanchoredSlices.joined(unanchored))
        flat = index.reshape(-1)
        at = np.concatenate(unanchored_at)
        flat[at] = rows + row[-1 - flat[at]]
        rest = 1.0 - done
        for piece in split_by_size(orbit, spec.cells):
            done += rest * len(piece.sector) / len(orbit.sector)
            yield done, piece


def _reason(error: BaseException) -> str:
    """The system's own words for an error, which HDF5 buries in its message."""
    number = getattr(error, "errno", None)
    if number is None:
        for code in (28, 27, 13, 30, 122):  # no space, file too large, permission, read-only, quota
            if f"errno = {code}" in str(error):
                number = code
    return os.strerror(number) if number else str(error)
