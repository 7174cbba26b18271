"""What a data set declares: its settings with their defaults, and the source of its samples."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar, Literal, cast, get_args

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from slicemask.geometry.frustum import Projection
from slicematch.data.elevations import Elevations, GroundFit
from slicematch.data.errors import DatasetError
from slicematch.normalisation import IMAGENET_MEAN, IMAGENET_STD, Triple

Part = Literal["train", "validation", "test"]
Split = Literal["same-area", "cross-area"]


@dataclass(frozen=True, kw_only=True)
class DataConfig:
    """Settings that every data set has.

    Parameters
    ----------
    root : path
        The folder of the data tree.
    split : {"same-area", "cross-area"}
        Whether the test part lies where the training part does, or elsewhere.
    heading_half_width_deg : float or None
        How far the heading may lie from `prior_centre_deg`, to either side: 0 is a known heading
        ("aligned"), None (the default) an unknown one. From 0 to 180.
    hfov_deg : float or None
        Horizontal field of view of the ground images, in degrees: what panoramas are cut to, around
        their headings, and what cameras have; None for the whole panorama, or for what the data say
        of their cameras.
    left_deg : float or None
        Azimuth of the left edge of a pinhole camera's images from its optical axis, which is the
        heading; None for one in the centre. It holds where `hfov_deg` is given.
    horizon : float
        Where the horizon of a pinhole camera's images is, from their top, as a fraction of their
        height. It holds where `hfov_deg` is given.
    ground_size : (height, width)
        Of the ground image as returned, in pixels.
    elevations : (lowest, highest) or None
        Which part of the ground images is used, in degrees above the horizon; None for all.
    ground_fit : {"crop", "resize"}
        What to do with ground images of other proportions than `ground_aspect`: see
        `slicematch.data.elevations.frame_ground` and `slicematch.data.panoramas.read_panorama`.
    aerial_size : int
        Side of the aerial image as returned, in pixels.
    image_mean, image_std : (red, green, blue)
        Taken out of the images, whose values are in [0, 1]; ImageNet's by default.
    validation_fraction : float
        The part of the training file that is set aside for validation; 0 trains on everything and
        leaves no validation part. Ours: 0.1.
    augment : bool
        Rotate, mirror and recolour the samples of the training part: see
        `slicematch.data.dataset.PoseDataset`. Ours; the paper does not.
    restyle : float
        Share of the images of augmented samples that are shown in another style: see
        `slicematch.data.restyling.restyle`. Ours.
    extent : (u0, v0, u1, v1) or None
        The part of the tile where candidates stand; None for `default_extent`.
    place_prior : (u, v, radius) or None
        Candidates farther than the radius from (u, v) are left out. Neither leaves a sample out.
    seed : int
        Of the validation part and of everything that is drawn at random.

    Raises
    ------
    DatasetError
        If a value is out of its range.

    Attributes
    ----------
    projection : {"equirectangular", "pinhole"}
        Of the ground images.
    ground_aspect : float
        Width over height of the ground images as they are.
    camera_height_m : float
        Of the cameras above the ground.
    prior_centre_deg : float
        The heading that a heading prior is centred on, degrees clockwise from north.
    train_grid, test_grid : str
        Candidate poses, ROWSxCOLUMNSxHEADINGS.
    """

    projection: ClassVar[Projection]
    ground_aspect: ClassVar[float]
    camera_height_m: ClassVar[float]
    prior_centre_deg: ClassVar[float]
    train_grid: ClassVar[str]
    test_grid: ClassVar[str]

    root: str | Path
    split: Split = "same-area"
    heading_half_width_deg: float | None = None
    hfov_deg: float | None = None
    left_deg: float | None = None
    horizon: float = 0.5
    ground_size: tuple[int, int]
    elevations: Elevations | None = None
    ground_fit: GroundFit = "crop"
    aerial_size: int = 512
    image_mean: Triple = IMAGENET_MEAN
    image_std: Triple = IMAGENET_STD
    validation_fraction: float = 0.1
    augment: bool = False
    restyle: float = 0.0
    extent: tuple[float, float, float, float] | None = None
    place_prior: Triple | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "ground_size", tuple(self.ground_size))
        size = self.ground_size
        half_width = self.heading_half_width_deg
        fraction = self.validation_fraction
        widest_deg = 360 if self.projection == "equirectangular" else 180
        expected = {
            "hfov_deg": (
                self.hfov_deg is None
                or (isinstance(self.hfov_deg, int | float) and 0 < self.hfov_deg <= widest_deg),
                f"a number of degrees above 0 and up to {widest_deg}",
            ),
            "horizon": (isinstance(self.horizon, int | float), "a fraction of the height"),
            "ground_fit": (self.ground_fit in get_args(GroundFit), "one of crop, resize"),
            "split": (self.split in ("same-area", "cross-area"), "one of same-area, cross-area"),
            "heading_half_width_deg": (
                half_width is None
                or (isinstance(half_width, int | float) and 0 <= half_width <= 180),
                "None or a number from 0 to 180",
            ),
            "ground_size": (
                len(size) == 2 and all(isinstance(side, int) and side > 0 for side in size),
                "(height, width), two whole numbers of at least 1",
            ),
            "elevations": (
                self.elevations is None or -90 <= self.elevations[0] < self.elevations[1] <= 90,
                "(lowest, highest) from -90 to 90 degrees",
            ),
            "aerial_size": (
                isinstance(self.aerial_size, int) and self.aerial_size > 0,
                "a whole number of at least 1",
            ),
            "image_mean": (len(self.image_mean) == 3, "three numbers: red, green, blue"),
            "image_std": (
                len(self.image_std) == 3 and min(self.image_std) > 0,
                "three numbers greater than 0: red, green, blue",
            ),
            "validation_fraction": (
                isinstance(fraction, int | float) and 0 <= fraction < 1,
                "a number of at least 0 and below 1",
            ),
            "augment": (isinstance(self.augment, bool), "true or false"),
            "restyle": (
                isinstance(self.restyle, int | float)
                and 0 <= self.restyle <= 1
                and (self.augment or not self.restyle),
                "a share from 0 to 1, and 0 without augment",
            ),
            "seed": (isinstance(self.seed, int) and self.seed >= 0, "a whole number from 0 up"),
        }
        for name, (holds, what) in expected.items():
            if not holds:
                raise DatasetError(f"{name} is {getattr(self, name)!r}; it must be {what}")
        if self.extent is None:
            object.__setattr__(self, "extent", self.default_extent())

    @classmethod
    def own_settings(cls) -> list[str]:
        """The names of the settings that this data set has and others need not have.

        Returns
        -------
        list of str
            In the order of their definition.
        """
        shared = {field.name for field in fields(DataConfig)}
        return [field.name for field in fields(cls) if field.name not in shared]

    @property
    def heading_prior(self) -> tuple[float, float] | None:
        """Headings lie within the second number of degrees of the first; None if they may be any.

        Degrees clockwise from north.
        """
        half_width = self.heading_half_width_deg
        if half_width is None or half_width == 180:
            return None
        return self.prior_centre_deg, float(half_width)

    @classmethod
    def default_ground_size(cls, hfov_deg: float | None = None) -> tuple[int, int]:
        """Pixels of the ground image, (height, width), for a run that names none.

        Parameters
        ----------
        hfov_deg : float or None
            Horizontal field of view of the run; None for the data set's.
        """
        return cast(tuple[int, int], cls.__dataclass_fields__["ground_size"].default)

    def default_extent(self) -> tuple[float, float, float, float]:
        """The part of the tile where cameras may stand.

        Returns
        -------
        (u0, v0, u1, v1)
            In the aerial frame; the whole tile unless a data set knows better.
        """
        return 0.0, 0.0, 1.0, 1.0

    def cut_to(self, side_m: float) -> dict[str, Any]:
        """Own settings under which aerial tiles are as large on the ground as those of a run.

        Parameters
        ----------
        side_m : float
            Side of the run's tiles, in metres.

        Returns
        -------
        dict
            Settings by name; empty for a data set that does not cut its tiles.
        """
        return {}

    def check_root(self) -> None:
        """Refuse a root that is not there.

        Raises
        ------
        DatasetError
            If it is no folder, or where a data set is a file, no such file.
        """
        if not Path(self.root).is_dir():
            raise DatasetError(
                f"{self.root}: there is no such folder; name the root of the data tree"
            )

    def open(self, part: Part) -> "Source":
        """Open the samples of a part.

        Parameters
        ----------
        part : {"train", "validation", "test"}
            Training and validation share the training file (`validation_fraction`).

        Returns
        -------
        Source
            Its samples; no image is read yet.

        Raises
        ------
        DatasetError
            If a file that lists or describes them is missing or invalid.
        """
        raise NotImplementedError

    def choose(self, part: Part, count: int) -> NDArray[np.intp]:
        """Which samples of a file a part takes.

        Training and validation share the training file; the test part takes all of its own.

        Parameters
        ----------
        part : {"train", "validation", "test"}
            The part.
        count : int
            Samples of the file.

        Returns
        -------
        int [n]
            Sorted indices below `count`, the same ones for the same `seed`.
        """
        if part == "test":
            return np.arange(count)
        order = np.random.default_rng(self.seed).permutation(count)
        held_out = round(count * self.validation_fraction)
        return np.sort(order[:held_out] if part == "validation" else order[held_out:])


class Source(ABC):
    """The samples of one part of a data set, as they are on disk.

    What is random in a sample is drawn from the generator handed in, which is the same for the
    pose and for the images of a sample.

    Attributes
    ----------
    names : list of str
        One for each sample. A sample is its place in the list: names may repeat.
    tile_metres : float64 [n]
        Side of each aerial image on the ground, in metres.
    hfov_deg : float
        Horizontal field of view of the ground images.
    left_deg : float or None
        Azimuth of their left edge from the heading; None for half the HFoV to the left.
    horizon : float
        Where their horizon is, from the top, as a fraction of their height.
    left_out : int
        Labels that give no sample because the camera stands off its tile.
    headings_deg : float64 [n] or None
        Headings to use, where the source would otherwise draw them.
    labels : int [n] or None
        Which label of its files, all counted in their order, each sample comes from; None where
        headings are not drawn but stand in the files.
    poses_need_images : bool
        Whether a pose is known only once the sample's images are loaded.
    """

    names: list[str]
    tile_metres: NDArray[np.float64]
    hfov_deg: float
    left_deg: float | None = None
    horizon: float = 0.5
    left_out: int = 0
    headings_deg: NDArray[np.float64] | None = None
    labels: NDArray[np.intp] | None = None
    label_count: int = 0
    poses_need_images: bool = False

    @abstractmethod
    def pose(self, index: int, random: np.random.Generator) -> NDArray[np.float64]:
        """The true pose of a sample.

        Parameters
        ----------
        index : int
            The sample's place in the list.
        random : numpy.random.Generator
            What is drawn is drawn from it.

        Returns
        -------
        float64 [3]
            u, v, heading_deg in the aerial frame.
        """

    @abstractmethod
    def images(self, index: int, random: np.random.Generator) -> tuple[Image.Image, Image.Image]:
        """The images of a sample.

        Parameters
        ----------
        index : int
            The sample's place in the list.
        random : numpy.random.Generator
            What is drawn is drawn from it, as for `pose`.

        Returns
        -------
        ground, aerial : PIL.Image.Image
            RGB, of the sizes in the settings.

        Raises
        ------
        SampleError, ImageError
            If a file of the sample is unusable.
        """
