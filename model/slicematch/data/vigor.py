"""VIGOR: street panoramas of four cities and the aerial tiles that they were taken in.

Zhu, Yang, Chen, "VIGOR: Cross-View Image Geo-localization beyond One-to-one Retrieval", CVPR 2021;
labels corrected by Lentsch et al., "SliceMatch", CVPR 2023.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple, get_args

import numpy as np
import torch

from slicematch.data.dataset import BadSamples, DataConfig, PoseDataset, read_lines
from slicematch.data.errors import DatasetError
from slicematch.data.images import check_shape, normalise, read_image, resize, turn_panorama

Split = Literal["same-area", "cross-area"]
Labels = Literal["corrected", "original"]

CITIES = ("NewYork", "Seattle", "SanFrancisco", "Chicago")
CROSS_AREA = {"train": ("NewYork", "Seattle"), "test": ("SanFrancisco", "Chicago")}
# Of the 640-pixel tiles. It belongs to the tiles, so it holds with the original labels too.
METRES_PER_PIXEL = {
    "NewYork": 0.113248,
    "Seattle": 0.100817,
    "SanFrancisco": 0.118141,
    "Chicago": 0.111262,
}
TILE_PIXELS = 640
PANORAMA_COLUMNS = 2048


@dataclass(frozen=True, kw_only=True)
class VigorConfig(DataConfig):
    """Settings of a VIGOR data set: those of `DataConfig` and the following.

    Parameters
    ----------
    ground_size, aerial_size
        320x640 and 512 by default, as in the paper.
    heading_prior_deg
        Is centred on north.
    split : {"same-area", "cross-area"}
        Train and test in every city, or train on NewYork and Seattle and test on SanFrancisco and
        Chicago.
    labels : {"corrected", "original"}
        The corrected labels, or the originals, which are up to 3 m wrong.
    cities : tuple of str or None
        Only these of the split's cities; all by default.

    Raises
    ------
    DatasetError
        If a value is out of its range.
    """

    ground_size: tuple[int, int] = (320, 640)
    split: Split = "same-area"
    labels: Labels = "corrected"
    cities: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, choices in (("split", get_args(Split)), ("labels", get_args(Labels))):
            if getattr(self, name) not in choices:
                raise DatasetError(
                    f"{name} is {getattr(self, name)!r}; it must be one of {', '.join(choices)}"
                )
        if self.cities is not None:
            object.__setattr__(self, "cities", tuple(self.cities))
            for city in self.cities:
                if city not in CITIES:
                    raise DatasetError(f"city is {city!r}; it must be one of {', '.join(CITIES)}")


class VigorLabels(NamedTuple):
    """The positives of one label file: names of n images and offsets float64 [n, 2] (d0, d1)."""

    panoramas: list[str]
    aerials: list[str]
    offsets: np.ndarray


def read_labels(path: str | Path) -> VigorLabels:
    """Read the positive of each line of a VIGOR label file.

    A line has 13 fields parted by single spaces: a panorama's name and four times an aerial
    tile's name, d0 and d1, in pixels of the 640-pixel tile. The first tile is the positive.

    Raises
    ------
    DatasetError
        If the file is missing or a line is no such line; the text names file and line.
    """
    path = Path(path)
    panoramas, aerials, offsets = [], [], []
    for number, line in enumerate(read_lines(path, "the label file", _hint(path)), start=1):
        fields = line.split(" ")
        try:
            panorama, aerial, *offset = fields[:4]
            d0, d1 = map(float, offset)
            whole = len(fields) == 13 and np.isfinite([d0, d1]).all()
        except ValueError:
            whole = False
        if not whole:
            raise DatasetError(
                f"{path}, line {number}: {line[:80]!r} is no label; expected 13 fields parted by "
                "single spaces, a panorama and four times an aerial tile, d0 and d1"
            )
        panoramas.append(panorama)
        aerials.append(aerial)
        offsets.append((d0, d1))
    return VigorLabels(panoramas, aerials, np.array(offsets))


def _hint(path: Path) -> str:
    """Say how to come by a label file that is missing."""
    there = [city for city in METRES_PER_PIXEL if (path.parent.parent / city).is_dir()]
    other = (
        f"name only cities that are there (--cities {','.join(there)})"
        if there
        else "check the root"
    )
    if path.parent.parent.name == "splits__corrected":
        return (
            f"put the corrected labels of SliceMatch there, {other}, or ask for the original ones "
            "(--labels original), which are up to 3 m wrong"
        )
    return other


class VigorDataset(PoseDataset):
    """VIGOR's positive pairs: a panorama and the tile that it was taken in, north up.

    The panorama faces the sample's heading: where the heading is not known, one is drawn, on whole
    columns of a 2048-column panorama, and the panorama is rolled left by as much.

    Parameters
    ----------
    config : VigorConfig
    part : {"train", "validation", "test"}
        Training and validation share the training file (`validation_fraction`).
    bad_samples : BadSamples, optional
        Where samples that cannot be read are written down; without it they raise.

    Attributes
    ----------
    left_out : int
        Labels that were left out because |d0| or |d1| exceeds 320: the camera is off the tile.

    Raises
    ------
    DatasetError
        If a label file is missing or broken, or no sample remains.
    """

    projection = "equirectangular"
    hfov_deg = 360.0
    prior_centre_deg = 0.0

    def __init__(
        self,
        config: VigorConfig,
        part: str = "train",
        bad_samples: BadSamples | None = None,
    ):
        super().__init__(config, part, bad_samples)
        root = Path(config.root)
        self.left_out = 0
        pairs, places, metres = [], [], []
        for city in self._cities():
            labels = read_labels(self._label_file(city))
            for panorama, aerial, (d0, d1) in zip(*labels, strict=True):
                if max(abs(d0), abs(d1)) > TILE_PIXELS / 2:
                    self.left_out += 1
                    continue
                pairs.append((city, panorama, aerial))
                # d0 counts down (south), d1 counts left (west), both from the tile's centre.
                places.append((0.5 - d1 / TILE_PIXELS, 0.5 + d0 / TILE_PIXELS))
                metres.append(METRES_PER_PIXEL[city] * TILE_PIXELS)
        chosen = np.arange(len(pairs)) if part == "test" else self._choose_part(len(pairs))
        self._files = [
            (root / city / "panorama" / panorama, root / city / "satellite" / aerial)
            for city, panorama, aerial in (pairs[k] for k in chosen)
        ]
        self.names = ["{}/{}".format(*pairs[k]) for k in chosen]
        self._places = np.array(places).reshape(-1, 2)[chosen]
        self.tile_metres = np.array(metres)[chosen]
        self._check_not_empty()

    def _pose(self, index: int) -> np.ndarray:
        return np.array([*self._places[index], self._heading_deg(index)])

    def _load(self, index: int) -> tuple[torch.Tensor, torch.Tensor]:
        panorama_file, aerial_file = self._files[index]
        panorama = read_image(panorama_file)
        check_shape(panorama, panorama_file, 2.0, "a panorama")
        aerial = read_image(aerial_file)
        check_shape(aerial, aerial_file, 1.0, "an aerial tile")
        ground = turn_panorama(panorama, self._heading_deg(index), self.config.ground_size)
        return normalise(ground), normalise(resize(aerial, (self.aerial_size, self.aerial_size)))

    def _heading_deg(self, index: int) -> float:
        if self.heading_prior_deg is None:
            column = self._random(index).integers(PANORAMA_COLUMNS)
        else:
            reach = int(self.heading_prior_deg[1] * PANORAMA_COLUMNS / 360)
            column = self._random(index).integers(-reach, reach + 1) % PANORAMA_COLUMNS
        return column * 360.0 / PANORAMA_COLUMNS

    def _cities(self) -> list[str]:
        cities = CITIES
        if self.config.split == "cross-area":
            cities = CROSS_AREA["test" if self.part == "test" else "train"]
        chosen = [city for city in cities if city in (self.config.cities or CITIES)]
        if not chosen:
            raise DatasetError(
                f"cities is {', '.join(self.config.cities)}; the {self.part} part of the "
                f"{self.config.split} split has {', '.join(cities)}"
            )
        return chosen

    def _label_file(self, city: str) -> Path:
        name = "pano_label_balanced"
        if self.config.split == "same-area":
            name = f"same_area_balanced_{'test' if self.part == 'test' else 'train'}"
        suffix = "__corrected" if self.config.labels == "corrected" else ""
        return Path(self.config.root) / f"splits{suffix}" / city / f"{name}{suffix}.txt"
