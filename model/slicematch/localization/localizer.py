"""Poses of ground images in aerial tiles, from a trained run."""

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from PIL import Image

from slicemask import Frustum, PoseGrid
from slicemask.images import Picture, name_of, read_aerial
from slicematch.devices import choose_device
from slicematch.errors import ConfigError
from slicematch.localization.estimate import Estimate
from slicematch.localization.inputs import GroundImages, aerial_pixels
from slicematch.localization.members import (
    Encoded,
    EncodedPairs,
    Member,
    joined,
    load_members,
    weights_of,
)
from slicematch.localization.modes import Mode, check_scores, find_modes
from slicematch.localization.probabilities import mode_probabilities, probabilities
from slicematch.localization.refinement import (
    DEFAULT,
    Refine,
    check_refine,
    mean_modes,
    refine_modes,
)
from slicematch.localization.tiles import AerialTile, trained_window
from slicematch.precision import Precision
from slicematch.priors import PosePrior
from slicematch.runs.config import TrainConfig
from slicematch.runs.folder import Checkpoint, RunFolder
from slicematch.runs.shipped import find_run
from slicematch.scoring.candidates import Candidates
from slicematch.scoring.off_grid import JointScorer, PairScorer

log = logging.getLogger(__name__)

HeadingPrior = tuple[float, float]
PlacePrior = tuple[float, float, float]
# Sets of candidates that are kept, each with its plan of pooling, for priors that come again.
_PRIORS_KEPT = 8
# How far the compass of a phone or a camera may be off.
COMPASS_DEG = 30.0


class Localizer:
    """Answers where ground images were taken, with a trained model and a bank of candidates.

    Make one with `Localizer.load`.

    Parameters
    ----------
    members : sequence of Member
        The run's network, or those of an ensemble.
    grid : PoseGrid
        Of their candidates.
    config : TrainConfig
        The run's settings, of an ensemble its first network's.
    device : torch.device
        Where models and candidates are.
    refine : {"none", "mean", "fine", "continuous"}
        How estimates are refined, unless `localize` is told otherwise.
    temperature : float, optional
        That makes scores probabilities; the loss's tau by default.
    calibrated : bool
        Whether it was fitted to scores of these candidates and weights.

    Attributes
    ----------
    model : SliceMatch
        The run's network, of an ensemble the first.
    candidates : Candidates
        As it has them laid out.
    frustum : Frustum
        With its slices and bands.
    """

    def __init__(
        self,
        members: Sequence[Member],
        grid: PoseGrid,
        config: TrainConfig,
        device: torch.device,
        refine: Refine = DEFAULT,
        temperature: float | None = None,
        calibrated: bool = False,
    ) -> None:
        self.members = tuple(members)
        self.model = members[0].model
        self.candidates = members[0].candidates
        self.frustum: Frustum = members[0].frustum
        self.grid = grid
        self.config = config
        self.device = device
        self.refine = check_refine(refine)
        self.calibrated = calibrated
        self.temperature = config.tau if temperature is None else temperature
        self.tile_side_m: float | None = config.tile_side_m
        self._ground_images = GroundImages(config, self.frustum)
        self._within: dict[tuple[HeadingPrior | None, PlacePrior | None], list[Candidates]] = {}

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
        alone: bool = False,
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
            "auto" (CUDA where it is there, else the CPU), "cpu", "cuda" or "cuda:N".
        cache : path, optional
            The folder of banks; SLICEMASK_CACHE or ``./masks_cache`` by default.
        refine : {"none", "mean", "fine", "continuous"}
            How estimates are refined: not at all, the best candidate is the answer; to the
            likeliest pose, a mean of candidates; coarse to fine; or that and then by gradients.
        precision : {"32-true", "16-mixed", "bf16-mixed"}
            In which the encoders compute; all else is float32. With fewer bits they are faster on
            GPUs and new CPUs, and their features good to two or three digits; "16-mixed" is for
            GPUs only.
        alone : bool
            Of an ensemble, load its first network alone: half the time or less, and other answers.

        Raises
        ------
        RunError
            If the run cannot be loaded.
        ConfigError
            If the bank does not fit the run, both bank and grid are given, there is no such device
            or precision, or the networks of an ensemble take different images.
        BankError
            If the bank cannot be read.
        """
        if bank is not None and grid is not None:
            raise ConfigError("give either a bank or a grid; a bank has its own grid")
        folder, chosen = RunFolder(find_run(run)), choose_device(device)
        folders = [folder] if alone else [folder, *folder.members()]
        members, poses, config = load_members(
            folders, bank, grid, checkpoint, chosen, precision, cache
        )
        own = tuple(member.temperature for member in members)
        _, temperature = weights_of(own)
        calibrated = members[0].calibrated
        if len(members) > 1:
            fitted = folder.load_calibration(config, ensemble=True)
            calibrated = fitted is not None and fitted.matches(poses, checkpoint, own)
            temperature = temperature if fitted is None else fitted.temperature
        return cls(members, poses, config, chosen, refine, temperature, calibrated)

    def alone(self) -> "Localizer":
        """One that answers with the first network of an ensemble; of one network, itself."""
        if len(self.members) == 1:
            return self
        first = replace(self.members[0], weight=1.0)
        return Localizer(
            [first],
            self.grid,
            self.config,
            self.device,
            self.refine,
            first.temperature,
            first.calibrated,
        )

    def encode_aerial(
        self, aerial: Picture, *, metres_per_pixel: float | None = None
    ) -> AerialTile:
        """Encode an aerial tile, for use with many ground images.

        Parameters
        ----------
        aerial : path, PIL image or uint8 [A, A, 3]
            A square tile, north up (for a KITTI run: as KITTI's crops are turned); channels are
            red, green, blue.
        metres_per_pixel : float, optional
            Of the tile as it is handed in. Of a tile that is larger on the ground than those that
            the run was trained with, only the middle is then searched, and said so.

        Returns
        -------
        tile : AerialTile
            For `localize`, any number of times.

        Raises
        ------
        ImageError
            If the image cannot be read or is not square.
        ConfigError
            If the tile is more than twice as large or small on the ground as the run's.
        """
        image = read_aerial(aerial)
        window = trained_window(image.width, metres_per_pixel, self.tile_side_m)
        features = self.encode_aerial_pixels(aerial_pixels(window.crop(image), self.config))
        return AerialTile(features, image.width, metres_per_pixel, window)

    def encode_ground(self, ground: Picture) -> Encoded:
        """Encode a ground image, for `pair_scorer`, or for `estimate` with tiles of any number.

        Parameters
        ----------
        ground : path, PIL image or uint8 [height, width, 3]
            As `localize` takes it.

        Returns
        -------
        descriptors : float [1, N * B, C]
            d_g^{n,b}; of an ensemble a tuple with those of each network.

        Raises
        ------
        ImageError
            If the image cannot be read or has the wrong proportions.
        """
        return self.encode_ground_pixels(self._ground_images.pixels(self.read_ground(ground)))

    def encode_ground_pixels(self, images: torch.Tensor) -> Encoded:
        """Encode ground images [S, 3, height, width] of the run's size, normalised for it."""
        images = images.to(self.device)
        with torch.no_grad():
            return joined([member.model.encode_ground(images) for member in self.members])

    def encode_aerial_pixels(self, images: torch.Tensor) -> Encoded:
        """Encode aerial images [S, 3, A, A] of the run's size, normalised for it."""
        images = images.to(self.device)
        with torch.no_grad():
            return joined([member.model.encode_aerial(images) for member in self.members])

    def pair_scorer(self, ground: Encoded, tile: AerialTile) -> PairScorer | JointScorer:
        """The score of any pose for one pair of images, and what each slice adds to it.

        Parameters
        ----------
        ground
            What `encode_ground` gives.
        tile : AerialTile
            What `encode_aerial` gives. Poses are in the frame of its window.

        Returns
        -------
        PairScorer or, of an ensemble, JointScorer
            For poses on and off the grid.
        """
        with torch.no_grad():
            return EncodedPairs.of(self.members, ground, tile.features).scorer(0)

    def localize(
        self,
        ground: Picture,
        aerial: Picture | AerialTile,
        heading_prior: HeadingPrior | None = None,
        place_prior: PlacePrior | None = None,
        *,
        refine: Refine | None = None,
        metres_per_pixel: float | None = None,
    ) -> Estimate:
        """Find the pose of a ground image in an aerial tile.

        Parameters
        ----------
        ground : path, PIL image or uint8 [height, width, 3]
            A panorama (VIGOR runs) or a camera image (KITTI runs). The heading found is that of
            its centre column, of a camera image that of its optical axis. Channels are red, green,
            blue: an image that OpenCV has read is turned round by ``[..., ::-1]``.
        aerial : path, PIL image, uint8 [A, A, 3], or what `encode_aerial` gives
            The tile.
        heading_prior : (centre, half_width), optional
            Only headings within half_width degrees of the centre. By default the prior that the
            run was trained with, if any, or else 30 degrees around the heading that a panorama's
            own data give (GPano's PoseHeadingDegrees); (0, 180) allows every heading.
        place_prior : (u, v, radius), optional
            Only places within the radius of (u, v), in the aerial frame. By default the run's.
        refine : {"none", "mean", "fine", "continuous"}, optional
            The localizer's own by default.
        metres_per_pixel : float, optional
            Of the tile as it is handed in; by default what `encode_aerial` was told. The finest
            step is then in metres, and the tile's size on the ground is held against the run's.

        Returns
        -------
        estimate : Estimate
            In the frame of the tile as it was handed in.

        Raises
        ------
        ImageError
            If an image cannot be read or has the wrong proportions.
        ConfigError
            If the priors are invalid or leave no candidate, or the tile is more than twice as
            large or small on the ground as the run's.
        """
        tile = (
            aerial
            if isinstance(aerial, AerialTile)
            else self.encode_aerial(aerial, metres_per_pixel=metres_per_pixel)
        )
        if metres_per_pixel is not None and metres_per_pixel != tile.metres_per_pixel:
            trained_window(tile.pixels, metres_per_pixel, self.tile_side_m, crop=False)
            tile = replace(tile, metres_per_pixel=metres_per_pixel)
        image, facing_deg = self._ground_images.read(ground)
        if facing_deg is not None and heading_prior is None and self.config.heading_prior() is None:
            heading_prior = facing_deg, COMPASS_DEG
            log.warning(
                "%s: only headings within %g degrees of the %g that its own data give are searched"
                "; a heading prior of 0,180 allows all",
                name_of(ground),
                COMPASS_DEG,
                facing_deg,
            )
        descriptors = self.encode_ground_pixels(self._ground_images.pixels(image))
        (estimate,) = self.estimate(
            descriptors,
            tile.features,
            [tile.pixels],
            None if tile.side_m is None else [tile.side_m],
            heading_prior,
            tile.window.place_prior(place_prior),
            refine,
        )
        window = tile.window
        return replace(
            estimate,
            modes=tuple(
                replace(mode, pose=window.pose_in_tile(mode.pose)) for mode in estimate.modes
            ),
            grid=window.grid_in_tile(estimate.grid),
            metres_per_pixel=tile.metres_per_pixel,
            searched=window.side,
        )

    def estimate(
        self,
        ground: Encoded,
        aerial: Encoded,
        tile_pixels: Sequence[int],
        tile_metres: Sequence[float] | None = None,
        heading_prior: HeadingPrior | None = None,
        place_prior: PlacePrior | None = None,
        refine: Refine | None = None,
    ) -> list[Estimate]:
        """Find the poses of encoded images; what `localize` does after encoding.

        Parameters
        ----------
        ground : float [S, N * B, C]
            d_g^{n,b}, what `encode_ground` and `encode_ground_pixels` give.
        aerial : float [S, C, L, L]
            z_a, what `encode_aerial_pixels` gives.
        tile_pixels : int [S]
            Side of each tile as it was handed in.
        tile_metres : float [S], optional
            Side of each tile on the ground.
        heading_prior : (centre, half_width), optional
            Only headings within half_width degrees of the centre; the run's own by default.
        place_prior : (u, v, radius), optional
            Only places within the radius of (u, v), in the aerial frame; the run's by default.
        refine : {"none", "mean", "fine", "continuous"}, optional
            The localizer's own by default.

        Returns
        -------
        estimates : list of Estimate
            One a pair.

        Raises
        ------
        ConfigError
            If the priors are invalid or leave no candidate.
        RunError
            If scores are not finite.
        """
        refine = check_refine(refine or self.refine)
        heading_prior, place_prior = self._priors(heading_prior, place_prior)
        candidates = self._each_within(heading_prior, place_prior)
        prior = PosePrior(self.grid.extent, heading_prior, place_prior)
        with torch.no_grad():
            pairs = EncodedPairs.of(self.members, ground, aerial)
            scores = candidates[0].scatter_to_grid(pairs.scores(candidates)).cpu().numpy()
        estimates = []
        for s in range(len(scores)):
            check_scores(scores[s])
            likely = probabilities(scores[s], self.temperature)
            scorer = pairs.scorer(s)
            if refine == "mean":
                poses, values = mean_modes(scorer, likely, self.grid, prior)
            else:
                poses, values = find_modes(scores[s], self.grid)
                if refine != "none":
                    metres = None if tile_metres is None else float(tile_metres[s])
                    poses, values = refine_modes(scorer, poses, self.grid, prior, refine, metres)
            reached = mode_probabilities(poses, likely, self.grid)
            modes = map(Mode, poses, values.tolist(), reached.tolist())
            estimates.append(
                Estimate(tuple(modes), scores[s], self.grid, int(tile_pixels[s]), self.temperature)
            )
        return estimates

    def within(
        self,
        heading_prior: HeadingPrior | None = None,
        place_prior: PlacePrior | None = None,
    ) -> Candidates:
        """The candidates that agree with the priors given, or else with the run's own.

        Of an ensemble, as its first network has them laid out.
        """
        return self._each_within(heading_prior, place_prior)[0]

    def scores(self, ground: torch.Tensor, aerial: torch.Tensor) -> torch.Tensor:
        """Scores of all candidates within the run's own priors.

        Parameters
        ----------
        ground : float [S, 3, height, width]
            Normalised, as `encode_ground_pixels` takes them.
        aerial : float [S, 3, A, A]
            As `encode_aerial_pixels` takes them.

        Returns
        -------
        scores : float [S, K]
            In the order of ``within().poses``.
        """
        encoded = self.encode_ground_pixels(ground), self.encode_aerial_pixels(aerial)
        with torch.no_grad():
            return EncodedPairs.of(self.members, *encoded).scores(self._each_within(None, None))

    def _each_within(
        self, heading_prior: HeadingPrior | None, place_prior: PlacePrior | None
    ) -> list[Candidates]:
        """The candidates within priors, as each network has them laid out.

        Those of the last few priors are kept: laying out their masks again for each image would
        take a fifth as long as scoring them (measured on a CPU, 3,000 to 4,000 poses).
        """
        key = self._priors(heading_prior, place_prior)
        if key not in self._within:
            _warn_of_slips(*key)
            # Networks that take the same masks share them.
            each = {id(one.candidates): one.candidates for one in self.members}
            fitting = {number: one.within(*key) for number, one in each.items()}
            found = [fitting[id(member.candidates)] for member in self.members]
            if len(self._within) >= _PRIORS_KEPT:
                del self._within[next(iter(self._within))]  # the oldest
            self._within[key] = found
        return self._within[key]

    def _priors(
        self, heading_prior: HeadingPrior | None, place_prior: PlacePrior | None
    ) -> tuple[HeadingPrior | None, PlacePrior | None]:
        """The priors given, or else the run's own, as tuples of floats."""
        heading = self.config.heading_prior() if heading_prior is None else heading_prior
        place = self.config.place_prior if place_prior is None else place_prior
        return _as_floats(heading), _as_floats(place)

    def read_ground(self, ground: Picture) -> Image.Image:
        """Read a ground image, checked, as the run takes it: a panorama as a whole sphere.

        Raises
        ------
        ImageError
            If it cannot be read or has the wrong proportions.
        """
        return self._ground_images.read(ground)[0]

    def shown(self, image: Image.Image) -> Image.Image:
        """The columns of a ground image that the run's slices are cut from, for a picture."""
        return self._ground_images.shown(image)


def _as_floats(prior: Any) -> Any:
    return None if prior is None else tuple(float(value) for value in prior)


def _warn_of_slips(heading_prior: HeadingPrior | None, place_prior: PlacePrior | None) -> None:
    """Warn of priors that are valid and almost surely not what was meant."""
    if place_prior is not None and place_prior[-1] > 1.0:
        log.warning(
            "place prior %s has a radius of %g tile sides, so that it leaves out next to nothing; "
            "u, v and the radius are in shares of the tile's side, not in metres or pixels",
            ",".join(f"{value:g}" for value in place_prior),
            place_prior[-1],
        )
    if heading_prior is not None and heading_prior[-1] > 180.0:
        log.warning(
            "heading prior %s has a half width beyond 180 degrees, so that it allows every heading",
            ",".join(f"{value:g}" for value in heading_prior),
        )
