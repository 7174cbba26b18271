"""What counts as a number in an argument."""

import math
from typing import Any

import numpy as np


def is_whole(value: Any) -> bool:
    """Whether a value is a whole number, Python's or NumPy's; True and False are not."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def is_real(value: Any) -> bool:
    """Whether a value is a finite real number, Python's or NumPy's."""
    return (is_whole(value) or isinstance(value, float | np.floating)) and math.isfinite(value)
