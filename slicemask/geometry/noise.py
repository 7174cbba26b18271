"""What of a cell's share is rounding, and how it is removed."""

import numpy as np
from numpy.typing import NDArray

# A share this close to 0 or 1 is one: it is of the order of rounding noise.
NEGLIGIBLE = 1e-10


def remove_noise(fractions: NDArray[np.float64]) -> None:
    """Make fractions that are 0 or 1 but for rounding so, in place."""
    chosen = np.less(fractions, NEGLIGIBLE)
    np.copyto(fractions, 0.0, where=chosen)
    np.greater(fractions, 1.0 - NEGLIGIBLE, out=chosen)
    np.copyto(fractions, 1.0, where=chosen)
