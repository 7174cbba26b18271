"""Text files of labels: lines and numbers, read strictly."""

import math
import re
from pathlib import Path

from slicemask.errors import is_out_of_resources
from slicematch.data.errors import DatasetError

# float() also takes "1_0", "nan", and digits of other scripts.
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)


def read_lines(path: Path, what: str, hint: str) -> list[tuple[int, str]]:
    """Read a text file's lines that hold more than white space, with their numbers from 1.

    A byte-order mark is skipped, and the last line may lack its newline.

    Parameters
    ----------
    path : Path
        The file.
    what, hint : str
        What the file is and how to come by it, for the message if it is missing.

    Raises
    ------
    DatasetError
        If the file is missing, unreadable, empty or not text.
    OSError
        If open files ran out, which is no fault of the file.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise DatasetError(f"{path}: {what} is missing; {hint}") from None
    except UnicodeDecodeError as error:
        raise DatasetError(f"{path}: {what} is not text in UTF-8; save it as UTF-8") from error
    except OSError as error:
        if is_out_of_resources(error):
            raise
        raise DatasetError(f"{path}: {what} is not readable ({error.strerror})") from error
    lines = [
        (number, line) for number, line in enumerate(text.split("\n"), start=1) if line.strip()
    ]
    if not lines:
        raise DatasetError(f"{path}: {what} is empty; fetch it again")
    return lines


def parse_number(text: str) -> float | None:
    """The finite decimal number that a text is, or None.

    Examples
    --------
    >>> parse_number("-1.5e2"), parse_number("1_0"), parse_number("nan"), parse_number("1e999")
    (-150.0, None, None, None)
    """
    number = float(text) if _NUMBER.fullmatch(text) else math.nan
    return number if math.isfinite(number) else None
