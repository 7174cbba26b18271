"""Lists of test headings, such as published code ships with its label files."""

import logging
import math
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from slicematch.errors import ConfigError

log = logging.getLogger(__name__)

HeadingUnit = Literal["degrees", "radians", "turns"]
_DEGREES = {"degrees": 1.0, "radians": 180.0 / math.pi, "turns": 360.0}


def read_headings(path: str | Path, unit: HeadingUnit = "degrees") -> NDArray[np.float64]:
    """Read a list of headings, one for each line of the label files, in their order.

    Degrees that look like another unit are logged.

    Parameters
    ----------
    path : path
        Text with a number on each line, or a ``.npy`` file of numbers [n] (or [n, 1]).
    unit : {"degrees", "radians", "turns"}
        Of the numbers, clockwise from north.

    Returns
    -------
    headings_deg : float64 [n]
        In [0, 360).

    Raises
    ------
    ConfigError
        If the file is missing or holds anything else.
    """
    if unit not in get_args(HeadingUnit):
        raise ConfigError(
            f"headings unit is {unit!r}; it must be one of {', '.join(get_args(HeadingUnit))}"
        )
    path = Path(path)
    try:
        values = _read_npy(path) if path.suffix.lower() == ".npy" else _read_text(path)
    except FileNotFoundError:
        raise ConfigError(f"{path}: there is no such file of headings; check the name") from None
    except OSError as error:
        raise ConfigError(f"{path}: is unreadable: {error.strerror or error}") from error
    if len(values) == 0:
        raise ConfigError(f"{path}: holds no heading; expected one for each label")
    if not np.isfinite(values).all():
        first = int(np.flatnonzero(~np.isfinite(values))[0])
        raise ConfigError(f"{path}: heading {first} is {values[first]}; expected a finite number")
    largest = float(np.abs(values).max())
    if unit == "degrees" and 0.0 < largest <= 2.0 * math.pi + 1e-3 and len(set(values)) > 2:
        log.warning(
            "%s: no heading is beyond %.4g, as if they were %s; they are read as degrees "
            "(--headings-unit says otherwise)",
            path,
            largest,
            "turns" if largest <= 1.0 else "radians",
        )
    return values * _DEGREES[unit] % 360.0 % 360.0  # a tiny negative one wraps to 360 itself


def _read_npy(path: Path) -> NDArray[np.float64]:
    try:
        with path.open("rb") as file:
            array: NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
    except OSError:
        raise
    except Exception as error:  # a damaged header makes NumPy's parsers raise all sorts
        raise ConfigError(f"{path}: is no plain .npy array of numbers, or is cut short") from error
    if array.dtype.kind not in "iuf" or array.size != len(np.atleast_1d(array)):
        raise ConfigError(
            f"{path}: holds an array {array.dtype} with shape {list(array.shape)}; expected "
            "numbers [n], a heading for each label"
        )
    return array.astype(np.float64).ravel()


def _read_text(path: Path) -> NDArray[np.float64]:
    try:
        lines = path.read_text("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: is neither text in UTF-8 nor a .npy file") from None
    values = []
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            values.append(float(line.replace("_", "?")))  # float also takes 1_0
        except ValueError:
            raise ConfigError(
                f"{path}, line {number}: {line.strip()[:40]!r} is no heading; expected one number"
            ) from None
    return np.array(values, dtype=np.float64)
