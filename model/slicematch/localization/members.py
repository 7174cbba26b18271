"""The networks of a run, each with its own candidates, and the scores that they give together.

A run is one network, or an ensemble of several that see the same images (ours; deep ensembles:
Lakshminarayanan, Pritzel, Blundell, *Simple and Scalable Predictive Uncertainty Estimation*,
NeurIPS 2017). The score of a pose is the mean of theirs, each over its own temperature: the mean of
what they hold for its log-probability. Its scale is that of scores again, within [-1, 1].
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from slicemask import Frustum, PoseGrid, build_bank, open_bank
from slicematch.errors import ConfigError
from slicematch.network.slicematch import SliceMatch
from slicematch.precision import Precision
from slicematch.runs.config import TrainConfig
from slicematch.runs.folder import Checkpoint, RunFolder
from slicematch.scoring.candidates import Candidates
from slicematch.scoring.off_grid import JointScorer, PairScorer
from slicematch.scoring.scores import score_candidates

# What a network has made of images: of an ensemble, what each of its networks has.
Encoded = Tensor | tuple[Tensor, ...]

# Settings that say what a network sees, and which poses it tells apart.
_SEEN = (
    *("projection", "hfov_deg", "left_deg", "horizon", "ground_size", "ground_aspect"),
    *("ground_fit", "elevations", "aerial_size", "extent", "prior_centre_deg"),
    *("heading_half_width_deg", "place_prior"),
)
# How far apart the sizes of tiles on the ground may be: each was measured in its training.
_SIDE_TOLERANCE = 0.02


@dataclass(frozen=True)
class Member:
    """A network with candidates that are laid out for it.

    Attributes
    ----------
    model : SliceMatch
        Trained, set to evaluate.
    candidates : Candidates
        K poses, the same for all members; their masks are this network's.
    frustum : Frustum
        Of the ground images, with this network's slices and bands.
    weight : float
        Of its scores; those of all members sum to 1.
    temperature : float
        That makes its own scores probabilities.
    calibrated : bool
        Whether it was fitted to its scores of these candidates and weights.
    """

    model: SliceMatch
    candidates: Candidates
    frustum: Frustum
    weight: float
    temperature: float
    calibrated: bool


def check_sees_alike(first: TrainConfig, other: TrainConfig, name: str) -> None:
    """Refuse a network that takes other images than the first one of an ensemble.

    Raises
    ------
    ConfigError
        Naming the setting that differs.
    """
    settings = {setting: (getattr(first, setting), getattr(other, setting)) for setting in _SEEN}
    settings["normalisation"] = first.normalisation(), other.normalisation()
    if "kitti" in (first.data, other.data):  # whose tiles are turned with the camera
        settings["data"] = first.data, other.data
    side, other_side = first.tile_side_m, other.tile_side_m
    if side is None or other_side is None or abs(side / other_side - 1) > _SIDE_TOLERANCE:
        settings["tile_side_m"] = side, other_side
    for setting, (ours, theirs) in settings.items():
        if ours != theirs:
            raise ConfigError(
                f"{name}: has {setting} {theirs}, and the run that it is to answer with has "
                f"{ours}; the networks of an ensemble see the same images: train it with that "
                "setting"
            )


def weights_of(temperatures: Sequence[float]) -> tuple[list[float], float]:
    """How much each member's scores count, and the temperature of their weighted sum.

    sum_i w_i c_i / T = 1/M sum_i c_i / T_i, with the w_i summing to 1.

    Parameters
    ----------
    temperatures : sequence of float [M]
        T_i, each fitted to the scores of one member.

    Returns
    -------
    weights : list of float [M]
        w_i, as 1 / T_i.
    temperature : float
        T, the harmonic mean of the T_i.

    Examples
    --------
    >>> weights_of([0.05, 0.15])
    ([0.75, 0.25], 0.075)
    """
    sharpness = [1.0 / temperature for temperature in temperatures]
    total = sum(sharpness)
    return [one / total for one in sharpness], len(sharpness) / total


def joined(parts: Sequence[Tensor]) -> Encoded:
    """One tensor for one network, and a tuple for several."""
    return parts[0] if len(parts) == 1 else tuple(parts)


def parts_of(encoded: Encoded) -> tuple[Tensor, ...]:
    """What each network has made of images, of one network too."""
    return encoded if isinstance(encoded, tuple) else (encoded,)


def only(encoded: Encoded) -> Tensor:
    """What the one network of a run has made of images.

    Raises
    ------
    ConfigError
        If it is an ensemble.
    """
    parts = parts_of(encoded)
    if len(parts) > 1:
        raise ConfigError(
            f"the run is an ensemble of {len(parts)} networks, and this takes one: hand in "
            "localizer.alone()"
        )
    return parts[0]


@dataclass(frozen=True)
class EncodedPairs:
    """Pairs of images as each network sees them: S pairs, M members.

    Attributes
    ----------
    members : tuple of Member [M]
    ground : tuple of float [S, N * B, C]
        d_g^{n,b} of each.
    aerial : tuple of float [S, C, L, L]
        z_a of each.
    attention : tuple of float [S, N * B, L, L] or [S, 1, L, L]
        M_a^{n,b} of each.
    """

    members: tuple[Member, ...]
    ground: tuple[Tensor, ...]
    aerial: tuple[Tensor, ...]
    attention: tuple[Tensor, ...]

    @classmethod
    def of(cls, members: tuple[Member, ...], ground: Encoded, aerial: Encoded) -> "EncodedPairs":
        """Attend to encoded images.

        Raises
        ------
        ConfigError
            If they were encoded by other networks.
        """
        grounds, aerials = parts_of(ground), parts_of(aerial)
        if not len(grounds) == len(aerials) == len(members):
            raise ConfigError(
                f"images were encoded by {len(grounds)} and {len(aerials)} networks, and the run "
                f"has {len(members)}; encode both with this localizer"
            )
        attention = tuple(
            member.model.attend(*pair)
            for member, *pair in zip(members, aerials, grounds, strict=True)
        )
        return cls(members, grounds, aerials, attention)

    def scores(self, candidates: Sequence[Candidates]) -> Tensor:
        """Scores [S, K] of candidates, given as each member has them laid out."""
        scored = [
            score_candidates(ground, aerial, attention, some)
            for ground, aerial, attention, some in zip(
                self.ground, self.aerial, self.attention, candidates, strict=True
            )
        ]
        if len(scored) == 1:
            return scored[0]
        weights = [member.weight for member in self.members]
        return torch.stack([weight * one for weight, one in zip(weights, scored, strict=True)]).sum(
            dim=0
        )

    def scorer(self, pair: int) -> PairScorer | JointScorer:
        """The score of any pose for one of the pairs."""
        scorers = [
            PairScorer(ground[pair], aerial[pair], attention[pair], member.frustum)
            for member, ground, aerial, attention in zip(
                self.members, self.ground, self.aerial, self.attention, strict=True
            )
        ]
        if len(scorers) == 1:
            return scorers[0]
        return JointScorer(tuple(scorers), tuple(member.weight for member in self.members))


def load_members(
    folders: Sequence[RunFolder],
    bank: str | Path | None,
    grid: str | None,
    checkpoint: Checkpoint,
    device: torch.device,
    precision: Precision,
    cache: str | Path | None,
) -> tuple[list[Member], PoseGrid, TrainConfig]:
    """Load networks that answer together, their candidates' grid, and the first one's settings.

    Parameters
    ----------
    folders : sequence of RunFolder
        The first network's, whose checkpoint is asked for, and packed ones.
    bank, grid, checkpoint, device, precision, cache
        As `Localizer.load` takes them.

    Raises
    ------
    RunError, ConfigError, BankError
        As there.
    """
    loaded = [
        folder.load_model(checkpoint if number == 0 else "best")
        for number, folder in enumerate(folders)
    ]
    first, model = loaded[0]
    for folder, (config, _) in zip(folders[1:], loaded[1:], strict=True):
        check_sees_alike(first, config, str(folder.path))
    if bank is None:
        bank = build_bank(
            first.grid("test_grid", grid), first.frustum(), model.cells, cache=cache
        ).path
    candidates, poses = load_candidates(bank, first.frustum(), model.cells)
    # Networks with the same masks share them.
    laid_out = {(first.frustum(), model.cells): candidates.to(device)}
    for config, model in loaded:
        model.for_inference(device, precision)
        masks = config.frustum(), model.cells
        if masks not in laid_out:
            bank = build_bank(poses, *masks, cache=cache).path
            laid_out[masks] = load_candidates(bank, *masks)[0].to(device)
    fitted = [
        folder.load_calibration(config) for folder, (config, _) in zip(folders, loaded, strict=True)
    ]
    # Fitted temperatures and the loss's cannot be weighed against each other.
    all_fitted = all(one is not None for one in fitted)
    temperatures = [
        one.temperature if all_fitted and one is not None else config.tau
        for one, (config, _) in zip(fitted, loaded, strict=True)
    ]
    weights, _ = weights_of(temperatures)
    members = [
        Member(
            model,
            laid_out[config.frustum(), model.cells],
            config.frustum(),
            weights[number],
            temperatures[number],
            calibrated=all_fitted
            and (one := fitted[number]) is not None
            and one.matches(poses, checkpoint if number == 0 else "best"),
        )
        for number, (config, model) in enumerate(loaded)
    ]
    return members, poses, first


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
            left = "" if frustum.left_deg is None else f" from {frustum.left_deg:g}"
            raise ConfigError(
                f"{path}: holds {spec.summary()}; the run needs hfov {frustum.hfov_deg:g} deg"
                f"{left} {frustum.projection}, {frustum.slices} slices and {cells}x{cells} cells: "
                "name such a bank, or none"
            )
        if spec.grid is None:
            raise ConfigError(f"{path}: holds a list of poses; a heat map needs the bank of a grid")
        return Candidates.from_bank(bank), spec.grid
