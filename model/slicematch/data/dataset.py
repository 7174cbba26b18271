"""Samples as tensors, with what is drawn at random, and what becomes of unreadable ones."""

import json
import logging
import zlib
from collections import Counter
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import Dataset, default_collate

from slicemask import Frustum
from slicemask.errors import ImageError
from slicemask.geometry.symmetry import SYMMETRIES, Symmetry
from slicematch.data.augmentation import recolour
from slicematch.data.errors import DatasetError, SampleError
from slicematch.data.images import normalise
from slicematch.data.loading import raise_lack_of_resources
from slicematch.data.restyling import restyle
from slicematch.data.source import DataConfig, Part, Source
from slicematch.priors import count_outside

log = logging.getLogger(__name__)
Sample = dict[str, Any]


class BadSampleLog:
    """The samples of one run that are unreadable, written down as they are met.

    A line of JSON for each goes to a file at once, from whichever worker process meets it, so that
    nothing is lost if the run ends early.

    Parameters
    ----------
    path : path
        The file, for instance ``bad_samples.jsonl`` in the run folder.
    limit : int
        How many different samples may be unreadable; more mean that the data set is broken.
    keep : bool
        Go on with the list that is in the file, as a resumed run does, rather than begin it again.
        A last line that a kill left half-written is removed.
    """

    def __init__(self, path: str | Path, limit: int = 10, keep: bool = False):
        self.path = Path(path)
        self.limit = limit
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("ab") as file:
            file.truncate(_whole_lines(self.path.read_bytes()) if keep else 0)

    def record(self, name: str, error: Exception) -> None:
        """Write an unreadable sample down, once however often it is met.

        Raises
        ------
        DatasetError
            If there are now more than `limit` of them.
        """
        if name not in self.entries():
            log.warning("sample %s is left out: %s", name, error)
            line = json.dumps({"name": name, "error": str(error)}) + "\n"
            try:
                # One short write in append mode: lines of several processes do not mix.
                with self.path.open("a", encoding="utf-8") as file:
                    file.write(line)
            except OSError as failure:
                raise DatasetError(
                    f"{self.path}: sample {name} is unreadable and cannot be written down there "
                    f"({failure.strerror}); make room or name another folder"
                ) from failure
        if len(self.entries()) > self.limit:
            raise DatasetError(
                f"more than {self.limit} samples are unreadable, listed in {self.path}; mend them "
                f"or raise the limit; the last one: {error}"
            )

    def entries(self) -> dict[str, str]:
        """Sample name to what is wrong with it, in the order met."""
        content = self.path.read_bytes()
        lines = content[: _whole_lines(content)].splitlines()
        return dict(entry for entry in map(_entry, lines) if entry is not None)

    def report(self) -> str:
        """One sentence for the end of an epoch; empty if every sample was read."""
        entries = self.entries()
        if not entries:
            return ""
        first = next(iter(entries.values()))
        count = "1 sample is" if len(entries) == 1 else f"{len(entries)} samples are"
        return f"{count} unreadable, listed in {self.path}; first: {first}"


def _whole_lines(content: bytes) -> int:
    """The length of a file's content up to its last line end."""
    return content.rfind(b"\n") + 1


def _entry(line: bytes) -> tuple[str, str] | None:
    """The name and error on a line; None for a line that a crash has spoilt."""
    try:
        entry = json.loads(line)
        return str(entry["name"]), str(entry["error"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return None


class PoseDataset(Dataset[Sample | None]):
    """Ground and aerial images with the pose of the one in the other.

    An item is a dict:

    - ``ground``: float32 [3, Hg, Wg], normalised by the settings' mean and deviation;
    - ``aerial``: float32 [3, A, A], likewise;
    - ``pose``: float64 [3], the true (u, v, heading_deg), exact and unrounded;
    - ``metres_per_pixel``: float, of the A-pixel aerial image as returned;
    - ``name``: str; ``index``: int, which alone tells samples apart, since names may repeat.

    What is random is drawn from (seed, epoch, sample name) alone: the same in any order, worker
    process or selection of samples, and after a resume; samples of the same name draw differently.
    Training draws again in every epoch; call `set_epoch` before an epoch's iterator is made.
    Validation and test draw once and for all.

    With `DataConfig.augment`, a training sample is shown under one of the tile's eight symmetries
    (quarter turns and mirrorings), drawn again in every epoch: the tile is turned and mirrored, the
    pose with it, and the ground image mirrored where the tile is. Only symmetries are drawn that
    map the extent and the priors on place and heading onto themselves, so that a true pose stays
    among the candidates. Its colours change as `recolour` says, and `DataConfig.restyle` of its
    images are shown in another style.

    **Own data.** `slicematch.train` and `slicematch.evaluate` take any other torch ``Dataset`` by
    ``dataset=`` and ``validation=``. Its items are dicts of these four, with the images before they
    are resized and normalised, which is left to the run; what this class says of augmentation and
    of unreadable samples then holds for them:

    - ``ground``: an image as `slicemask.images.read_image` takes it (path, PIL image or array
      [H, W, 3], uint8 or float in [0, 1]), or a tensor [3, H, W] of such values;
    - ``aerial``: likewise, square, north up;
    - ``pose``: u, v, heading_deg of the ground image in the aerial one;
    - ``metres_per_pixel``: of the aerial image as it is handed over.

    A list ``names`` of its samples is used if it has one; else they are called by their numbers.

    An unreadable sample raises `SampleError`, unless the data set was given a `BadSampleLog`: then
    it is written down there and, in training, the next readable sample stands in, so that batches
    stay whole; in validation and test, where a stand-in would count twice, the item is None, which
    `collate` drops.

    Parameters
    ----------
    config : DataConfig
        Settings of a data set, such as `slicematch.data.vigor.VigorConfig`.
    part : {"train", "validation", "test"}
        Training and validation share the training file (`validation_fraction`).
    bad_sample_log : BadSampleLog, optional
        Where unreadable samples are written down; without it they raise.
    source : Source, optional
        The samples; by default what the settings open.

    Attributes
    ----------
    names : list of str
        One for each sample; they may repeat.
    hfov_deg, left_deg, horizon : float
        Horizontal field of view of the ground images, the azimuth of their left edge (None for one
        of half the field of view), and where their horizon is: see `DataConfig`.
    aerial_size : int
        A, in pixels.
    heading_prior : (centre, half width) or None
        Headings lie within the half width of the centre, in degrees; None if they may be any.
    tile_metres : float64 [n]
        Side of each aerial image on the ground, in metres.
    left_out : int
        Labels that gave no sample because the camera stands off its tile; logged where there are
        any.
    poses_need_images : bool
        Whether a pose is known only once the sample's images are loaded.

    Raises
    ------
    DatasetError
        If the part is unknown, a file that lists or describes its samples is missing or invalid,
        or no sample remains.
    """

    def __init__(
        self,
        config: DataConfig,
        part: str = "train",
        bad_sample_log: BadSampleLog | None = None,
        source: Source | None = None,
    ):
        if part not in get_args(Part):
            raise DatasetError(f"part is {part!r}; it must be one of {', '.join(get_args(Part))}")
        if source is None:
            config.check_root()
        self.config = config
        self.part = part
        self.bad_sample_log = bad_sample_log
        self.aerial_size = config.aerial_size
        self.heading_prior = config.heading_prior
        self._source = config.open(cast(Part, part)) if source is None else source
        self.names = self._source.names
        self.hfov_deg = self._source.hfov_deg
        self.left_deg, self.horizon = self._source.left_deg, self._source.horizon
        self.tile_metres = self._source.tile_metres
        self.left_out = self._source.left_out
        self.poses_need_images = self._source.poses_need_images
        if self.left_out:
            log.warning(
                "%d of the %s part's labels are left out, since the camera stands off its tile",
                self.left_out,
                part,
            )
        if not self.names:
            raise DatasetError(
                f"the {part} part of {config.root} holds no sample; check the split, the cities "
                f"and validation_fraction, which is {config.validation_fraction:g}"
            )
        frustum = Frustum(self.hfov_deg, 1, config.projection, left_deg=self.left_deg)
        self._principal_point = frustum.principal_point
        self._keys = _distinct(self.names)
        # An image whose optical axis is near its edge, or off it, has no mirror image to show.
        central = 0.25 <= self._principal_point <= 0.75
        self._symmetries = [
            symmetry
            for symmetry in SYMMETRIES
            if _keeps(symmetry, config) and (central or symmetry.azimuth_map[0] > 0)
        ]
        # In shared memory: workers that live on from epoch to epoch see the change.
        self._epoch = torch.zeros((), dtype=torch.int64)
        self._epoch.share_memory_()

    def set_epoch(self, epoch: int) -> None:
        """Let training draw for this epoch; call it before the epoch's iterator is made."""
        self._epoch.fill_(epoch)

    def pose(self, index: int) -> NDArray[np.float64]:
        """The true pose of a sample, float64 [3] of u, v, heading_deg, without its images."""
        pose = self._source.pose(index, self._random(index))
        return self._symmetry(index).pose(pose) if self._augmented else pose

    def use_headings(self, headings_deg: NDArray[np.float64]) -> None:
        """Give the samples these headings in place of those that would be drawn.

        Parameters
        ----------
        headings_deg : float64 [labels] or [n]
            Degrees clockwise from north: one for each line of the part's label files, in their
            order, or one for each sample.

        Raises
        ------
        DatasetError
            If there are more or fewer, or the data set's files hold the headings themselves.
        """
        source = self._source
        if source.labels is None:
            raise DatasetError(
                "the headings of this data set stand in its own files; it takes no list of them"
            )
        if len(headings_deg) == source.label_count:
            headings_deg = headings_deg[source.labels]
        if len(headings_deg) != len(self):
            raise DatasetError(
                f"there are {len(headings_deg)} headings for {source.label_count} labels of the "
                f"{self.part} part; expected one for each, in the order of the label files"
            )
        source.headings_deg = headings_deg

    def load(self, index: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Ground float32 [3, Hg, Wg] and aerial float32 [3, A, A] of a sample, normalised.

        Raises
        ------
        SampleError
            If a file of the sample is unusable.
        """
        mean, std = self.config.image_mean, self.config.image_std
        try:
            images = self._source.images(index, self._random(index))
        except ImageError as error:
            raise_lack_of_resources(error)
            raise SampleError(str(error)) from error
        ground, aerial = (normalise(image, mean, std) for image in images)
        if not self._augmented:
            return ground, aerial
        symmetry = self._symmetry(index)
        if symmetry.azimuth_map[0] < 0:
            ground = _mirrored(ground, self._principal_point)
        aerial = torch.from_numpy(np.ascontiguousarray(symmetry.masks(aerial.numpy())))
        pair = recolour(ground, aerial, self._random(index, "colours"), mean, std)
        ground, aerial = (
            self._restyled(image, self._random(index, name))
            for image, name in zip(pair, ("ground style", "aerial style"), strict=True)
        )
        return ground, aerial

    def _restyled(self, image: torch.Tensor, random: np.random.Generator) -> torch.Tensor:
        """An image, or in its share of cases one in another style."""
        if random.random() >= self.config.restyle:
            return image
        return restyle(image, random, self.config.image_mean, self.config.image_std)

    @property
    def _augmented(self) -> bool:
        return self.config.augment and self.part == "train"

    def _symmetry(self, index: int) -> Symmetry:
        """The symmetry that a sample is shown under in this epoch."""
        chosen = self._random(index, "symmetry").integers(len(self._symmetries))
        return self._symmetries[chosen]

    def poses(self) -> NDArray[np.float64]:
        """All true poses, float64 [n, 3]; those of the epoch that was set, in training."""
        return np.array([self.pose(index) for index in range(len(self))]).reshape(-1, 3)

    def count_outside(
        self,
        extent: tuple[float, float, float, float],
        indices: list[int] | None = None,
        place_prior: tuple[float, float, float] | None = None,
    ) -> int:
        """How many true places lie outside (u0, v0, u1, v1), where no candidate can find them.

        Or, with a place prior (u, v, radius), beyond that. Of all samples, or of those with the
        indices given. The central quarter is (0.25, 0.25, 0.75, 0.75). A place on the edge is
        inside.
        """
        poses = self.poses()[slice(None) if indices is None else indices]
        return count_outside(poses, extent, place_prior)

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: int) -> Sample | None:
        if not 0 <= index < len(self):  # which also ends a loop over the samples
            raise IndexError(f"sample {index} of {len(self)}")
        if self.part != "train":
            return self.sample(index)
        for step in range(len(self)):
            sample = self.sample((index + step) % len(self))
            if sample is not None:
                return sample
        assert self.bad_sample_log is not None  # else the first one has raised
        raise DatasetError(
            f"none of the {len(self)} samples is readable; see {self.bad_sample_log.path}"
        )

    def sample(self, index: int) -> Sample | None:
        """A sample itself, or None for an unreadable one, which is written down.

        Raises
        ------
        SampleError
            If it is unreadable and there is no `bad_sample_log`.
        """
        try:
            ground, aerial = self.load(index)
        except SampleError as error:
            if self.bad_sample_log is None:
                raise
            self.bad_sample_log.record(self.names[index], error)
            return None
        return {
            "ground": ground,
            "aerial": aerial,
            "pose": torch.from_numpy(self.pose(index)),
            "metres_per_pixel": float(self.tile_metres[index] / self.aerial_size),
            "name": self.names[index],
            "index": index,
        }

    def _random(self, index: int, purpose: str = "") -> np.random.Generator:
        """Random numbers of one sample for one purpose, in training of one sample in one epoch."""
        epoch = int(self._epoch) + 1 if self.part == "train" else 0
        key = zlib.crc32((self._keys[index] + purpose).encode())
        return np.random.default_rng([self.config.seed, epoch, key])


def _distinct(names: list[str]) -> list[str]:
    """The names, with a number on each that came before."""
    seen: Counter[str] = Counter()
    distinct = []
    for name in names:
        distinct.append(f"{name}#{seen[name]}" if seen[name] else name)
        seen[name] += 1
    return distinct


def _mirrored(ground: torch.Tensor, principal_point: float) -> torch.Tensor:
    """A ground image [3, H, W] mirrored about its optical axis, with which it is still aligned.

    Columns that this leaves without content are zero, the mean of normalised images.
    """
    width = ground.shape[-1]
    shift = round((2.0 * principal_point - 1.0) * width)
    mirrored = torch.zeros_like(ground)
    kept = max(0, width - abs(shift))
    into, out_of = max(0, shift), max(0, -shift)
    mirrored[..., into : into + kept] = ground.flip(-1)[..., out_of : out_of + kept]
    return mirrored


def _keeps(symmetry: Symmetry, config: DataConfig) -> bool:
    """Whether a symmetry maps the extent and the priors onto themselves."""
    u0, v0, u1, v1 = config.extent or config.default_extent()
    heading_deg = config.prior_centre_deg
    corners = np.array([[u0, v0, heading_deg], [u1, v1, heading_deg]])
    images = np.array([symmetry.pose(corner) for corner in corners])
    kept = np.allclose(np.sort(images[:, :2], axis=0), corners[:, :2], rtol=0, atol=1e-9)
    if config.place_prior is not None:
        pose = np.array([*config.place_prior[:2], heading_deg])
        kept &= np.allclose(symmetry.pose(pose)[:2], pose[:2], rtol=0, atol=1e-9)
    return bool(kept and (config.heading_prior is None or images[0, 2] == heading_deg))


def collate(samples: list[Sample | None]) -> Sample | None:
    """Stack samples into a batch, leaving out unreadable ones; None if all were."""
    read = [sample for sample in samples if sample is not None]
    if not read:
        return None
    batch: Sample = default_collate(read)
    return batch
