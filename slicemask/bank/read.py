"""Reading a bank: whole as one CSR matrix, or pose by pose."""

import math
import reprlib
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from slicemask.bank.seal import VERSIONS, check_seal
from slicemask.bank.spec import BankSpec, PoseDigest
from slicemask.bank.write import FORMAT
from slicemask.errors import BankError, BankFormatError, PoseError

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

# Up to this many poses, `masks` reads their rows of the index one by one.
_FEW_POSES = 64
# Reading this many rows too many costs less than another read.
_NEAR_ROWS = 64
# What h5py raises at a damaged file.
_HDF5_ERRORS = (OSError, RuntimeError, KeyError, ValueError, TypeError)
# The most values of a stored chunk. HDF5 decodes chunks as a whole, so this bounds the
# memory that a damaged or hostile file can make a reader allocate.
_MOST_CHUNK_VALUES = 1 << 20
_MASK_OBJECTS: dict[str, type] = {"data": np.float32, "indices": np.int32, "indptr": np.int64}


class Bank:
    """An open bank; see `open_bank`. Usable in a ``with`` statement, which closes it.

    Attributes
    ----------
    path : Path
        The file.
    spec : BankSpec
        What the bank holds: poses (grid or digest), frustum, cells, engine, versions.
    rows : int
        M, the number of distinct masks.
    nonzeros : int
        Stored cell fractions, of all rows.
    """

    def __init__(self, path: Path):
        self.path = path
        self._file = h5py.File(path, "r", locking=False)
        try:
            self.spec = self._read_spec()
            self._check_objects()
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> "Bank":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def __len__(self) -> int:
        """K, the number of poses."""
        return len(self.spec.poses)

    def __repr__(self) -> str:
        return f"<Bank {self.path.name}: {self.spec.summary()}; {self.rows} distinct masks>"

    def close(self) -> None:
        """Close the file; arrays already read stay valid."""
        self._file.close()

    @cached_property
    def poses(self) -> NDArray[np.float64]:
        """The poses, float64 [K, 3]: u, v, heading_deg. Read on first use and kept."""
        poses = self._read("poses")
        expected = self.spec.poses
        if isinstance(expected, PoseDigest):
            same = PoseDigest.of(poses) == expected
        else:
            same = bool((np.abs(poses - expected.poses()) <= 1e-9).all())
        if not same:
            raise self._fault("/poses", f"those of the spec, {expected}", "others")
        return poses

    @cached_property
    def index(self) -> NDArray[Any]:
        """Row of the distinct masks for each pose and slice, int32 [K, N]. Read once and kept.

        With bands it is [K, N, B].
        """
        index = self._read("index")
        self._check_index(index)
        return index

    def csr(self) -> "csr_matrix":
        """The distinct masks, float32 SciPy CSR [M, L * L]; cell (i, j) is column i * L + j.

        Reads all rows. Indices are int32 if they fit, as SciPy expects.
        """
        from scipy.sparse import csr_matrix  # here: it takes 50 ms, and answers do without

        matrix = csr_matrix(self.csr_arrays(), shape=(self.rows, self.spec.cells**2))
        matrix.has_sorted_indices = True
        return matrix

    def csr_arrays(self) -> tuple[NDArray[np.float32], NDArray[Any], NDArray[Any]]:
        """The arrays of `csr`, as the file holds them: data, indices, indptr. Reads all rows."""
        data, indices, indptr = (self._read(f"masks/{name}") for name in _MASK_OBJECTS)
        self._check_rows(data, indices, indptr, 0)
        return data, indices, indptr

    def masks(self, pose: int | ArrayLike) -> NDArray[np.float32]:
        """Masks of one pose, float32 [N, L, L], or of several, [..., N, L, L].

        With bands they are [..., N, B, L, L]. Reads only the parts of the file that hold these
        poses' rows.

        Parameters
        ----------
        pose : int or integers [...]
            Pose indices, 0 to K - 1.

        Raises
        ------
        PoseError
            If an index is out of that range or not a whole number.
        """
        asked = np.asarray(pose)
        if asked.size and not np.issubdtype(asked.dtype, np.integer):
            raise PoseError(f"pose index {pose!r} is not a whole number")
        outside = asked[(asked < 0) | (asked >= len(self))]
        if outside.size:
            raise PoseError(
                f"pose {outside.flat[0]} is not in the bank; it holds 0 to {len(self) - 1}"
            )
        rows, place = np.unique(self._rows_of(asked.ravel()), return_inverse=True)
        cells = self.spec.cells
        dense = np.zeros((len(rows), cells * cells), dtype=np.float32)
        # Rows that lie close together are read together, with those between them.
        for run in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(rows) > _NEAR_ROWS) + 1):
            if len(run):
                self._fill(dense[run[0] : run[-1] + 1], rows[run])
        axes = self.spec.frustum.mask_axes
        return dense[place.ravel()].reshape(*asked.shape, *axes, cells, cells)

    def _rows_of(self, poses: NDArray[np.integer[Any]]) -> NDArray[Any]:
        """Rows of poses' masks, [k, N] or [k, N, B].

        For a few poses only their part of the index is read.
        """
        if "index" in self.__dict__ or len(poses) > _FEW_POSES:
            return np.asarray(self.index[poses])
        rows = [self._read("index", slice(int(k), int(k) + 1)) for k in poses]
        index = np.concatenate([np.empty((0, *self.spec.frustum.mask_axes), np.int32), *rows])
        self._check_index(index)
        return index

    def _check_index(self, index: NDArray[Any]) -> None:
        if index.size and not 0 <= int(index.min()) <= int(index.max()) < self.rows:
            raise self._fault("/index", f"rows from 0 to {self.rows - 1}", "others")

    def _fill(self, dense: NDArray[np.float32], rows: NDArray[Any]) -> None:
        """Read rows [r], ascending, into dense [r, L * L]."""
        first, last = int(rows[0]), int(rows[-1])
        indptr = self._read("masks/indptr", slice(first, last + 2))
        stored = slice(int(indptr[0]), int(indptr[-1]))
        if not 0 <= stored.start <= stored.stop <= self.nonzeros:
            raise self._fault("/masks/indptr", "row starts in order", "others")
        data, indices = self._read("masks/data", stored), self._read("masks/indices", stored)
        self._check_rows(data, indices, indptr, stored.start)
        number = np.full(last + 1 - first, -1)  # of the rows asked for; -1 between them
        number[rows - first] = np.arange(len(rows))
        row = np.repeat(number, np.diff(indptr))
        asked = row >= 0
        dense[row[asked], indices[asked]] = data[asked]

    def _read(self, name: str, some: slice = slice(None)) -> NDArray[Any]:
        if not self._file:
            raise BankError(f"{self.path}: was closed; open it again to read /{name}")
        try:
            return np.asarray(self._file[name][some])
        except _HDF5_ERRORS as error:
            raise BankFormatError(f"{self.path}: /{name} cannot be read: {error}") from error

    def _fault(self, name: str, expected: str, found: str) -> BankFormatError:
        return BankFormatError(f"{self.path}: {name}: expected {expected}, found {found}")

    def _read_spec(self) -> BankSpec:
        attributes = self._file.attrs
        for name, known in (("format", (FORMAT.encode(),)), ("version", VERSIONS)):
            found = attributes.get(name)
            if not np.isscalar(found) or found not in known:
                expected = " or ".join(map(repr, known))
                raise self._fault(f"attribute {name}", expected, reprlib.repr(found))
        spec = attributes.get("spec")
        if not isinstance(spec, bytes):
            raise self._fault("attribute spec", "JSON as bytes", reprlib.repr(spec))
        try:
            read = BankSpec.from_json(spec.decode())
        except (BankFormatError, UnicodeDecodeError) as error:
            raise BankFormatError(f"{self.path}: attribute spec: {error}") from error
        if read.version != attributes["version"]:
            raise self._fault(
                "attribute version",
                f"{read.version} for such a spec ({read.summary()})",
                repr(int(attributes["version"])),
            )
        return read

    def _check_objects(self) -> None:
        """Check every object's type and size, and that its data is there, reading none of it."""
        cells = self.spec.cells
        shapes: dict[str, tuple[int | None, ...]] = {
            "index": (len(self), *self.spec.frustum.mask_axes),
            "poses": (len(self), 3),
            "masks/indptr": (None,),
            "masks/indices": (None,),
            "masks/data": (None,),
        }
        dtypes: dict[str, type] = {"index": np.int32, "poses": np.float64}
        dtypes.update((f"masks/{name}", dtype) for name, dtype in _MASK_OBJECTS.items())
        for name, shape in shapes.items():
            dataset = self._file.get(name)
            # A link to elsewhere would bring in what the seal does not cover.
            hard = all(
                isinstance(self._file.get(part, getlink=True), h5py.HardLink)
                for part in (name, name.split("/")[0])
            )
            if not hard or not isinstance(dataset, h5py.Dataset):
                raise self._fault(f"/{name}", "a dataset", "none")
            wrong = dataset.ndim != len(shape) or any(
                size not in (None, found) for size, found in zip(shape, dataset.shape, strict=False)
            )
            if wrong or dataset.dtype != dtypes[name]:
                expected = ", ".join("any" if size is None else str(size) for size in shape)
                raise self._fault(
                    f"/{name}",
                    f"{np.dtype(dtypes[name])} [{expected}]",
                    f"{dataset.dtype} {list(dataset.shape)}",
                )
            # A dataset may declare more than the file holds; reading it would take that much
            # memory and give zeros.
            chunk = dataset.chunks
            if (
                chunk is None
                or math.prod(chunk) > _MOST_CHUNK_VALUES
                or not dataset.fletcher32
                or dataset.external
                or dataset.is_virtual
            ):
                raise self._fault(
                    f"/{name}",
                    f"chunks of at most {_MOST_CHUNK_VALUES:,} values with Fletcher-32 checksums",
                    "another layout" if chunk is None else f"chunks {list(chunk)}",
                )
            chunks = math.prod(-(-n // c) for n, c in zip(dataset.shape, chunk, strict=True))
            if dataset.id.get_num_chunks() != chunks:
                raise self._fault(
                    f"/{name}", f"{chunks} stored chunks", str(dataset.id.get_num_chunks())
                )
        self.rows = len(self._file["masks/indptr"]) - 1
        self.nonzeros = len(self._file["masks/data"])
        declared = self._file["masks"].attrs.get("shape")
        if np.shape(declared) != (2,) or list(declared) != [self.rows, cells * cells]:
            raise self._fault(
                "/masks attribute shape", str([self.rows, cells * cells]), reprlib.repr(declared)
            )
        if len(self._file["masks/indices"]) != self.nonzeros:
            raise self._fault(
                "/masks/indices", f"{self.nonzeros} values", str(len(self._file["masks/indices"]))
            )
        ends = self._read("masks/indptr", slice(0, 1)), self._read("masks/indptr", slice(-1, None))
        if self.rows < 1 or ends[0] != 0 or ends[1] != self.nonzeros:
            raise self._fault("/masks/indptr", f"0 to {self.nonzeros}", "others")

    def _check_rows(
        self,
        data: NDArray[np.float32],
        indices: NDArray[np.int32],
        indptr: NDArray[np.int64],
        start: int,
    ) -> None:
        """Check rows: starts in order, cells in the tile and ascending, fractions in (0, 1]."""
        if (np.diff(indptr) < 0).any() or int(indptr[-1]) - start != len(indices):
            raise self._fault("/masks/indptr", "row starts in order", "others")
        if len(indices) == 0:
            return
        if not ((data > 0.0) & (data <= 1.0)).all():
            raise self._fault("/masks/data", "fractions above 0 and up to 1", "others")
        ascending = np.diff(indices) > 0
        row_starts = indptr[1:-1] - start
        ascending[row_starts[(row_starts > 0) & (row_starts < len(indices))] - 1] = True
        if not ascending.all() or not 0 <= int(indices.min()) <= int(indices.max()) < (
            self.spec.cells**2
        ):
            raise self._fault(
                "/masks/indices", f"cells 0 to {self.spec.cells**2 - 1}, ascending", "others"
            )


def open_bank(path: str | Path, check: bool = True) -> Bank:
    """Open a bank for reading.

    Parameters
    ----------
    path : path
        A file written by `build_bank` or ``slicemask build``.
    check : bool
        Compare the file with its seal (SHA-256) first, so that a bank altered in any byte is
        refused. It reads the file once, about 1 GB a second; False leaves it to HDF5's own
        checksums, for large banks that are opened often.

    Returns
    -------
    bank : Bank
        An open bank, of which only the spec has been read; use it in a ``with`` statement.

    Raises
    ------
    BankFormatError
        If the file is not a bank, cut short, altered, of another version, or its objects do not
        fit its spec; the message names the file, the object, what was expected and found.
    BankError
        If it cannot be read at all.
    """
    path = Path(path)
    try:
        if path.exists() and not path.is_file():
            raise BankError(f"{path}: is a folder or not a plain file; name a bank")
        sealed = check_seal(path) if check else None
        bank = Bank(path)
        if sealed not in (None, bank.spec.version):
            bank.close()
            raise BankFormatError(
                f"{path}: is sealed as version {sealed}, and its spec is one of version "
                f"{bank.spec.version}; build it again with slicemask build --force"
            )
        return bank
    except FileNotFoundError:
        raise BankError(f"{path}: there is no such bank") from None
    except PermissionError:
        raise BankError(f"{path}: permission denied; change the file's permissions") from None
    except BankError:
        raise
    except _HDF5_ERRORS as error:
        raise BankFormatError(f"{path}: cannot be read as a bank: {error}") from error
