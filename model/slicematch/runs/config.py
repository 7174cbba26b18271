"""What a training run is made of: one frozen set of settings, kept as YAML in its run folder."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Literal

import yaml

from slicemask import Frustum, PoseGrid
from slicemask.files import write_text
from slicematch.data import KittiConfig, KittiDataset, PoseDataset, VigorConfig, VigorDataset
from slicematch.data.dataset import BadSamples
from slicematch.data.kitti import SHIFT_RANGE_M, SPAN_M
from slicematch.devices import Precision
from slicematch.errors import ConfigError
from slicematch.runs.settings import convert, read_settings

# The paper's settings where they depend on the data (SliceMatch, CVPR 2023, section 4.2).
_PAPER: dict[str, dict[str, Any]] = {
    "vigor": {
        "ground_size": (320, 640),
        "train_grid": "7x7x16",
        "test_grid": "21x21x64",
    },
    "kitti": {
        "ground_size": (256, 1024),
        "train_grid": "5x5x16",
        "test_grid": "15x15x64",
    },
}


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """Settings of a training run. The defaults are the paper's, or are marked ours.

    Parameters
    ----------
    data : {"vigor", "kitti"}
        The data set's format.
    root : str
        The folder of the data tree.
    split : {"same-area", "cross-area"}
        Where the test part lies; for VIGOR also which cities train.
    labels : {"corrected", "original"}
        VIGOR's labels.
    cities : tuple of str or None
        Only these of VIGOR's cities; None for all of the split.
    splits : str or None
        The folder of KITTI's split files; None for the root.
    heading_prior_deg : float or None
        How far headings lie from the data set's own (VIGOR: north, KITTI: the tile's east), to
        either side: 0 for a known heading ("aligned"), None for any. Candidates outside are left
        out, in training and testing.
    place_prior : (u, v, radius) or None
        Leave out the candidates farther than the radius from (u, v), in the aerial frame.
    extent : (u0, v0, u1, v1) or None
        The part of the tile that the grids fill; None for the whole tile with VIGOR and, with
        KITTI, the square in the middle where all cameras stand (ours).
    train_grid, test_grid : str or None
        Candidate poses, ROWSxCOLUMNSxHEADINGS; None for the paper's: VIGOR 7x7x16 and 21x21x64,
        KITTI 5x5x16 and 15x15x64.
    hfov_deg : float or None
        Horizontal field of view of the ground images; None for the data set's. VIGOR's is 360.
    encoder : str
        timm backbone.
    weights : str
        What both encoders start from: "imagenet", "none", or a file.
    stride : int
        Stride of the feature maps.
    ground_size : (height, width) or None
        Pixels of the ground images; None for the paper's: 320x640 for VIGOR, 256x1024 for KITTI.
    aerial_size : int
        Pixels along each side of the aerial images.
    slices : int
        N.
    cross_view_attention : bool
        Whether the aerial attention sees the ground descriptors.
    alpha : float or None
        Weight of the candidates in the loss; None for K, plain infoNCE.
    tau : float
        Temperature of the loss.
    grid_jitter : bool
        Move and turn the training grid at random in each step, within a cell and a heading step
        (ours: false). A run draws from 16 offsets.
    near_negatives : int
        Further negatives of each pair at random within one step of the training grid around its
        true pose (ours: 0).
    learning_rate : float
        Of Adam; with the one-cycle schedule, its highest.
    schedule : {"constant", "one-cycle"}
        How the learning rate goes: the paper's constant, or up over the first tenth of the steps
        and down to almost nothing over the rest (ours; Smith and Topin, 2018), which gets more
        out of a short training.
    batch_size : int
        Pairs in a step, on each device.
    epochs : int
        Rounds through the training part (ours: 30).
    validation_fraction : float
        Share of the training file that is kept from training and chooses the best checkpoint
        (ours: 0.1); with 0 the training loss does.
    augment : bool
        Turn, mirror and recolour training samples: see `PoseDataset` (ours).
    heat_map_every : int
        Epochs from one example heat map to the next; 0 draws none (ours: 1).
    bad_samples : int
        How many different samples may be unreadable before the run stops (ours: 10).
    seed : int
        Of weights, order, headings and shifts; below 2**32.
    workers : int
        Processes that load images.
    precision : {"32-true", "16-mixed", "bf16-mixed"}
        Arithmetic of the encoders; scores are always computed in 32 bits.
    accelerator : str
        As Lightning names them: "cpu", "cuda", ...; "auto" is CUDA where it is there, else the CPU.
    devices : int
        How many of them; of the CPU at most as many as it has processors.

    Raises
    ------
    ConfigError
        If a value is out of its range; the message names the setting.

    Examples
    --------
    >>> config = TrainConfig(data="kitti", root="data/kitti", heading_prior_deg=10)
    >>> config.test_grid, config.ground_size
    ('15x15x64', (256, 1024))
    """

    data: Literal["vigor", "kitti"]
    root: str
    split: Literal["same-area", "cross-area"] = "same-area"
    labels: Literal["corrected", "original"] = "corrected"
    cities: tuple[str, ...] | None = None
    splits: str | None = None
    heading_prior_deg: float | None = None
    place_prior: tuple[float, float, float] | None = None
    extent: tuple[float, float, float, float] | None = None
    train_grid: str | None = None
    test_grid: str | None = None
    hfov_deg: float | None = None
    encoder: str = "vgg16"
    weights: str = "imagenet"
    stride: int = 16
    ground_size: tuple[int, int] | None = None
    aerial_size: int = 512
    slices: int = 16
    cross_view_attention: bool = True
    alpha: float | None = 4.0
    tau: float = 0.1
    grid_jitter: bool = False
    near_negatives: int = 0
    learning_rate: float = 1e-5
    schedule: Literal["constant", "one-cycle"] = "constant"
    batch_size: int = 4
    epochs: int = 30
    validation_fraction: float = 0.1
    augment: bool = False
    heat_map_every: int = 1
    bad_samples: int = 10
    seed: int = 0
    workers: int = 4
    precision: Precision = "32-true"
    accelerator: str = "auto"
    devices: int = 1

    def __post_init__(self) -> None:
        for field in fields(self):
            value = convert(field.name, getattr(self, field.name), field.type)
            object.__setattr__(self, field.name, value)
        for name, value in _PAPER[self.data].items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, value)
        if self.extent is None:
            object.__setattr__(self, "extent", self._default_extent())
        for name in ("stride", "aerial_size", "slices", "batch_size", "epochs", "devices"):
            self._check(name, getattr(self, name) >= 1, "at least 1")
        for name in ("near_negatives", "heat_map_every", "bad_samples"):
            self._check(name, getattr(self, name) >= 0, "at least 0")
        check_workers(self.workers)
        self._check("seed", 0 <= self.seed < 2**32, f"from 0 to {2**32 - 1}")
        for name in ("tau", "learning_rate"):
            self._check(name, getattr(self, name) > 0, "greater than 0")
        self._check("alpha", self.alpha is None or self.alpha > 0, "greater than 0, or None for K")
        self._check("validation_fraction", 0 <= self.validation_fraction < 1, "in [0, 1)")
        self._check("ground_size", min(self.ground_size) >= 1, "two sides of at least 1")
        for name in ("train_grid", "test_grid"):
            self.grid(name)
        if self.data != "vigor":
            self._check("cities", self.cities is None, "None: only VIGOR has cities")
        if self.data == "vigor":
            panorama = self.hfov_deg is None or self.hfov_deg == 360
            self._check("hfov_deg", panorama, "360: VIGOR's ground images are panoramas")
        if self.data != "kitti":
            self._check("splits", self.splits is None, "None: only KITTI's splits lie apart")
        self.data_config()

    def _default_extent(self) -> tuple[float, float, float, float]:
        """Where the data set's cameras may stand.

        KITTI's stand within 20 m of the centre of a 100.26 m tile, along and across the heading,
        and are then turned with it. The paper does not say what its grid fills, but 49 % of its
        lateral errors are below 1 m, and 15 columns over the whole tile would allow at most 30 %.
        """
        if self.data == "vigor":
            return 0.0, 0.0, 1.0, 1.0
        most_deg = 180.0 if self.heading_prior_deg is None else self.heading_prior_deg
        turn = math.radians(min(45.0, most_deg))
        reach_m = SHIFT_RANGE_M * (math.cos(turn) + math.sin(turn))
        half = math.ceil(100 * reach_m / SPAN_M) / 100  # a hundredth, for the sake of names
        low, high = round(0.5 - half, 2), round(0.5 + half, 2)
        return low, low, high, high

    def _check(self, name: str, holds: bool, expected: str) -> None:
        if not holds:
            raise ConfigError(f"{name} is {getattr(self, name)!r}; it must be {expected}")

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> "TrainConfig":
        """Make settings from a mapping and refuse keys that are none.

        Raises
        ------
        ConfigError
            If a key is unknown or missing, or a value out of its range.
        """
        known = [field.name for field in fields(cls)]
        unknown = sorted(str(key) for key in set(settings) - set(known))
        if unknown:
            raise ConfigError(
                f"setting {unknown[0]!r} is unknown; it must be one of {', '.join(known)}"
            )
        missing = [name for name in ("data", "root") if settings.get(name) is None]
        if missing:
            raise ConfigError(f"setting {missing[0]!r} is missing; every run needs data and root")
        return cls(**settings)

    @classmethod
    def load(cls, path: str | Path) -> "TrainConfig":
        """Read settings from a YAML file.

        Raises
        ------
        ConfigError
            If it cannot be read, or its settings cannot be; the message names the file.
        """
        try:
            return cls.from_dict(read_settings(path))
        except ConfigError as error:
            raise ConfigError(str(error) if str(path) in str(error) else f"{path}: {error}") from (
                error
            )

    def save(self, path: str | Path) -> None:
        """Write the settings as YAML, in the order of their documentation, whole or not at all."""
        plain = {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in asdict(self).items()
        }
        text = yaml.safe_dump(plain, sort_keys=False, default_flow_style=None)
        write_text(Path(path), text, ConfigError)

    def grid(self, name: str, grid: str | None = None) -> PoseGrid:
        """The candidate grid ``train_grid`` or ``test_grid`` (or another one) in the extent."""
        return PoseGrid.parse(grid or getattr(self, name), self.extent)

    def frustum(self) -> Frustum:
        """Field of view and slices; `hfov_deg` must be known, as it is in a run folder."""
        self._check("hfov_deg", self.hfov_deg is not None, "known: train fills it in")
        dataset = VigorDataset if self.data == "vigor" else KittiDataset
        return Frustum(self.hfov_deg, self.slices, dataset.projection)

    def heading_prior(self) -> tuple[float, float] | None:
        """The heading prior as (centre, half width) in degrees, or None for any heading."""
        if self.heading_prior_deg is None:
            return None
        dataset = VigorDataset if self.data == "vigor" else KittiDataset
        return dataset.prior_centre_deg, self.heading_prior_deg

    def data_config(
        self, root: str | None = None, split: str | None = None
    ) -> VigorConfig | KittiConfig:
        """Settings of the data set, on request with another root or split.

        Raises
        ------
        ConfigError
            If the data set refuses them.
        """
        split = split or self.split
        shared = {
            "root": root or self.root,
            "heading_prior_deg": self.heading_prior_deg,
            "ground_size": self.ground_size,
            "aerial_size": self.aerial_size,
            "validation_fraction": self.validation_fraction,
            "augment": self.augment,
            "extent": self.extent,
            "place_prior": self.place_prior,
            "seed": self.seed,
        }
        try:
            if self.data == "vigor":
                return VigorConfig(**shared, split=split, labels=self.labels, cities=self.cities)
            test = {"same-area": "test1", "cross-area": "test2"}.get(split, split)
            return KittiConfig(**shared, test=test, splits=self.splits)
        except ValueError as error:
            raise ConfigError(str(error)) from error

    def dataset(
        self,
        part: str,
        root: str | None = None,
        split: str | None = None,
        bad_samples: BadSamples | None = None,
    ) -> PoseDataset:
        """The data set's training, validation or test part."""
        dataset = VigorDataset if self.data == "vigor" else KittiDataset
        return dataset(self.data_config(root, split), part, bad_samples)


def check_workers(workers: int) -> int:
    """The number of processes that load images, or ConfigError if it cannot be one."""
    if workers < 0:
        raise ConfigError(f"workers is {workers}; it must be at least 0")
    return workers
