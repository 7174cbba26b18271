"""VIGOR: street panoramas of four cities and the aerial tiles that they were taken in.

Zhu, Yang, Chen, "VIGOR: Cross-View Image Geo-localization beyond One-to-one Retrieval", CVPR 2021;
labels corrected by Lentsch et al., "SliceMatch", CVPR 2023.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from slicemask.images import read_aerial, resize
from slicematch.data.elevations import crop_elevations
from slicematch.data.errors import DatasetError
from slicematch.data.panoramas import draw_heading_deg, read_panorama, turn_panorama
from slicematch.data.source import DataConfig, Part, Source
from slicematch.data.text import parse_number, read_lines

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
# Widths of ground images are multiples of it, which the encoders' strides divide.
_COLUMNS = 32


@dataclass(frozen=True, kw_only=True)
class VigorConfig(DataConfig):
    """Settings of a VIGOR data set: those of `DataConfig` and the following.

    The defaults are the paper's (SliceMatch, CVPR 2023, section 4.2). A heading prior is centred on
    north. Same-area trains and tests in every city, cross-area trains in NewYork and Seattle and
    tests in SanFrancisco and Chicago.

    Parameters
    ----------
    labels : str
        "corrected" for SliceMatch's labels, "original" for VIGOR's own, which are up to 3 m wrong,
        or a folder of either that holds one folder for each city.
    cities : tuple of str or None
        Only these of the split's cities; None for all.

    Raises
    ------
    DatasetError
        If a value is out of its range.
    """

    projection = "equirectangular"
    ground_aspect = 2.0
    camera_height_m = 2.5
    prior_centre_deg = 0.0
    train_grid = "7x7x16"
    test_grid = "21x21x64"

    ground_size: tuple[int, int] = (320, 640)
    hfov_deg: float | None = 360.0
    labels: str = "corrected"
    cities: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.cities is not None:
            object.__setattr__(self, "cities", tuple(self.cities))
            for city in self.cities:
                if city not in CITIES:
                    raise DatasetError(f"city is {city!r}; it must be one of {', '.join(CITIES)}")

    @classmethod
    def default_ground_size(cls, hfov_deg: float | None = None) -> tuple[int, int]:
        """The paper's, with as many pixels a degree: see `DataConfig.default_ground_size`."""
        height, width = cls.ground_size
        columns = width * (360.0 if hfov_deg is None else hfov_deg) / 360.0
        return height, max(1, round(columns / _COLUMNS)) * _COLUMNS

    def open(self, part: Part) -> "VigorSource":
        """Open the samples of a part; see `DataConfig.open`."""
        return VigorSource(self, part)


class VigorLabels(NamedTuple):
    """The positives of one label file: names of n images and offsets float64 [n, 2] (d0, d1)."""

    panoramas: list[str]
    aerials: list[str]
    offsets: np.ndarray


def read_labels(path: str | Path) -> VigorLabels:
    """Read the positive of each line of a VIGOR label file.

    A line has 13 fields separated by single spaces: a panorama's name and four times an aerial
    tile's name, d0 and d1, in pixels of the 640-pixel tile. The first tile is the positive.

    Raises
    ------
    DatasetError
        If the file is missing or a line is invalid; the text names the file, line and field.
    """
    path = Path(path)
    panoramas, aerials, offsets = [], [], []
    for number, line in read_lines(path, "the label file", _hint(path)):
        fields = line.removesuffix("\r").split(" ")
        if len(fields) != 13:
            raise DatasetError(
                f"{path}, line {number}: is no label, since it has {len(fields)} fields; expected "
                "13, separated by single spaces: a panorama and four times an aerial tile, d0, d1"
            )
        for column, (name, field) in enumerate(zip(_FIELDS, fields, strict=True), start=1):
            if name in ("d0", "d1"):
                fault = parse_number(field) is None and "a number of pixels"
            else:
                bare = field.strip("\"'\t")
                fault = not bare and "a file's name"
                fault = fault or (bare != field and "a bare file name")
            if fault:
                raise DatasetError(
                    f"{path}, line {number}: is no label, since field {column} ({name}) is "
                    f"{field!r}; expected {fault}"
                )
        panoramas.append(fields[0])
        aerials.append(fields[1])
        offsets.append((float(fields[2]), float(fields[3])))
    return VigorLabels(panoramas, aerials, np.array(offsets))


_FIELDS = ("panorama", *("aerial tile", "d0", "d1") * 4)


def _hint(path: Path) -> str:
    """Say how to come by a label file that is missing."""
    available = [city for city in CITIES if (path.parent.parent / city).is_dir()]
    other = (
        f"name only cities that are there (--cities {','.join(available)})"
        if available
        else "check the root and labels"
    )
    if path.parent.parent.name == "splits__corrected":
        return (
            f"put the corrected labels of SliceMatch there, {other}, or ask for the original ones "
            "(--labels original), which are up to 3 m wrong"
        )
    return other


class VigorSource(Source):
    """VIGOR's positive pairs: a panorama and the tile that it was taken in, north up.

    The panorama faces the sample's heading: where the heading is unknown, one is drawn, on whole
    columns of a 2048-column panorama, and the panorama is rolled left by as much. Then it is cut to
    the HFoV around its centre.

    Parameters
    ----------
    config : VigorConfig
        Settings.
    part : {"train", "validation", "test"}
        Training and validation share the training file (`validation_fraction`).

    Attributes
    ----------
    files : list of (Path, Path)
        Each sample's panorama and tile.
    left_out : int
        Labels that were left out because abs(d0) or abs(d1) exceeds 320: the camera is off the
        tile.

    Raises
    ------
    DatasetError
        If a label file is missing or broken.
    """

    def __init__(self, config: VigorConfig, part: Part) -> None:
        self.config = config
        self.hfov_deg = float(config.hfov_deg or 360.0)
        root = Path(config.root)
        pairs, places, metres, numbers = [], [], [], []
        for city in _cities(config, part):
            labels = read_labels(_label_file(config, part, city))
            for panorama, aerial, (d0, d1) in zip(*labels, strict=True):
                self.label_count += 1
                if max(abs(d0), abs(d1)) > TILE_PIXELS / 2:
                    self.left_out += 1
                    continue
                pairs.append((city, panorama, aerial))
                # d0 counts down (south), d1 counts left (west), both from the tile's centre.
                places.append((0.5 - d1 / TILE_PIXELS, 0.5 + d0 / TILE_PIXELS))
                metres.append(METRES_PER_PIXEL[city] * TILE_PIXELS)
                numbers.append(self.label_count - 1)
        chosen = config.choose(part, len(pairs))
        self.files = [
            (root / city / "panorama" / panorama, root / city / "satellite" / aerial)
            for city, panorama, aerial in (pairs[k] for k in chosen)
        ]
        self.names = ["{}/{}".format(*pairs[k]) for k in chosen]
        self._places = np.array(places).reshape(-1, 2)[chosen]
        self.tile_metres = np.array(metres)[chosen]
        self.labels = np.array(numbers, dtype=np.intp)[chosen]

    def pose(self, index: int, random: np.random.Generator) -> NDArray[np.float64]:
        """The true pose of a sample; see `Source.pose`."""
        return np.array([*self._places[index], self._heading_deg(index, random)])

    def images(self, index: int, random: np.random.Generator) -> tuple[Image.Image, Image.Image]:
        """The images of a sample; see `Source.images`."""
        panorama_file, aerial_file = self.files[index]
        panorama = read_panorama(panorama_file, self.config.ground_fit)
        aerial = read_aerial(aerial_file)
        # North is at the centre of VIGOR's panoramas, unless the file itself says otherwise.
        rotation_deg = self._heading_deg(index, random) - (panorama.heading_deg or 0.0)
        cropped = crop_elevations(
            panorama.image, self.config.elevations, self.config.projection, self.hfov_deg
        )
        ground = turn_panorama(cropped, rotation_deg, self.config.ground_size, self.hfov_deg)
        return ground, resize(aerial, (self.config.aerial_size, self.config.aerial_size))

    def _heading_deg(self, index: int, random: np.random.Generator) -> float:
        if self.headings_deg is not None:
            return float(self.headings_deg[index])
        return draw_heading_deg(random, self.config.heading_prior)


def _cities(config: VigorConfig, part: Part) -> list[str]:
    cities: tuple[str, ...] = CITIES
    if config.split == "cross-area":
        cities = CROSS_AREA["test" if part == "test" else "train"]
    chosen = [city for city in cities if city in (config.cities or CITIES)]
    if not chosen:
        raise DatasetError(
            f"cities is {', '.join(config.cities or ())}; the {part} part of the "
            f"{config.split} split has {', '.join(cities)}"
        )
    return chosen


def _label_file(config: VigorConfig, part: Part, city: str) -> Path:
    name = "pano_label_balanced"
    if config.split == "same-area":
        name = f"same_area_balanced_{'test' if part == 'test' else 'train'}"
    folder = _label_folder(config) / city
    corrected = folder / f"{name}__corrected.txt"
    if config.labels == "corrected":
        return corrected
    if config.labels == "original":
        return folder / f"{name}.txt"
    # A folder that was named holds corrected labels if any file in it says so: the corrected and
    # the original ones of different cities must not be mixed unnoticed.
    any_corrected = any(_label_folder(config).glob("*/*__corrected.txt"))
    return corrected if any_corrected else folder / f"{name}.txt"


def _label_folder(config: VigorConfig) -> Path:
    root = Path(config.root)
    known = {"corrected": root / "splits__corrected", "original": root / "splits"}
    if config.labels in known:
        return known[config.labels]
    for folder in (Path(config.labels), root / config.labels):
        if config.labels and folder.is_dir():
            return folder
    raise DatasetError(
        f"labels is {config.labels!r}; it must be corrected, original, or a folder that is there "
        f"or in {root}"
    )
