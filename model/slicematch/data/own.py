"""Samples of a program's own: any torch `Dataset` whose items are those of a `PoseDataset`."""

from collections.abc import Mapping, Sized
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from slicemask.errors import ImageError, PoseError
from slicemask.geometry.frustum import Projection
from slicemask.geometry.poses import check_poses
from slicemask.images import ASPECT_TOLERANCE, read_image, resize
from slicematch.data.elevations import crop_elevations
from slicematch.data.errors import DatasetError, SampleError
from slicematch.data.source import DataConfig, Part, Source

# Of an item; `name` is optional.
_KEYS = ("ground", "aerial", "pose", "metres_per_pixel")


@dataclass(frozen=True, kw_only=True)
class OwnConfig(DataConfig):
    """Settings of a program's own samples: those of `DataConfig`.

    The defaults are of panoramas; `TrainConfig` says what else they are (``projection``,
    ``hfov_deg``, ``ground_aspect``). No command makes samples of them: a program hands its data set
    to `train` and `evaluate`.
    """

    projection = "equirectangular"
    ground_aspect = 2.0
    camera_height_m = 2.0
    prior_centre_deg = 0.0
    train_grid = "7x7x16"
    test_grid = "21x21x64"

    root: str | Path = ""
    ground_size: tuple[int, int] = (320, 640)

    def open(self, part: Part) -> Source:
        """Refuse: there is no file to open.

        Raises
        ------
        DatasetError
            Always.
        """
        raise DatasetError(
            f"the samples of this run come from a program's own data set; hand its {part} part "
            "over in Python, such as evaluate(run, dataset=...)"
        )


class OwnSource(Source):
    """A program's data set as a source.

    Parameters
    ----------
    samples : torch.utils.data.Dataset
        Of items as `slicematch.data.dataset.PoseDataset` documents them under "Own data".
    config : DataConfig
        Sizes of the images.
    projection : {"equirectangular", "pinhole"}
        Of the ground images.
    hfov_deg : float
        Horizontal field of view of the ground images.

    Raises
    ------
    DatasetError
        If it has no length, or its first item is no such item.
    """

    poses_need_images = True

    def __init__(
        self, samples: Any, config: DataConfig, projection: Projection, hfov_deg: float
    ) -> None:
        self.left_deg, self.horizon = config.left_deg, config.horizon
        if not (isinstance(samples, Sized) and hasattr(samples, "__getitem__")):
            raise DatasetError(
                f"the data set is of type {type(samples).__name__}; it must be a torch Dataset "
                "with __len__ and __getitem__"
            )
        self.config = config
        self.projection = projection
        self.hfov_deg = hfov_deg
        self._samples = samples
        self._last: tuple[int, Mapping[str, Any]] | None = None
        count = len(samples)
        names = getattr(samples, "names", None)
        self.names = [str(name) for name in (range(count) if names is None else names)]
        if len(self.names) != count:
            raise DatasetError(
                f"the data set has {count} samples and {len(self.names)} names; expected one each"
            )
        if count == 0:
            raise DatasetError("the data set holds no sample; expected one at least")
        self.tile_metres = np.full(count, self._side_m(0))

    def pose(self, index: int, random: np.random.Generator) -> NDArray[np.float64]:
        """The true pose of a sample; see `Source.pose`."""
        try:
            return check_poses([np.asarray(self._item(index)["pose"])])[0]
        except PoseError as error:
            raise self._wrong(index, f"pose: {error}") from error

    def images(self, index: int, random: np.random.Generator) -> tuple[Image.Image, Image.Image]:
        """The images of a sample; see `Source.images`."""
        self._last = None  # so that pose and images are of the same call
        item = self._item(index)
        self.tile_metres[index] = self._side_m(index)
        ground, aerial = (self._image(index, item[key], key) for key in ("ground", "aerial"))
        if abs(aerial.width / aerial.height - 1) > ASPECT_TOLERANCE:
            raise self._wrong(
                index, f"aerial is {aerial.width}x{aerial.height} pixels; it must be square"
            )
        ground = crop_elevations(
            ground,
            self.config.elevations,
            self.projection,
            self.hfov_deg,
            self.left_deg,
            self.horizon,
        )
        size = self.config.aerial_size
        return resize(ground, self.config.ground_size), resize(aerial, (size, size))

    def _item(self, index: int) -> Mapping[str, Any]:
        """An item; of the last one asked for, the same again."""
        if self._last is None or self._last[0] != index:
            item = self._samples[index]
            if not isinstance(item, Mapping) or any(key not in item for key in _KEYS):
                found = ", ".join(item) if isinstance(item, Mapping) else type(item).__name__
                raise self._wrong(index, f"is {found}; expected a dict of {', '.join(_KEYS)}")
            self._last = index, item
        return self._last[1]

    def _side_m(self, index: int) -> float:
        """Side of a sample's tile on the ground, metres."""
        item = self._item(index)
        width = self._image(index, item["aerial"], "aerial").width
        try:
            side_m = width * float(item["metres_per_pixel"])
        except (TypeError, ValueError):
            side_m = np.nan
        if not 0 < side_m < np.inf:
            raise self._wrong(
                index,
                f"metres_per_pixel is {item['metres_per_pixel']!r}; it must be that of the aerial "
                "image as it is handed over, above 0",
            )
        return side_m

    def _image(self, index: int, value: Any, key: str) -> Image.Image:
        if hasattr(value, "detach"):  # a tensor [3, H, W]
            value = value.detach().cpu().numpy()
            value = value.transpose(1, 2, 0) if value.ndim == 3 else value
        try:
            return read_image(value)
        except ImageError as error:
            raise SampleError(f"sample {index} of the data set: {key}: {error}") from error

    def _wrong(self, index: int, what: str) -> DatasetError:
        return DatasetError(f"sample {index} of the data set: {what}")
