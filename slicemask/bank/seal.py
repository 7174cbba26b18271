"""The seal: the first 512 bytes of a bank, which vouch for all the others.

HDF5 lets a file begin with a block for its user. A bank's holds three lines of text (format
and version, size, SHA-256 of everything after the block) padded with zeros. A reader checks it
before HDF5 parses a single byte, so a bank that was cut short or altered anywhere is refused
rather than misread, and a file that is not a bank does not reach the HDF5 library.
"""

import hashlib
import re
from pathlib import Path

from slicemask.errors import BankFormatError

SEAL_BYTES = 512
# Of the format; `slicemask.bank.spec.BankSpec.version` says which is which.
VERSIONS = (1, 2, 3)

_MAGIC = b"slicemask-bank "
_HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_PATTERN = re.compile(
    rb"slicemask-bank ([0-9]{1,9})\nbytes ([0-9]{1,18})\nsha256 ([0-9a-f]{64})\n\0*"
)


def write_seal(path: Path, version: int) -> None:
    """Seal a finished file of a format version in place: fill in its first 512 bytes."""
    with path.open("r+b") as file:
        file.seek(SEAL_BYTES)
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        size = file.tell()
        text = f"slicemask-bank {version}\nbytes {size}\nsha256 {digest}\n"
        file.seek(0)
        file.write(text.encode().ljust(SEAL_BYTES, b"\0"))


def has_seal(path: Path) -> bool:
    """Whether a file begins as a bank does, sound or not."""
    with path.open("rb") as file:
        return file.read(len(_MAGIC)) == _MAGIC


def check_seal(path: Path) -> int:
    """Check that a file is a bank of a known version and is as it was written.

    Reads the whole file once, in small pieces.

    Returns
    -------
    version : int
        Of the format, as the seal has it.

    Raises
    ------
    BankFormatError
        If it is not a bank, or a bank of another version, cut short or altered.
    OSError
        If it cannot be read.
    """
    with path.open("rb") as file:
        block = file.read(SEAL_BYTES)
        match = _PATTERN.fullmatch(block)
        if match is None or len(block) < SEAL_BYTES:
            raise BankFormatError(f"{path}: {_fault(block)}")
        version, size, expected = int(match[1]), int(match[2]), match[3].decode()
        if version not in VERSIONS:
            raise BankFormatError(
                f"{path}: is a bank of version {version}, and this slicemask reads versions "
                f"{' and '.join(map(str, VERSIONS))}: read it with the slicemask that wrote it, or "
                "build it again"
            )
        file.seek(0, 2)
        if file.tell() != size:
            raise BankFormatError(
                f"{path}: is {'cut short' if file.tell() < size else 'altered'}: expected "
                f"{size} bytes, found {file.tell()}; build it again with slicemask build --force"
            )
        file.seek(SEAL_BYTES)
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    if digest != expected:
        raise BankFormatError(
            f"{path}: was altered after it was written: expected SHA-256 {expected[:12]}..., "
            f"found {digest[:12]}...; build it again with slicemask build --force"
        )
    return version


def _fault(block: bytes) -> str:
    """What is wrong with a first block that is no seal."""
    if not block:
        return (
            "is empty, not a slicemask bank; remove it, or build it again with "
            "slicemask build --force"
        )
    if block.startswith(_MAGIC):
        if len(block) < SEAL_BYTES:
            return (
                f"is cut short: expected a seal of {SEAL_BYTES} bytes, found {len(block)}; "
                "build it again with slicemask build --force"
            )
        return "its seal (first 512 bytes) was altered; build it again with slicemask build --force"
    if block.startswith(_HDF5_SIGNATURE):
        return "is an HDF5 file but not a slicemask bank: it has no seal in its first 512 bytes"
    return "is not a slicemask bank"
