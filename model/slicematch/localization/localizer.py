"""Poses of ground images in aerial tiles, from a trained run."""

import hashlib
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from slicemask import Frustum, PoseGrid, build_bank, open_bank
from slicemask.images import Picture, check_aspect, name_of, read_aerial, read_image, resize
from slicematch.data.images import normalise
from slicematch.data.panoramas import read_panorama, turn_panorama
from slicematch.devices import Precision, choose_device
from slicematch.errors import ConfigError
from slicematch.localization.probabilities import (
    covariance,
    mean_poses,
    mode_probabilities,
    probabilities,
)
from slicematch.localization.refinement import (
    DEFAULT,
    Domain,
    Refine,
    Similarity,
    check_refine,
    find_modes,
    keep_apart,
    near,
    refine_modes,
)
from slicematch.network.slicematch import SliceMatch
from slicematch.runs.config import TrainConfig
from slicematch.runs.folder import Checkpoint, RunFolder
from slicematch.scoring.candidates import Candidates
from slicematch.scoring.scores import score_candidates

# Tiles whose features are kept; those of VGG16 take 2 MB each.
_TILES_KEPT = 8
# Metres per pixel: beyond these no picture is one of a camera's surroundings.
_FINEST_RESOLUTION, _COARSEST_RESOLUTION = 1e-4, 1e3


@dataclass(frozen=True)
class Mode:
    """One answer among several: a peak of the scores.

    Attributes
    ----------
    pose : float64 [3]
        u, v, heading_deg.
    score : float
        Its score, a cosine in [-1, 1].
    probability : float
        That the camera is within reach of it: the candidates there, less those that a better
        mode has, count together.
    """

    pose: NDArray[np.float64]
    score: float
    probability: float


@dataclass(frozen=True)
class Estimate:
    """Where a ground image was taken, and how sure that is.

    Attributes
    ----------
    modes : tuple of Mode
        Best first, each beyond reach of every better one; the first one is the answer. Means are
        as good as the best candidates around which they are taken, others as their own scores.
    scores : float32 [rows, columns, headings]
        Scores of all candidates; -inf where a prior left one out.
    grid : PoseGrid
        Where the candidates stand.
    tile_pixels : int
        Side of the aerial tile as it was handed in.
    temperature : float
        That makes the scores probabilities (`slicematch.localization.probabilities`).
    """

    modes: tuple[Mode, ...]
    scores: NDArray[np.float32]
    grid: PoseGrid
    tile_pixels: int
    temperature: float

    @property
    def pose(self) -> NDArray[np.float64]:
        """u, v, heading_deg of the answer, float64 [3]."""
        return self.modes[0].pose

    @property
    def score(self) -> float:
        """The answer's score, a cosine in [-1, 1]."""
        return self.modes[0].score

    @property
    def heat_map(self) -> NDArray[np.float32]:
        """Best score at each place over the headings, float32 [rows, columns]."""
        return self.scores.max(axis=-1)

    @cached_property
    def probabilities(self) -> NDArray[np.float64]:
        """Probabilities of all candidates, 1 in all: float64 [rows, columns, headings]."""
        return probabilities(self.scores, self.temperature)

    @property
    def place_map(self) -> NDArray[np.float64]:
        """Probabilities of the places, over all headings: float64 [rows, columns]."""
        return self.probabilities.sum(axis=-1)

    def covariance(self, metres_per_pixel: float | None = None) -> NDArray[np.float64]:
        """How candidates within reach of the answer spread about it: float64 [3, 3].

        Parameters
        ----------
        metres_per_pixel : float, optional
            Of the tile as it was handed in.

        Returns
        -------
        covariance : float64 [3, 3]
            Of east, north (metres, or shares of the tile's side if no resolution is given) and
            heading (degrees).
        """
        poses = self.grid.poses()
        around = near(self.pose, poses, self.grid)
        moments = covariance(
            self.pose, poses[around], self.probabilities.ravel()[around], self.grid
        )
        scale = np.ones(3)
        if metres_per_pixel is not None:
            scale[:2] = self._side_m(metres_per_pixel)
        return moments * np.outer(scale, scale)

    def offset_m(self, metres_per_pixel: float) -> tuple[float, float]:
        """Metres (east, north) from the tile's centre to the camera.

        Parameters
        ----------
        metres_per_pixel : float
            Of the tile as it was handed in, north up.
        """
        return self._offset_m(self.pose, metres_per_pixel)

    def as_dict(
        self,
        metres_per_pixel: float | None = None,
        centre: tuple[float, float] | None = None,
    ) -> dict[str, Any]:
        """The estimate as plain values, for JSON.

        Parameters
        ----------
        metres_per_pixel : float, optional
            Of the tile as it was handed in, north up: adds east_m and north_m.
        centre : (latitude, longitude), optional
            Of the tile, degrees; with a resolution it adds latitude and longitude.

        Returns
        -------
        content : dict
            u, v, heading_deg, score and probability of the answer, what was asked to be added,
            its covariance (`covariance`), the temperature, and the same of the other_modes.
        """
        best, *others = (self._mode_dict(mode, metres_per_pixel, centre) for mode in self.modes)
        return {
            **best,
            "covariance": self.covariance(metres_per_pixel).tolist(),
            "temperature": self.temperature,
            "other_modes": others,
        }

    def _mode_dict(
        self, mode: Mode, metres_per_pixel: float | None, centre: tuple[float, float] | None
    ) -> dict[str, float]:
        u, v, heading_deg = (float(value) for value in mode.pose)
        content = {"u": u, "v": v, "heading_deg": heading_deg}
        content |= {"score": mode.score, "probability": mode.probability}
        if metres_per_pixel is not None:
            east_m, north_m = self._offset_m(mode.pose, metres_per_pixel)
            content |= {"east_m": east_m, "north_m": north_m}
            if centre is not None:
                from slicematch.localization.geodesy import offset_position

                latitude, longitude = offset_position(centre, east_m, north_m)
                content |= {"latitude": latitude, "longitude": longitude}
        elif centre is not None:
            raise ConfigError(
                "the tile's centre alone gives no latitude and longitude; give its metres per "
                "pixel too"
            )
        return content

    def _offset_m(self, pose: NDArray[np.float64], metres_per_pixel: float) -> tuple[float, float]:
        side = self._side_m(metres_per_pixel)
        return float((pose[0] - 0.5) * side), float((0.5 - pose[1]) * side)

    def _side_m(self, metres_per_pixel: float) -> float:
        return self.tile_pixels * check_resolution(metres_per_pixel)


def check_resolution(metres_per_pixel: float) -> float:
    """The metres per pixel, or ConfigError if they cannot be."""
    if not _FINEST_RESOLUTION <= metres_per_pixel <= _COARSEST_RESOLUTION:
        raise ConfigError(
            f"metres per pixel is {metres_per_pixel!r}; it must be from {_FINEST_RESOLUTION:g} to "
            f"{_COARSEST_RESOLUTION:g}"
        )
    return float(metres_per_pixel)


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
    refine : {"none", "mean", "fine", "continuous"}
        How estimates are refined, unless `localize` is told otherwise.
    temperature : float, optional
        That makes scores probabilities; the loss's tau by default.
    calibrated : bool
        Whether it was fitted to scores of these candidates and weights.
    """

    def __init__(
        self,
        model: SliceMatch,
        candidates: Candidates,
        grid: PoseGrid,
        config: TrainConfig,
        device: torch.device,
        refine: Refine = DEFAULT,
        temperature: float | None = None,
        calibrated: bool = False,
    ) -> None:
        self.model = model
        self.candidates = candidates
        self.grid = grid
        self.config = config
        self.device = device
        self.refine = check_refine(refine)
        self.calibrated = calibrated
        self.temperature = config.tau if temperature is None else temperature
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
        refine: Refine = DEFAULT,
        precision: Precision = "32-true",
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
            As for `choose_device`.
        cache : path, optional
            The folder of banks, as for `slicemask.build_bank`.
        refine : {"none", "mean", "fine", "continuous"}
            How estimates are refined: not at all, the best candidate is the answer; the mean of
            the candidates around it, by their probabilities; coarse to fine; or that and then by
            gradients.
        precision : {"32-true", "16-mixed", "bf16-mixed"}
            In which the encoders compute; all else is float32. With fewer bits they are faster on
            GPUs and new CPUs, and their features good to two or three digits; "16-mixed" is for
            GPUs only.

        Raises
        ------
        RunError
            If the run cannot be loaded.
        ConfigError
            If the bank does not fit the run, both bank and grid are given, or there is no such
            device or precision.
        BankError
            If the bank cannot be read.
        """
        if bank is not None and grid is not None:
            raise ConfigError("give either a bank or a grid; a bank has its own grid")
        folder = RunFolder(Path(run))
        config, model = folder.load_model(checkpoint)
        fitted = folder.load_calibration(config)
        chosen = choose_device(device)
        model.for_inference(chosen, precision)
        if bank is None:
            poses = config.grid("test_grid", grid)
            bank = build_bank(poses, config.frustum(), model.cells, cache=cache).path
        candidates, poses = load_candidates(bank, config.frustum(), model.cells)
        return cls(
            model,
            candidates.to(chosen),
            poses,
            config,
            chosen,
            refine,
            None if fitted is None else fitted.temperature,
            calibrated=fitted is not None and fitted.matches(poses, checkpoint),
        )

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
        image = read_aerial(aerial)
        key = hashlib.sha256(repr(image.size).encode() + image.tobytes()).digest()
        if key not in self._tiles:
            size = self.config.aerial_size
            images = normalise(resize(image, (size, size)), *self.config.normalisation())
            images = images[None].to(self.device)
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
        heading_prior: tuple[float, float] | None = None,
        place_prior: tuple[float, float, float] | None = None,
        *,
        refine: Refine | None = None,
        metres_per_pixel: float | None = None,
    ) -> Estimate:
        """Find the pose of a ground image in an aerial tile.

        Parameters
        ----------
        ground : path, PIL image or uint8 [height, width, 3]
            A panorama (VIGOR runs) or a camera image (KITTI runs). The heading found is that of
            its centre column.
        aerial : path, PIL image, uint8 [A, A, 3], or what `encode_aerial` gives
            The tile.
        heading_prior : (centre, half_width), optional
            Only headings within half_width degrees of the centre. By default the prior that the
            run was trained with, if any; (0, 180) allows every heading.
        place_prior : (u, v, radius), optional
            Only places within the radius of (u, v), in the aerial frame. By default the run's.
        refine : {"none", "mean", "fine", "continuous"}, optional
            The localizer's own by default.
        metres_per_pixel : float, optional
            Of the tile as it is handed in; the finest step is then in metres.

        Raises
        ------
        ImageError
            If an image cannot be read or has the wrong proportions.
        ConfigError
            If the priors cannot be, or leave no candidate.
        """
        tile = aerial if isinstance(aerial, AerialTile) else self.encode_aerial(aerial)
        tile_metres = None
        if metres_per_pixel is not None:
            tile_metres = [tile.pixels * check_resolution(metres_per_pixel)]
        with torch.no_grad():
            descriptors = self.model.encode_ground(self._ground(ground))
        (estimate,) = self.estimate(
            descriptors,
            tile.features,
            [tile.pixels],
            tile_metres,
            heading_prior,
            place_prior,
            refine,
        )
        return estimate

    def estimate(
        self,
        ground: torch.Tensor,
        aerial: torch.Tensor,
        tile_pixels: Sequence[int],
        tile_metres: Sequence[float] | None = None,
        heading_prior: tuple[float, float] | None = None,
        place_prior: tuple[float, float, float] | None = None,
        refine: Refine | None = None,
    ) -> list[Estimate]:
        """Find the poses of encoded images; what `localize` does after encoding.

        Parameters
        ----------
        ground : float [B, N, C]
            d_g^n, what the model's `encode_ground` gives.
        aerial : float [B, C, L, L]
            z_a, what its `encode_aerial` gives.
        tile_pixels : int [B]
            Side of each tile as it was handed in.
        tile_metres : float [B], optional
            Side of each tile on the ground.
        heading_prior, place_prior, refine
            As in `localize`.
        """
        refine = check_refine(refine or self.refine)
        candidates = self.within(heading_prior, place_prior)
        domain = Domain(self.grid.extent, *self._priors(heading_prior, place_prior))
        with torch.no_grad():
            attention = self.model.attend(aerial, ground)
            scored = score_candidates(ground, aerial, attention, candidates)
            scores = candidates.scatter_to_grid(scored).cpu().numpy()
        estimates = []
        for b in range(len(scores)):
            similarity = Similarity(ground[b], aerial[b], attention[b], self.frustum)
            poses, values = find_modes(scores[b], self.grid)
            likely = probabilities(scores[b], self.temperature)
            if refine == "mean":
                # A mean lies in the domain but for rounding.
                means = domain.project(torch.from_numpy(mean_poses(poses, likely, self.grid)))
                # In the order of the best candidates: a mean's own score says less of its mode.
                poses, _ = keep_apart(means.numpy(), values, self.grid)
                with torch.no_grad():
                    values = similarity(torch.from_numpy(poses)).double().cpu().numpy()
            elif refine != "none":
                metres = None if tile_metres is None else float(tile_metres[b])
                poses, values = refine_modes(similarity, poses, self.grid, domain, refine, metres)
            shares = mode_probabilities(poses, likely, self.grid)
            modes = map(Mode, poses, values.tolist(), shares.tolist())
            estimates.append(
                Estimate(tuple(modes), scores[b], self.grid, int(tile_pixels[b]), self.temperature)
            )
        return estimates

    def within(
        self,
        heading_prior: tuple[float, float] | None = None,
        place_prior: tuple[float, float, float] | None = None,
    ) -> Candidates:
        """The candidates that agree with the priors given, or else with the run's own."""
        return self.candidates.within(*self._priors(heading_prior, place_prior))

    def _priors(
        self,
        heading_prior: tuple[float, float] | None,
        place_prior: tuple[float, float, float] | None,
    ) -> tuple[tuple[float, float] | None, tuple[float, float, float] | None]:
        """The priors given, or else the run's own."""
        return (
            heading_prior or self.config.heading_prior(),
            place_prior or self.config.place_prior,
        )

    def _ground(self, ground: Picture) -> torch.Tensor:
        size = self.config.ground_size
        if self.frustum.projection == "equirectangular":
            image = turn_panorama(read_panorama(ground).image, 0.0, size)
        else:
            image = read_image(ground)
            if self.config.ground_aspect is not None:
                check_aspect(image, name_of(ground), self.config.ground_aspect, "a ground image")
            image = resize(image, size)
        return normalise(image, *self.config.normalisation())[None].to(self.device)


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
                f"{path}: holds {spec.summary()}; the run needs hfov {frustum.hfov_deg:g} deg "
                f"{frustum.projection}, {frustum.slices} slices and {cells}x{cells} cells: name "
                "such a bank, or none"
            )
        if spec.grid is None:
            raise ConfigError(f"{path}: holds a list of poses; a heat map needs the bank of a grid")
        return Candidates.from_bank(bank), spec.grid
