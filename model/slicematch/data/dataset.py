"""What the data sets share: settings, seeded draws, and what becomes of a sample that is broken."""

import json
import logging
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch.utils.data import Dataset, default_collate

from slicemask.geometry.symmetry import SYMMETRIES, Symmetry
from slicematch.data.augmentation import recolour
from slicematch.data.errors import DatasetError, SampleError
from slicematch.evaluation.metrics import in_place_prior

PARTS = ("train", "validation", "test")
log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class DataConfig:
    """Settings that both data sets know.

    Parameters
    ----------
    root : path
        The folder of the data tree.
    heading_prior_deg : float or None
        How far the heading may lie from the one the data set holds to, to either side: 0 is a
        known heading ("aligned"), None (the default) one wholly unknown. From 0 to 180.
    ground_size : (height, width)
        Of the ground image as returned, in pixels.
    aerial_size : int
        Side of the aerial image as returned, in pixels.
    validation_fraction : float
        The share of the training file that is set aside for validation, since neither data set
        has a file for it; 0 trains on everything and leaves no validation part. Ours: 0.1.
    augment : bool
        Turn, mirror and recolour the samples of the training part: see `PoseDataset`. Ours; the
        paper does not.
    extent : (u0, v0, u1, v1)
        The part of the tile where candidates stand; the whole by default.
    place_prior : (u, v, radius) or None
        Candidates farther than the radius from (u, v) are left out. Neither leaves a sample out.
    seed : int
        Of the validation part and of every heading, shift and turn that is drawn.

    Raises
    ------
    DatasetError
        If a value is out of its range.
    """

    root: str | Path
    heading_prior_deg: float | None = None
    ground_size: tuple[int, int]
    aerial_size: int = 512
    validation_fraction: float = 0.1
    augment: bool = False
    extent: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)
    place_prior: tuple[float, float, float] | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "ground_size", tuple(self.ground_size))
        size = self.ground_size
        prior = self.heading_prior_deg
        fraction = self.validation_fraction
        wanted = {
            "heading_prior_deg": (
                prior is None or (isinstance(prior, int | float) and 0 <= prior <= 180),
                "None or a number from 0 to 180",
            ),
            "ground_size": (
                len(size) == 2 and all(isinstance(side, int) and side > 0 for side in size),
                "(height, width), two whole numbers of at least 1",
            ),
            "aerial_size": (
                isinstance(self.aerial_size, int) and self.aerial_size > 0,
                "a whole number of at least 1",
            ),
            "validation_fraction": (
                isinstance(fraction, int | float) and 0 <= fraction < 1,
                "a number of at least 0 and below 1",
            ),
            "augment": (isinstance(self.augment, bool), "true or false"),
            "seed": (isinstance(self.seed, int) and self.seed >= 0, "a whole number from 0 up"),
        }
        for name, (holds, expected) in wanted.items():
            if not holds:
                raise DatasetError(f"{name} is {getattr(self, name)!r}; it must be {expected}")


class BadSamples:
    """The samples of one run that could not be read, written down as they are met.

    A line of JSON per sample goes to a file at once, from whichever worker process meets it, so
    that nothing is lost if the run ends early.

    Parameters
    ----------
    path : path
        The file, for instance ``bad_samples.jsonl`` in the run folder.
    limit : int
        How many different bad samples to bear before the data set itself is held to be broken.
    keep : bool
        Go on with the list that is there, as a resumed run does, rather than begin it anew.
    """

    def __init__(self, path: str | Path, limit: int = 10, keep: bool = False):
        self.path = Path(path)
        self.limit = limit
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.path.open("a" if keep else "w").close()

    def record(self, name: str, error: SampleError) -> None:
        """Write a bad sample down, once however often it is met.

        Raises
        ------
        DatasetError
            If there are now more than `limit` of them.
        """
        if name not in self.entries():
            log.warning("sample %s is left out: %s", name, error)
            # One short write in append mode: lines of several processes do not mix.
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"name": name, "error": str(error)}) + "\n")
        if len(self.entries()) > self.limit:
            raise DatasetError(
                f"more than {self.limit} samples cannot be read, listed in {self.path}; mend them "
                f"or raise the limit; the last one: {error}"
            )

    def entries(self) -> dict[str, str]:
        """Sample name to what is wrong with it, in the order met."""
        lines = self.path.read_text(encoding="utf-8").splitlines()
        return {entry["name"]: entry["error"] for entry in map(json.loads, lines)}

    def report(self) -> str:
        """One sentence for the end of an epoch; empty if every sample was read."""
        entries = self.entries()
        if not entries:
            return ""
        first = next(iter(entries.values()))
        return f"{len(entries)} samples could not be read, listed in {self.path}; first: {first}"


class PoseDataset(Dataset):
    """Ground and aerial images with the pose of the one in the other.

    An item is a dict:

    - ``ground``: float32 [3, Hg, Wg], ImageNet-normalised;
    - ``aerial``: float32 [3, A, A], ImageNet-normalised;
    - ``pose``: float64 [3], the true (u, v, heading_deg), exact and unrounded;
    - ``metres_per_pixel``: float, of the A-pixel aerial image as returned;
    - ``name``: str, unique in the data set; ``index``: int.

    What is random is drawn from (seed, epoch, sample name) alone: the same in any order, worker
    process or selection of samples, and after a resume. Training draws anew in every epoch; call
    `set_epoch` before an epoch's iterator is made. Validation and test draw once and for all.

    With `DataConfig.augment`, a training sample is shown under one of the tile's eight symmetries
    (quarter turns and mirrorings), drawn anew in every epoch: the tile is turned and mirrored, the
    pose with it, and the ground image mirrored where the tile is. Only symmetries are drawn that
    map the extent and the priors on place and heading onto themselves, so that a true pose stays
    among the candidates. Its colours change as `recolour` says.

    A sample that cannot be read raises `SampleError`, unless the data set was given a `BadSamples`:
    then it is written down there and, in training, the next readable sample stands in, so that
    batches stay whole; in validation and test, where a stand-in would count twice, the item is
    None, which `collate` drops.

    Attributes
    ----------
    names : list of str
        One a sample.
    projection : {"equirectangular", "pinhole"}
        Of the ground images.
    hfov_deg : float
        Horizontal field of view of the ground images.
    aerial_size : int
        A, in pixels.
    heading_prior_deg : (centre, range) or None
        Headings lie within `range` degrees of `centre`; None if they may be any.
    tile_metres : float64 [n]
        Side of each aerial image on the ground, in metres.
    """

    projection: ClassVar[str]
    # The heading that a prior is centred on, degrees clockwise from north.
    prior_centre_deg: ClassVar[float]

    def __init__(
        self, config: DataConfig, part: str = "train", bad_samples: BadSamples | None = None
    ):
        if part not in PARTS:
            raise DatasetError(f"part is {part!r}; it must be one of {', '.join(PARTS)}")
        if not Path(config.root).is_dir():
            raise DatasetError(
                f"{config.root}: there is no such folder; name the root of the data tree"
            )
        self.config = config
        self.part = part
        self.bad_samples = bad_samples
        self.aerial_size = config.aerial_size
        self.names: list[str] = []
        self.tile_metres = np.empty(0)
        prior = config.heading_prior_deg
        unknown = prior is None or prior == 180
        self.heading_prior_deg = None if unknown else (self.prior_centre_deg, float(prior))
        self._symmetries = [symmetry for symmetry in SYMMETRIES if self._keeps(symmetry)]
        # In shared memory: workers that live on from epoch to epoch see the change.
        self._epoch = torch.zeros((), dtype=torch.int64).share_memory_()

    def set_epoch(self, epoch: int) -> None:
        """Let training draw for this epoch; call it before the epoch's iterator is made."""
        self._epoch.fill_(epoch)

    def pose(self, index: int) -> np.ndarray:
        """The true pose of a sample, float64 [3] of u, v, heading_deg, without its images."""
        pose = self._pose(index)
        return self._symmetry(index).pose(pose) if self._augmented else pose

    def load(self, index: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Ground float32 [3, Hg, Wg] and aerial float32 [3, A, A] of a sample.

        Raises
        ------
        SampleError
            If a file of the sample cannot be used.
        """
        ground, aerial = self._load(index)
        if not self._augmented:
            return ground, aerial
        symmetry = self._symmetry(index)
        if symmetry.turn[0] < 0:
            ground = ground.flip(-1)
        aerial = torch.from_numpy(np.ascontiguousarray(symmetry.masks(aerial.numpy())))
        return recolour(ground, aerial, self._random(index, "colours"))

    def _pose(self, index: int) -> np.ndarray:
        """`pose` as the data set has it."""
        raise NotImplementedError

    def _load(self, index: int) -> tuple[torch.Tensor, torch.Tensor]:
        """`load` as the data set has it."""
        raise NotImplementedError

    @property
    def _augmented(self) -> bool:
        return self.config.augment and self.part == "train"

    def _symmetry(self, index: int) -> Symmetry:
        """The symmetry that a sample is shown under in this epoch."""
        chosen = self._random(index, "symmetry").integers(len(self._symmetries))
        return self._symmetries[chosen]

    def _keeps(self, symmetry: Symmetry) -> bool:
        """Whether a symmetry maps the extent and the priors onto themselves."""
        u0, v0, u1, v1 = self.config.extent
        heading_deg = self.prior_centre_deg
        corners = np.array([[u0, v0, heading_deg], [u1, v1, heading_deg]])
        images = np.array([symmetry.pose(corner) for corner in corners])
        kept = np.allclose(np.sort(images[:, :2], axis=0), corners[:, :2], rtol=0, atol=1e-9)
        if self.config.place_prior is not None:
            pose = np.array([*self.config.place_prior[:2], heading_deg])
            kept &= np.allclose(symmetry.pose(pose)[:2], pose[:2], rtol=0, atol=1e-9)
        return kept and (self.heading_prior_deg is None or images[0, 2] == heading_deg)

    def poses(self) -> np.ndarray:
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
        u0, v0, u1, v1 = extent
        u, v, _ = self.poses()[slice(None) if indices is None else indices].T
        outside = (u < u0) | (u > u1) | (v < v0) | (v > v1)
        if place_prior is not None:
            outside |= ~in_place_prior(u, v, place_prior)
        return int(np.count_nonzero(outside))

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: int) -> dict[str, Any] | None:
        training = self.part == "train"
        for step in range(len(self) if training else 1):
            at = (index + step) % len(self)
            try:
                ground, aerial = self.load(at)
            except SampleError as error:
                if self.bad_samples is None:
                    raise
                self.bad_samples.record(self.names[at], error)
                continue
            return {
                "ground": ground,
                "aerial": aerial,
                "pose": torch.from_numpy(self.pose(at)),
                "metres_per_pixel": float(self.tile_metres[at] / self.aerial_size),
                "name": self.names[at],
                "index": at,
            }
        if training:
            raise DatasetError(
                f"none of the {len(self)} samples can be read; see {self.bad_samples.path}"
            )
        return None

    def _random(self, index: int, purpose: str = "") -> np.random.Generator:
        """Random numbers of one sample for one purpose, in training of one sample in one epoch."""
        epoch = int(self._epoch) + 1 if self.part == "train" else 0
        return np.random.default_rng(
            [self.config.seed, epoch, zlib.crc32((self.names[index] + purpose).encode())]
        )

    def _choose_part(self, count: int) -> np.ndarray:
        """Which of the training file's `count` samples this part takes: sorted indices."""
        order = np.random.default_rng(self.config.seed).permutation(count)
        held_out = round(count * self.config.validation_fraction)
        return np.sort(order[:held_out] if self.part == "validation" else order[held_out:])

    def _check_not_empty(self) -> None:
        if not self.names:
            raise DatasetError(
                f"the {self.part} part of {self.config.root} holds no sample; check the split, the "
                f"cities and validation_fraction, which is {self.config.validation_fraction:g}"
            )


def collate(samples: list[dict[str, Any] | None]) -> dict[str, Any] | None:
    """Stack samples into a batch, leaving out those that could not be read; None if all were."""
    read = [sample for sample in samples if sample is not None]
    return default_collate(read) if read else None


def read_lines(path: Path, what: str, hint: str) -> list[str]:
    """Read the lines of a label file; the last one may lack its newline.

    Raises
    ------
    DatasetError
        If the file is missing, empty or no text; `what` it is and a `hint` go into the text.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise DatasetError(f"{path}: {what} is missing; {hint}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(f"{path}: {what} cannot be read as text ({error})") from error
    if not text.strip():
        raise DatasetError(f"{path}: {what} is empty; fetch it anew")
    return text.rstrip("\n").split("\n")
