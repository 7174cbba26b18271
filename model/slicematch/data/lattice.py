"""Where tiles of a map are centred, so that photographs near each other share them."""

import math

from slicematch.errors import ConfigError

# Tiles around places this near to each other, in shares of a tile's side, are one and the same.
SHARED = 1 / 16
# Length of a degree of latitude; near enough for a lattice of tiles.
_METRES_PER_DEGREE = 111_320.0


def lattice_step(side_m: float, shared_m: float | None = None) -> float:
    """The step of the lattice that tiles are centred on, metres.

    Parameters
    ----------
    side_m : float
        Side of the tiles on the ground.
    shared_m : float, optional
        The step that was asked for; a sixteenth of the side by default.

    Raises
    ------
    ConfigError
        If it is out of its range.
    """
    step_m = side_m * SHARED if shared_m is None else float(shared_m)
    if not 0 <= step_m <= side_m / 2:
        raise ConfigError(
            f"tiles are shared by places within {step_m:g} m; it must be from 0 to half the "
            f"tiles' side, {side_m / 2:g} m"
        )
    return step_m


def lattice_point(lat: float, lon: float, step_m: float) -> tuple[float, float]:
    """The point next to a place on a lattice of so many metres: latitude and longitude, degrees.

    The lattice is the same for all places and maps.

    Examples
    --------
    >>> lattice_point(52.00001, 4.36001, 5.0) == lattice_point(52.0, 4.36, 5.0)
    True
    >>> lattice_point(52.00001, 4.36001, 0.0)
    (52.00001, 4.36001)
    """
    if step_m == 0:
        return lat, lon
    step = step_m / _METRES_PER_DEGREE
    centre_lat = round(lat / step) * step
    step /= max(math.cos(math.radians(centre_lat)), 1e-3)
    return round(centre_lat, 9), round(round(lon / step) * step, 9)
