"""Poses of ground images in aerial tiles, from a trained run."""

import hashlib
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from model.config import TrainConfig
from model.data import normalise, read_image
from model.data.images import check_shape, resize, turn_panorama
from model.data.kitti import GROUND_ASPECT
from model.errors import ConfigError
from model.runs import Checkpoint, RunFolder, choose_device
from model.scoring import Candidates
from model.slicematch import SliceMatch
from slicemask import Frustum, PoseGrid, build_bank, open_bank

Picture = str | Path | Image.Image | NDArray[np.uint8]
# Tiles whose features are kept; those of VGG16 take 2 MB each.
_TILES_KEPT = 8


@dataclass(frozen=True)
class Estimate:
    """Where a ground image was taken.

    Attributes
    ----------
    pose : float64 [3]
        u, v, heading_deg of the best candidate.
    score : float
        Its score, a cosine in [-1, 1].
    scores : float32 [rows, columns, headings]
        Scores of all candidates; -inf where a prior left one out.
    grid : PoseGrid
        Where the candidates stand.
    tile_pixels : int
        Side of the aerial tile as it was handed in.
    """

    pose: NDArray[np.float64]
    score: float
    scores: NDArray[np.float32]
    grid: PoseGrid
    tile_pixels: int

    @property
    def heat_map(self) -> NDArray[np.float32]:
        """Best score at each place over the headings, float32 [rows, columns]."""
        return self.scores.max(axis=-1)

    def offset_m(self, metres_per_pixel: float) -> tuple[float, float]:
        """Metres (east, north) from the tile's centre to the camera.

        Parameters
        ----------
        metres_per_pixel : float
            Of the tile as it was handed in, north up.
        """
        if not (np.isfinite(metres_per_pixel) and metres_per_pixel > 0):
            raise ConfigError(
                f"metres per pixel is {metres_per_pixel!r}; it must be greater than 0"
            )
        side = self.tile_pixels * metres_per_pixel
        return float((self.pose[0] - 0.5) * side), float((0.5 - self.pose[1]) * side)

    def as_dict(self, metres_per_pixel: float | None = None) -> dict[str, float]:
        """u, v, heading_deg and score, and with a resolution also east_m and north_m."""
        u, v, heading_deg = (float(value) for value in self.pose)
        content = {"u": u, "v": v, "heading_deg": heading_deg, "score": self.score}
        if metres_per_pixel is not None:
            content["east_m"], content["north_m"] = self.offset_m(metres_per_pixel)
        return content


@dataclass(frozen=True)
class AerialTile:
    """An aerial tile, encoded once for many ground images; made by `Localizer.encode_aerial`.

    Attributes
    ----------
    features : float [1, C, L, L]
        z_a.
    pixels : int
        Side of the tile as it was handed in.
    """

    features: torch.Tensor
    pixels: int


class Localizer:
    """Answers where ground images were taken, with a trained model and a bank of candidates.

    Make one with `Localizer.load`.

    Parameters
    ----------
    model : SliceMatch
        Trained, set to evaluate.
    candidates : Candidates
        Of a grid.
    grid : PoseGrid
        That grid.
    config : TrainConfig
        The run's settings.
    device : torch.device
        Where model and candidates are.
    """

    def __init__(
        self,
        model: SliceMatch,
        candidates: Candidates,
        grid: PoseGrid,
        config: TrainConfig,
        device: torch.device,
    ) -> None:
        self.model = model
        self.candidates = candidates
        self.grid = grid
        self.config = config
        self.device = device
        self.frustum: Frustum = config.frustum()
        self._tiles: OrderedDict[bytes, AerialTile] = OrderedDict()

    @classmethod
    def load(
        cls,
        run: str | Path,
        bank: str | Path | None = None,
        *,
        grid: str | None = None,
        checkpoint: Checkpoint = "best",
        device: str = "auto",
        cache: str | Path | None = None,
    ) -> "Localizer":
        """Load a run; nothing that its files may hold is run.

        Parameters
        ----------
        run : path
            A run folder.
        bank : path, optional
            The bank of candidates; by default that of the grid, built if the cache lacks it.
        grid : str, optional
            Candidates such as "21x21x64"; the run's test grid by default.
        checkpoint : {"best", "last"}
            Which weights.
        device : str
            "auto", "cpu", "cuda", ...
        cache : path, optional
            The folder of banks, as for `slicemask.build_bank`.

        Raises
        ------
        RunError
            If the run cannot be loaded.
        ConfigError
            If the bank does not fit the run, or both bank and grid are given.
        BankError
            If the bank cannot be read.
        """
        if bank is not None and grid is not None:
            raise ConfigError("give either a bank or a grid; a bank has its own grid")
        config, model = RunFolder(Path(run)).load_model(checkpoint)
        chosen = choose_device(device)
        if bank is None:
            poses = config.grid("test_grid", grid)
            bank = build_bank(poses, config.frustum(), model.cells, cache=cache).path
        candidates, poses = load_candidates(bank, config.frustum(), model.cells)
        return cls(model.to(chosen), candidates.to(chosen), poses, config, chosen)

    def encode_aerial(self, aerial: Picture) -> AerialTile:
        """Encode an aerial tile, for use with many ground images.

        Parameters
        ----------
        aerial : path, PIL image or uint8 [A, A, 3]
            A square tile, north up (for a KITTI run: as KITTI's crops are turned). Tiles met
            lately are known again by their pixels and not encoded anew.

        Raises
        ------
        ImageError
            If the image cannot be read or is not square.
        """
        image = _picture(aerial, 1.0, "an aerial tile")
        key = hashlib.sha256(repr(image.size).encode() + image.tobytes()).digest()
        if key not in self._tiles:
            size = self.config.aerial_size
            images = normalise(resize(image, (size, size)))[None].to(self.device)
            with torch.no_grad():
                features = self.model.encode_aerial(images)
            self._tiles[key] = AerialTile(features, image.width)
            while len(self._tiles) > _TILES_KEPT:
                self._tiles.popitem(last=False)
        self._tiles.move_to_end(key)
        return self._tiles[key]

    def localize(
        self,
        ground: Picture,
        aerial: Picture | AerialTile,
        heading_prior_deg: tuple[float, float] | None = None,
        place_prior: tuple[float, float, float] | None = None,
    ) -> Estimate:
        """Find the pose of a ground image in an aerial tile.

        Parameters
        ----------
        ground : path, PIL image or uint8 [height, width, 3]
            A panorama (VIGOR runs) or a camera image (KITTI runs). The heading found is that of
            its centre column.
        aerial : path, PIL image, uint8 [A, A, 3], or what `encode_aerial` gives
            The tile.
        heading_prior_deg : (centre, half_width), optional
            Only headings within half_width degrees of the centre. By default the prior that the
            run was trained with, if any; (0, 180) allows every heading.
        place_prior : (u, v, radius), optional
            Only places within the radius of (u, v), in the aerial frame. By default the run's.

        Raises
        ------
        ImageError
            If an image cannot be read or has the wrong proportions.
        ConfigError
            If the priors cannot be, or leave no candidate.
        """
        tile = aerial if isinstance(aerial, AerialTile) else self.encode_aerial(aerial)
        candidates = self.within(heading_prior_deg, place_prior)
        with torch.no_grad():
            descriptors = self.model.encode_ground(self._ground(ground))
            scores = self.model.score(descriptors, tile.features, candidates)[0]
        best = int(scores.argmax())
        return Estimate(
            pose=candidates.poses[best].copy(),
            score=float(scores[best]),
            scores=candidates.on_grid(scores[None])[0].cpu().numpy(),
            grid=self.grid,
            tile_pixels=tile.pixels,
        )

    def within(
        self,
        heading_prior_deg: tuple[float, float] | None = None,
        place_prior: tuple[float, float, float] | None = None,
    ) -> Candidates:
        """The candidates that agree with the priors given, or else with the run's own."""
        return self.candidates.within(
            heading_prior_deg or self.config.heading_prior(),
            place_prior or self.config.place_prior,
        )

    def _ground(self, ground: Picture) -> torch.Tensor:
        size = self.config.ground_size
        if self.frustum.projection == "equirectangular":
            image = turn_panorama(_picture(ground, 2.0, "a panorama"), 0.0, size)
        else:
            image = resize(_picture(ground, GROUND_ASPECT, "a ground image"), size)
        return normalise(image)[None].to(self.device)


def load_candidates(path: str | Path, frustum: Frustum, cells: int) -> tuple[Candidates, PoseGrid]:
    """The candidates of a bank, checked against a model, and their grid.

    Raises
    ------
    BankError
        If the bank cannot be read.
    ConfigError
        If it has another frustum or other cells, or holds a list of poses instead of a grid.
    """
    with open_bank(path) as bank:
        spec = bank.spec
        if (spec.frustum, spec.cells) != (frustum, cells):
            raise ConfigError(
                f"{path}: holds {spec.summary()}; the run needs hfov {frustum.hfov_deg} deg "
                f"{frustum.projection}, {frustum.slices} slices and {cells}x{cells} cells"
            )
        if spec.grid is None:
            raise ConfigError(f"{path}: holds a list of poses; a heat map needs the bank of a grid")
        return Candidates.from_bank(bank), spec.grid


def _picture(source: Any, aspect: float, kind: str) -> Image.Image:
    """An RGB image of the right proportions from whatever was handed in."""
    if isinstance(source, str | Path):
        image, name = read_image(source), source
    elif isinstance(source, Image.Image):
        image, name = source.convert("RGB"), "the image"
    else:
        array = np.asarray(source)
        if array.dtype != np.uint8 or array.ndim != 3 or array.shape[2] != 3:
            raise ConfigError(
                f"{kind} is an array {array.dtype} {list(array.shape)}; it must be uint8 "
                "[height, width, 3], a PIL image or a path"
            )
        image, name = Image.fromarray(array), "the image"
    check_shape(image, name, aspect, kind)
    return image
