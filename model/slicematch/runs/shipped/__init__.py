"""Runs that come with the package, packed (`slicematch.runs.packed`), each in a folder here.

In its folder ``examples`` lie pairs of images to try it on, which it has not seen in training.
"""

import json
from dataclasses import dataclass
from pathlib import Path

from slicematch.errors import ConfigError

_FOLDER = Path(__file__).parent


def shipped_runs() -> list[str]:
    """Names of the runs that come with the package."""
    return sorted(path.parent.name for path in _FOLDER.glob("*/config.yaml"))


def find_run(run: str | Path) -> Path:
    """The folder of a run.

    Parameters
    ----------
    run : path or str
        A run folder, or the name of a run that comes with the package. A run folder of that name
        goes before.
    """
    path = Path(run)
    if str(run) in shipped_runs() and not (path / "config.yaml").exists():
        return _FOLDER / str(run)
    return path


@dataclass(frozen=True)
class ShippedPair:
    """A pair of images that comes with a run.

    Attributes
    ----------
    name : str
        What it shows.
    ground, aerial : Path
        The image files.
    metres_per_pixel : float
        Of the tile.
    pose : (u, v, heading_deg)
        Where the camera was.
    """

    name: str
    ground: Path
    aerial: Path
    metres_per_pixel: float
    pose: tuple[float, float, float]


def shipped_pairs(run: str | Path) -> list[ShippedPair]:
    """The pairs that come with a run; none come with runs of one's own."""
    folder = find_run(run) / "examples"
    if not (folder / "examples.json").exists():
        return []
    return [
        ShippedPair(
            pair["name"],
            folder / pair["ground"],
            folder / pair["aerial"],
            pair["metres_per_pixel"],
            tuple(pair["pose"]),
        )
        for pair in json.loads((folder / "examples.json").read_text())
    ]


def shipped_pair(run: str | Path, number: int) -> ShippedPair:
    """One of a run's pairs, counted from 1.

    Raises
    ------
    ConfigError
        If the run comes with no such pair.
    """
    pairs = shipped_pairs(run)
    if not pairs:
        raise ConfigError(
            f"no examples come with {run}; only {', '.join(shipped_runs())} has some: name a "
            "ground image and a tile"
        )
    if not 1 <= number <= len(pairs):
        raise ConfigError(
            f"example is {number}; {run} comes with 1 to {len(pairs)}: "
            + "; ".join(f"{place}, {pair.name}" for place, pair in enumerate(pairs, 1))
        )
    return pairs[number - 1]
