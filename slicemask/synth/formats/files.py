"""Writing a data set's pictures and texts, and telling whether they are complete."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from slicemask import files
from slicemask.errors import SynthError, is_out_of_resources

# What a file of each format ends with. Pillow can do without it.
ENDS = {".jpg": b"\xff\xd9", ".png": b"IEND\xaeB`\x82"}
_REMEDY = (
    "free some space, or choose another folder, and run the same command again: it goes on where "
    "it stopped"
)


def is_complete(path: Path, size: tuple[int, int]) -> bool:
    """Whether a picture exists, has the given (columns, rows) and can be decoded to its end."""
    try:
        with Image.open(path) as image:
            if image.size != size:
                return False
            image.load()
            return path.read_bytes().endswith(ENDS[path.suffix])
    except Exception as error:  # a broken file makes Pillow raise all sorts
        if is_out_of_resources(error):
            raise
        return False


def write_picture(path: Path, pixels: NDArray[np.uint8], exif: bytes | None = None) -> None:
    """Write uint8 [H, W, 3] as a JPEG or PNG, by the suffix; a JPEG with EXIF data, if given."""
    _make_folder(path)
    with files.atomic_write(path, SynthError, _REMEDY) as partial:
        image = Image.fromarray(pixels)
        if path.suffix == ".jpg":
            image.save(partial, "JPEG", quality=92, **({} if exif is None else {"exif": exif}))
        else:
            image.save(partial, "PNG")


def write_text(path: Path, text: str) -> None:
    """Write a text file."""
    _make_folder(path)
    files.write_text(path, text, SynthError, _REMEDY)


def _make_folder(path: Path) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SynthError(
            f"{path.parent}: could not be created: {error.strerror}; choose another folder"
        ) from error
