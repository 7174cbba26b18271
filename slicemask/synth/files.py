"""Writing pictures and texts whole or not at all."""

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from slicemask.errors import SynthError

# What a file of each format ends with. Pillow can do without it.
ENDS = {".jpg": b"\xff\xd9", ".png": b"IEND\xaeB`\x82"}


def is_whole(path: Path, size: tuple[int, int]) -> bool:
    """Whether a picture is there, of the given (columns, rows), and can be decoded to its end."""
    try:
        with Image.open(path) as image:
            image.load()
            return image.size == size and path.read_bytes().endswith(ENDS[path.suffix])
    except (OSError, SyntaxError):  # Pillow's two ways to say that a file is broken
        return False


def write_picture(path: Path, pixels: NDArray[np.uint8]) -> None:
    """Write uint8 [H, W, 3] as a JPEG or PNG, by the suffix."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.part")
    try:
        image = Image.fromarray(pixels)
        if path.suffix == ".jpg":
            image.save(part, "JPEG", quality=92)
        else:
            image.save(part, "PNG")
        os.replace(part, path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise SynthError(
            f"{path}: cannot be written ({error}); free some space, or choose another folder, "
            "and run the same command again: it goes on where it stopped"
        ) from error


def write_text(path: Path, text: str) -> None:
    """Write a text file."""
    part = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_text(text, encoding="utf-8", newline="\n")
        os.replace(part, path)
    except OSError as error:
        raise SynthError(f"{path}: cannot be written ({error}); choose another folder") from error
