"""What a training run is made of: one frozen set of settings, kept as YAML in its run folder."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from slicemask import Frustum, PoseGrid
from slicemask.files import write_text
from slicemask.geometry.frustum import Projection
from slicematch.data import DATA_SETS, OWN, config_class
from slicematch.data.source import DataConfig, Split
from slicematch.errors import ConfigError
from slicematch.normalisation import IMAGENET_MEAN, IMAGENET_STD, Triple
from slicematch.precision import Precision
from slicematch.runs.recipes import find_recipe
from slicematch.runs.settings import convert, read_settings

if TYPE_CHECKING:
    from slicematch.data.dataset import BadSampleLog, PoseDataset

# Taken from the data set where they are not given, and then kept: a run folder needs no loader.
_FROM_DATA = (
    "ground_size",
    "extent",
    "train_grid",
    "test_grid",
    "projection",
    "prior_centre_deg",
    "ground_aspect",
)
# Names of version 0.1, whose run folders and files of settings are read for ever.
_OLD_NAMES = {
    "heading_prior_deg": "heading_half_width_deg",
    "bad_samples": "max_bad_samples",
    "splits": "split_dir",
}
# Ranges below this are shares of the tile's side: no tile has a camera that far from its edge.
_LARGEST_SHARE = 1.5
# No option of a command: either kept for the run folder alone, or found by other means.
_KEPT = {"option": None}


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """Settings of a training run. The defaults are the paper's, or are marked ours.

    Parameters
    ----------
    data : str
        The data set, by its name in `slicematch.data`; "own" for samples that a program hands to
        `train` itself.
    root : str
        The folder of the data tree, or a table of photographs.
    split : {"same-area", "cross-area"}
        Where the test part lies; for VIGOR also which cities train.
    data_settings : mapping
        The data set's own settings by name, such as ``{"cities": ["Chicago"]}``: those of
        `config_class(data)`. `from_dict` and YAML files also take them beside the others.
    heading_half_width_deg : float or None
        How far headings lie from the data set's own (VIGOR: north, KITTI: the tile's east), in
        degrees to either side: 0 for a known heading ("aligned"), None for any. Candidates outside
        are left out, in training and testing.
    place_prior : (u, v, radius) or None
        Leave out the candidates farther than the radius from (u, v), in the aerial frame; None for
        no prior.
    extent : (u0, v0, u1, v1) or None
        The part of the tile that the grids fill; None for the data set's: the whole tile, or, with
        KITTI, the square in the middle where all cameras stand (ours).
    train_grid : str or None
        Candidate poses in training, ROWSxCOLUMNSxHEADINGS; None for the paper's.
    test_grid : str or None
        Candidate poses in testing, ROWSxCOLUMNSxHEADINGS; None for the paper's.
    hfov_deg : float or None
        Horizontal field of view of the ground images, in degrees: what panoramas are cut to around
        their headings, or a camera's, with its optical axis in the centre; None for the data set's.
    encoder : str
        timm backbone.
    weights : str
        What both encoders start from: "imagenet", "none", or a file.
    init : str or None
        A run folder, or the name of a run that comes with slicemask, whose weights training starts
        from (ours): fine-tuning. The command also takes over its network's settings.
    freeze_encoders : bool
        Leave the encoders' backbones as they are (ours), for few samples.
    freeze_statistics : bool
        Leave the statistics of the backbones' batch normalisation as they are, and use them in
        training too (ours), for small batches and for images unlike those to come. Random weights
        have none that are worth keeping.
    encoder_rate : float
        Learning rate of the encoders' backbones, in shares of the learning rate (ours: 1); below 1
        they keep more of what they started from.
    stride : int
        Stride of the feature maps, in pixels.
    pyramid : int or None
        Channels of a feature pyramid over the encoder's stages of this stride and deeper (ours);
        None for the features of that stage alone.
    pyramid_to : int
        Stride of the deepest stage that the pyramid takes.
    ground_size : (height, width) or None
        Pixels of the ground images; None for the paper's, of a panorama that is cut with as many
        pixels a degree.
    aerial_size : int
        Pixels along each side of the aerial images.
    image_mean, image_std : (red, green, blue) or None
        Taken out of the images, whose values are in [0, 1]; None until training fills in those
        that the encoder's weights were trained with. Runs that hold none took ImageNet's.
    weights_source : str or None
        Where the encoders' weights came from, filled in by training: timm's name with its tag, such
        as "resnet50.a1_in1k", or the file's name with the start of its SHA-256; None for random
        ones, and in runs of before.
    tile_side_m : float or None
        Median side of the training part's tiles on the ground, in metres, filled in by training;
        None in runs of before.
    slices : int
        N, the slices of a ground image.
    bands : (range, ...)
        Ranges that cut slices into bands, increasing (ours): in metres, or, if all are below 1.5,
        in shares of the tile's side; none for the paper's whole slices.
    band_rows : {"geometry", "learned"}
        Whether a band's ground descriptor looks only at the rows in which flat ground at its range
        is seen, or at rows that are learned, starting from those.
    band_values : bool
        Whether each band's ground descriptors go through a linear map of their own.
    band_weights : bool
        Whether each of a band's ground descriptors has a learned weight in the score.
    camera_height_m : float or None
        Of the cameras above the ground, which tells the rows of a range; None for the data set's.
    elevations : (lowest, highest) or None
        The part of the ground images that is used, in degrees above the horizon (ours); None for
        all of them. The horizon is at half their height, or at a camera's principal point.
    ground_fit : {"crop", "resize"}
        What to do with ground images of other proportions than the data set's: cut or add rows
        about the horizon until they show as much, or resize them.
    cross_view_attention : bool
        Whether the aerial attention sees the ground descriptors.
    alpha : float or None
        Weight of the candidates in the loss; K for as many as there are, plain infoNCE.
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
        Rotate, mirror and recolour training samples (ours).
    restyle : float
        Share of augmented images that are shown in another style: with other contrast, texture and
        sharpness, and parts hidden (ours: 0). For generated places that are to teach photographs.
    heat_map_every : int
        Epochs from one example heat map to the next; 0 draws none (ours: 1).
    max_bad_samples : int
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
        How many of them, on each node; of the CPU at most as many as it has processors.
    num_nodes : int
        Machines that train together. Each runs the same command, under torchrun, SLURM's srun, or
        with Lightning's environment variables.
    projection : {"equirectangular", "pinhole"} or None
        Of the ground images; None for the data set's.
    prior_centre_deg : float or None
        The heading that a heading prior is centred on; None for the data set's.
    ground_aspect : float or None
        Width over height of the ground images as they are; None for the data set's.
    left_deg : float or None
        Azimuth of the ground images' left edge from the camera's optical axis, which is the
        heading; None for an axis in the centre. Filled in by training with `hfov_deg`.
    horizon : float
        Where the horizon of a camera's images is, from their top, as a fraction of their height.
        Filled in by training with `hfov_deg`.

    Raises
    ------
    ConfigError
        If a value is out of its range; the message names the setting.

    Examples
    --------
    >>> config = TrainConfig(data="kitti", root="data/kitti", heading_half_width_deg=10)
    >>> config.test_grid, config.ground_size
    ('15x15x64', (256, 1024))
    """

    data: str
    root: str = ""
    split: Split = "same-area"
    data_settings: Mapping[str, Any] = field(default_factory=dict, metadata=_KEPT)
    heading_half_width_deg: float | None = field(
        default=None, metadata={"option": "heading-prior", "none": "any"}
    )
    place_prior: tuple[float, float, float] | None = None
    extent: tuple[float, float, float, float] | None = None
    train_grid: str | None = None
    test_grid: str | None = None
    hfov_deg: float | None = field(default=None, metadata={"option": "hfov"})
    encoder: str = "vgg16"
    weights: str = "imagenet"
    init: str | None = None
    freeze_encoders: bool = False
    freeze_statistics: bool = False
    encoder_rate: float = 1.0
    stride: int = 16
    pyramid: int | None = None
    pyramid_to: int = 32
    ground_size: tuple[int, int] | None = None
    aerial_size: int = 512
    image_mean: Triple | None = field(default=None, metadata=_KEPT)
    image_std: Triple | None = field(default=None, metadata=_KEPT)
    weights_source: str | None = field(default=None, metadata=_KEPT)
    tile_side_m: float | None = field(default=None, metadata=_KEPT)
    slices: int = 16
    bands: tuple[float, ...] = ()
    band_rows: Literal["geometry", "learned"] = "geometry"
    band_values: bool = True
    band_weights: bool = True
    camera_height_m: float | None = None
    elevations: tuple[float, float] | None = None
    ground_fit: Literal["crop", "resize"] = "crop"
    cross_view_attention: bool = True
    alpha: float | None = field(default=4.0, metadata={"none": "K"})
    tau: float = 0.1
    grid_jitter: bool = False
    near_negatives: int = 0
    learning_rate: float = 1e-5
    schedule: Literal["constant", "one-cycle"] = "constant"
    batch_size: int = 4
    epochs: int = 30
    validation_fraction: float = 0.1
    augment: bool = False
    restyle: float = 0.0
    heat_map_every: int = 1
    max_bad_samples: int = 10
    seed: int = 0
    workers: int = 4
    precision: Precision = "32-true"
    accelerator: str = "auto"
    devices: int = 1
    num_nodes: int = 1
    projection: Projection | None = field(default=None, metadata=_KEPT)
    prior_centre_deg: float | None = field(default=None, metadata=_KEPT)
    ground_aspect: float | None = field(default=None, metadata=_KEPT)
    left_deg: float | None = field(default=None, metadata=_KEPT)
    horizon: float = field(default=0.5, metadata=_KEPT)

    required: ClassVar[tuple[str, ...]] = ("data", "root")

    def __post_init__(self) -> None:
        for setting in fields(self):
            value = convert(setting.name, getattr(self, setting.name), setting.type)
            object.__setattr__(self, setting.name, value)
        self._check("data", self.data in (*DATA_SETS, OWN), f"one of {', '.join(DATA_SETS)}")
        self._check("root", self.root != "" or self.data == OWN, "a folder or a table")
        for name in (
            "stride",
            "aerial_size",
            "slices",
            "batch_size",
            "epochs",
            "devices",
            "num_nodes",
        ):
            self._check(name, getattr(self, name) >= 1, "at least 1")
        for name in ("near_negatives", "heat_map_every", "max_bad_samples"):
            self._check(name, getattr(self, name) >= 0, "at least 0")
        self._check("pyramid", self.pyramid is None or self.pyramid >= 1, "None or at least 1")
        self._check(
            "pyramid_to",
            self.pyramid is None or self.pyramid_to >= self.stride,
            f"at least the stride, {self.stride}",
        )
        check_workers(self.workers)
        self._check("seed", 0 <= self.seed < 2**32, f"from 0 to {2**32 - 1}")
        for name in ("tau", "learning_rate", "encoder_rate"):
            self._check(name, getattr(self, name) > 0, "greater than 0")
        self._check(
            "restyle",
            0 <= self.restyle <= 1 and (self.augment or not self.restyle),
            "a share from 0 to 1, and 0 without augment",
        )
        self._check(
            "encoder_rate",
            self.encoder_rate == 1.0 or not self.freeze_encoders,
            "1 with freeze_encoders",
        )
        self._check("alpha", self.alpha is None or self.alpha > 0, "greater than 0, or None for K")
        self._check("validation_fraction", 0 <= self.validation_fraction < 1, "in [0, 1)")
        half_width = self.heading_half_width_deg
        self._check(
            "heading_half_width_deg",
            half_width is None or 0 <= half_width <= 180,
            "None or a number from 0 to 180",
        )
        size = self.ground_size
        self._check("ground_size", size is None or min(size) >= 1, "two sides of at least 1")
        std, side = self.image_std, self.tile_side_m
        self._check("image_std", std is None or min(std) > 0, "three numbers greater than 0")
        self._check("tile_side_m", side is None or side > 0, "greater than 0")
        ranges = (0.0, *self.bands)
        self._check(
            "bands",
            all(near < far for near, far in pairwise(ranges)),
            "increasing ranges above 0, such as 6,12,24",
        )
        height, part = self.camera_height_m, self.elevations
        self._check("camera_height_m", height is None or height > 0, "greater than 0")
        self._check(
            "elevations",
            part is None or -90 <= part[0] < part[1] <= 90,
            "(lowest, highest) from -90 to 90 degrees",
        )
        if any(getattr(self, name) is None for name in self._from_data()):
            self._complete()
        for name in ("train_grid", "test_grid"):
            self.grid(name)

    def _complete(self) -> None:
        """Take from the data set what is not given, and let it check its own settings."""
        data = self.data_config()
        for name in self._from_data():
            if getattr(self, name) is None:
                object.__setattr__(self, name, getattr(data, name))
        own = {name: plain(getattr(data, name)) for name in data.own_settings()}
        object.__setattr__(self, "data_settings", own)

    def _from_data(self) -> tuple[str, ...]:
        """The settings that are the data set's where they are not given."""
        return (*_FROM_DATA, "camera_height_m") if self.bands else _FROM_DATA

    def _check(self, name: str, holds: bool, expected: str) -> None:
        if not holds:
            raise ConfigError(f"{name} is {getattr(self, name)!r}; it must be {expected}")

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> "TrainConfig":
        """Make settings from a mapping and refuse unknown keys.

        Parameters
        ----------
        settings : mapping
            Settings by name; the data set's own ones may stand among them. Names of older versions
            are taken too, and the new ones go before them. With ``recipe``, what is not among
            them is the recipe's: "paper", the defaults, or "fast" (`slicematch.runs.recipes`).

        Raises
        ------
        ConfigError
            If a key is unknown or missing, or a value out of its range.
        """
        given = {name: value for name, value in settings.items() if name != "recipe"}
        recipe = find_recipe(settings.get("recipe", "paper"))
        config = cls._from_settings({**recipe.of(None), **given})
        # What the projection is, the data set knows.
        further = recipe.of(config.projection)
        return cls._from_settings({**further, **given}) if further else config

    @classmethod
    def _from_settings(cls, settings: Mapping[str, Any]) -> "TrainConfig":
        """`from_dict` once recipes are resolved."""
        data = config_class(str(settings["data"])) if _needs_data(settings) else None
        settings = _renamed(settings, data)
        known = [setting.name for setting in fields(cls)]
        own = data.own_settings() if data is not None else []
        unknown = sorted(str(key) for key in set(settings) - {*known, *own})
        if unknown:
            raise ConfigError(
                f"setting {unknown[0]!r} is unknown; it must be one of "
                f"{', '.join([*known, 'recipe', *own])}"
            )
        missing = [name for name in cls.required if settings.get(name) is None]
        if missing:
            raise ConfigError(f"setting {missing[0]!r} is missing; every run needs data and root")
        shared = {name: value for name, value in settings.items() if name in known}
        beside = {name: settings[name] for name in own if name in settings}
        if beside:
            shared["data_settings"] = {**(settings.get("data_settings") or {}), **beside}
        return cls(**shared)

    @classmethod
    def load(cls, path: str | Path, settings: Mapping[str, Any] | None = None) -> "TrainConfig":
        """Read settings from a YAML file.

        Parameters
        ----------
        path : path
            The file.
        settings : mapping, optional
            What it holds, where it has been read before.

        Raises
        ------
        ConfigError
            If it is unreadable, or a setting is invalid; the message names the file.
        """
        try:
            return cls.from_dict(read_settings(path) if settings is None else settings)
        except ConfigError as error:
            raise ConfigError(str(error) if str(path) in str(error) else f"{path}: {error}") from (
                error
            )

    def flat(self) -> dict[str, Any]:
        """All settings by name, the data set's own ones among them."""
        settings = asdict(self)
        own: dict[str, Any] = settings.pop("data_settings")
        return settings | own

    def save(self, path: str | Path) -> None:
        """Write the settings as YAML, in the order of their documentation, whole or not at all."""
        import yaml  # here, so that the settings can be listed without it

        text = yaml.safe_dump(plain(asdict(self)), sort_keys=False, default_flow_style=None)
        write_text(Path(path), text, ConfigError)

    def grid(self, name: str, grid: str | None = None) -> PoseGrid:
        """The candidate grid ``train_grid`` or ``test_grid`` (or another one) in the extent."""
        return PoseGrid.parse(grid or getattr(self, name), self.extent or (0.0, 0.0, 1.0, 1.0))

    def frustum(self) -> Frustum:
        """Field of view and slices; `hfov_deg` must be known, as it is in a run folder."""
        if self.hfov_deg is None or self.projection is None:
            raise ConfigError("hfov_deg is None; it must be known: training fills it in")
        shares = self.band_shares()
        return Frustum(self.hfov_deg, self.slices, self.projection, shares, self.left_deg)

    def band_shares(self) -> tuple[float, ...]:
        """The ranges of the bands in shares of the tile's side, to four digits.

        Raises
        ------
        ConfigError
            If they are in metres and the tiles' side is not known, as it is in a run folder.
        """
        scale = 1.0 if self._bands_are_shares() else self._tile_side_m()
        return tuple(round(range_ / scale, 4) for range_ in self.bands)

    def band_ranges_m(self) -> tuple[float, ...]:
        """The ranges of the bands in metres; see `band_shares`."""
        scale = self._tile_side_m() if self._bands_are_shares() else 1.0
        return tuple(range_ * scale for range_ in self.bands)

    def _bands_are_shares(self) -> bool:
        return max(self.bands, default=0.0) < _LARGEST_SHARE

    def _tile_side_m(self) -> float:
        if self.tile_side_m is None:
            raise ConfigError(
                "bands are ranges on the ground, and tile_side_m, the tiles' side, is not known: "
                "training fills it in"
            )
        return self.tile_side_m

    def heading_prior(self) -> tuple[float, float] | None:
        """The heading prior as (centre, half width) in degrees, or None for any heading."""
        if self.heading_half_width_deg is None or self.prior_centre_deg is None:
            return None
        return self.prior_centre_deg, self.heading_half_width_deg

    def normalisation(self) -> tuple[Triple, Triple]:
        """Mean and deviation of the images; ImageNet's as long as `image_mean` is None."""
        return self.image_mean or IMAGENET_MEAN, self.image_std or IMAGENET_STD

    def data_config(
        self, root: str | None = None, split: str | None = None, data: str | None = None
    ) -> DataConfig:
        """Settings of the data set, on request with another root or split, or of another one.

        Raises
        ------
        ConfigError
            If the data set refuses them.
        """
        kind = config_class(self.data if data is None else data)
        own = kind.own_settings()
        unknown = sorted(set(self.data_settings) - set(own)) if data is None else []
        if unknown:
            raise ConfigError(
                f"setting {unknown[0]!r} is unknown to {self.data}; its own are {', '.join(own)}"
            )
        settings: dict[str, Any] = {
            "root": root or self.root,
            "split": split or self.split,
            "heading_half_width_deg": self.heading_half_width_deg,
            "aerial_size": self.aerial_size,
            "elevations": self.elevations,
            "ground_fit": self.ground_fit,
            "validation_fraction": self.validation_fraction,
            "augment": self.augment,
            "restyle": self.restyle,
            "extent": self.extent,
            "place_prior": self.place_prior,
            "seed": self.seed,
        }
        settings["image_mean"], settings["image_std"] = self.normalisation()
        settings["ground_size"] = self.ground_size or kind.default_ground_size(self.hfov_deg)
        if self.hfov_deg is not None:
            for name in ("hfov_deg", "left_deg", "horizon"):
                settings[name] = getattr(self, name)
        for setting in fields(kind):
            if setting.name in self.data_settings:
                value = self.data_settings[setting.name]
                settings[setting.name] = convert(setting.name, value, setting.type)
        try:
            found = kind(**settings)
        except ValueError as error:
            raise ConfigError(str(error)) from error
        if self.projection not in (None, found.projection) and kind is not config_class(OWN):
            raise ConfigError(
                f"{found.root}: its images are {found.projection}, and the run's are "
                f"{self.projection}; name images of the run's kind"
            )
        return found

    def with_data(
        self,
        data: str | None = None,
        root: str | None = None,
        own: Mapping[str, Any] | None = None,
    ) -> "TrainConfig":
        """These settings for measuring: images as they are, of another data set where one is named.

        The network, its images' sizes and its candidates stay. Own settings of another data set
        start from its defaults; its tiles, where it can cut them, are as large as in training, and
        none of its samples is set aside for validation, since none was trained on.

        Parameters
        ----------
        data : str, optional
            The data set's name; the run's own by default.
        root : str, optional
            Where its images lie, in place of the run's root; another data set has to have one.
        own : mapping, optional
            Settings of the data set's own, such as `map`, in place of those that it has.

        Raises
        ------
        ConfigError
            If there is no such data set or setting, or another data set has no root or other
            images than panoramas that show as much as the run's do.
        """
        own = dict(own or {})
        measured = replace(self, augment=False, restyle=0.0)
        if data in (None, self.data):
            settings = {**self.data_settings, **own}
            return replace(measured, root=root or self.root, data_settings=settings)
        if data not in DATA_SETS:
            raise ConfigError(f"data is {data!r}; it must be one of {', '.join(DATA_SETS)}")
        if not root:
            raise ConfigError(
                f"data is {data!r}, and the run was trained on {self.data!r}; name the root of the "
                "other data, too"
            )
        measured = replace(
            measured, data=data, root=root, split="same-area", data_settings=own,
            validation_fraction=0.0, hfov_deg=None, projection=None, prior_centre_deg=None,
            ground_aspect=None,
        )  # fmt: skip
        if not (self._of_panoramas() and measured._of_panoramas()):
            raise ConfigError(
                f"{root}: its images are {measured._images()}, and the run's are {self._images()}; "
                "a run is measured on other data only where both are whole panoramas: train on "
                "these, from the run with --init"
            )
        side_m = self.tile_side_m
        tiles = {} if side_m is None else measured.data_config().cut_to(side_m)
        settings = {**measured.data_settings, **tiles, **own}
        return replace(measured, hfov_deg=self.hfov_deg, data_settings=settings)

    def _of_panoramas(self) -> bool:
        """Whether the images were whole panoramas before they were cut to the HFoV."""
        part = self.data_settings.get("view") is not None
        part |= self.data == OWN and self.hfov_deg not in (None, 360.0)
        return self.projection == "equirectangular" and not part

    def _images(self) -> str:
        """The kind of the images, for a sentence."""
        if self.projection != "equirectangular":
            return f"{self.projection} ones"
        return "whole panoramas" if self._of_panoramas() else "parts of panoramas"

    def dataset(
        self,
        part: str,
        root: str | None = None,
        split: str | None = None,
        bad_sample_log: "BadSampleLog | None" = None,
    ) -> "PoseDataset":
        """The data set's training, validation or test part."""
        from slicematch.data.dataset import PoseDataset  # needs torch, which settings do not

        return PoseDataset(self.data_config(root, split), part, bad_sample_log)

    def own_dataset(self, samples: Any, part: str) -> "PoseDataset":
        """A program's own samples, as `PoseDataset` documents them, with these settings.

        Parameters
        ----------
        samples : torch.utils.data.Dataset
            What the program hands over.
        part : {"train", "validation", "test"}
            What they are for.

        Raises
        ------
        ConfigError
            If the ground images' field of view is not known.
        DatasetError
            If they are no such samples.
        """
        from slicematch.data.dataset import PoseDataset  # needs torch, which settings do not
        from slicematch.data.own import OwnSource

        hfov_deg = 360.0 if self.projection == "equirectangular" else None
        hfov_deg = hfov_deg if self.hfov_deg is None else self.hfov_deg
        if self.projection is None or hfov_deg is None:
            raise ConfigError(
                "hfov_deg is None; of a program's own pinhole images it must be known, in degrees"
            )
        config = self.data_config(data=OWN)
        source = OwnSource(samples, config, self.projection, hfov_deg)
        return PoseDataset(config, part, source=source)


def _needs_data(settings: Mapping[str, Any]) -> bool:
    """Whether the data set must be asked: something is missing, or its settings stand beside."""
    if settings.get("data") is None:
        return False
    known = {setting.name for setting in fields(TrainConfig)}
    complete = all(settings.get(name) is not None for name in _FROM_DATA)
    return not complete or not set(settings) <= known


def _renamed(settings: Mapping[str, Any], data: type[DataConfig] | None) -> dict[str, Any]:
    """The settings by today's names."""
    renamed = {
        _OLD_NAMES[name]: value for name, value in settings.items() if name in _OLD_NAMES
    } | {name: value for name, value in settings.items() if name not in _OLD_NAMES}
    if data is not None and set(_OLD_NAMES) <= set(settings):
        # A run folder of version 0.1: it holds the settings of both data sets, and was trained with
        # ImageNet's mean and deviation, whatever its encoder.
        for name in {"labels", "cities", "split_dir"} - set(data.own_settings()):
            renamed.pop(name, None)
        renamed = {"image_mean": IMAGENET_MEAN, "image_std": IMAGENET_STD} | renamed
    return renamed


def plain(value: Any) -> Any:
    """A value of lists, dicts and plain values, as YAML has them."""
    if isinstance(value, Mapping):
        return {key: plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    return str(value) if isinstance(value, Path) else value


def check_workers(workers: int) -> int:
    """The number of processes that load images, or ConfigError if it is negative."""
    if workers < 0:
        raise ConfigError(f"workers is {workers}; it must be at least 0")
    return workers
