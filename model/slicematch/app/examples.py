"""Pairs of images to click: some of the test part of a run's data, or those that come with it."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from PIL import Image

from slicemask.images import read_aerial, read_image
from slicematch.evaluation.samples import evenly_spaced_indices
from slicematch.runs.config import TrainConfig
from slicematch.runs.shipped import shipped_pairs

MOST_EXAMPLES = 6
# Pixels of the images that are shown; the run takes them in its own sizes.
_GROUND_ROWS, _AERIAL_SIDE = 400, 640


@dataclass(frozen=True)
class Example:
    """A pair of images with the true pose.

    Attributes
    ----------
    name : str
        Of the sample.
    ground, tile : PIL.Image.Image
        The images.
    pose : (u, v, heading_deg)
        Where the camera was.
    metres_per_pixel : float
        Of the tile.
    """

    name: str
    ground: Image.Image
    tile: Image.Image
    pose: tuple[float, float, float]
    metres_per_pixel: float


class Examples(Protocol):
    """Pairs, counted from 0."""

    def __len__(self) -> int: ...

    def load(self, number: int) -> Example:
        """Read one example."""


class ShippedExamples:
    """The pairs that come with a run, if any do.

    Parameters
    ----------
    run : path
        A run folder, or the name of a run that ships.
    """

    def __init__(self, run: str | Path) -> None:
        self._pairs = shipped_pairs(run)

    def __len__(self) -> int:
        return len(self._pairs)

    def load(self, number: int) -> Example:
        """Read one example."""
        pair = self._pairs[number]
        return Example(
            pair.name,
            read_image(pair.ground),
            read_aerial(pair.aerial),
            pair.pose,
            pair.metres_per_pixel,
        )


class DataExamples:
    """Evenly spaced samples of the test part of a run's data.

    Parameters
    ----------
    config : TrainConfig
        Of the run.
    root : path, optional
        The folder of the data tree; the run's by default.

    Raises
    ------
    ConfigError, DatasetError
        If the data are not there, or not as the run's settings say.
    """

    def __init__(self, config: TrainConfig, root: str | None = None) -> None:
        settings = config.with_data(root=root).data_config()
        columns = round(_GROUND_ROWS * settings.ground_aspect)
        self._seed = settings.seed
        self._source = replace(
            settings,
            ground_size=(_GROUND_ROWS, columns),
            aerial_size=_AERIAL_SIDE,
            elevations=None,
        ).open("test")
        self._indices = evenly_spaced_indices(len(self._source.names), MOST_EXAMPLES)

    def __len__(self) -> int:
        return len(self._indices)

    def load(self, number: int) -> Example:
        """Read one example.

        Raises
        ------
        SampleError, ImageError
            If a file of it is unusable.
        """
        index = self._indices[number]
        u, v, heading_deg = self._source.pose(index, self._random(index)).tolist()
        ground, tile = self._source.images(index, self._random(index))
        return Example(
            self._source.names[index],
            ground,
            tile,
            (u, v, heading_deg),
            float(self._source.tile_metres[index]) / _AERIAL_SIDE,
        )

    def _random(self, index: int) -> np.random.Generator:
        """Pose and images of a sample are drawn from equal generators."""
        return np.random.default_rng([self._seed, index])
