"""A run folder: what training leaves behind, and all that evaluation and prediction need.

``config.yaml``
    The settings, complete (`slicematch.runs.config.TrainConfig`).
``metrics.jsonl``
    One line of JSON an epoch.
``checkpoints/best.ckpt``, ``checkpoints/last.ckpt``
    Weights, and in the last one everything that resuming takes. Both are read with torch's
    ``weights_only=True``, so that opening a run from elsewhere runs nothing that it holds.
``calibration.json``
    The temperature that makes scores probabilities (`slicematch.evaluation.calibration`).
``stages.json``
    What its encoders give of its images, so that loading need not find out. It may be missing.
``members/``, ``ensemble.json``
    Of an ensemble (`slicematch.runs.packed`): further networks that answer with this one, each a
    packed run, and the temperature of their scores together.
``tensorboard/``, ``heat_maps/``, ``bad_samples.jsonl``, ``evaluation/``
    Curves, an example of each epoch, unreadable samples, and results.
"""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast, get_args

import torch
from safetensors.torch import load_file

from slicemask import PoseGrid
from slicemask.files import write_text
from slicemask.geometry.frustum import Projection
from slicematch.data.elevations import image_elevations
from slicematch.errors import RunError
from slicematch.network.bands import RangeBands
from slicematch.network.slicematch import SliceMatch
from slicematch.network.stages import Stages
from slicematch.runs.config import TrainConfig
from slicematch.runs.recipes import find_recipe
from slicematch.runs.settings import read_settings
from slicematch.runs.shipped import shipped_runs

Checkpoint = Literal["best", "last"]

# Settings that the file of every run holds, of any version, from its first line to its last ones.
_IN_EVERY_RUN = (
    *("data", "root", "split", "extent", "train_grid", "test_grid", "hfov_deg", "encoder"),
    *("stride", "ground_size", "aerial_size", "slices", "tau", "learning_rate", "batch_size"),
    *("epochs", "seed", "workers", "precision", "accelerator", "devices"),
)


@dataclass(frozen=True)
class FittedTemperature:
    """A temperature, and what gave the scores that it was fitted to, under the run's own priors.

    Parameters
    ----------
    temperature : float
        Greater than 0.
    grid : PoseGrid
        Of the candidates.
    checkpoint : {"best", "last"}
        Of the weights.
    members : tuple of float
        Of an ensemble, its networks' own temperatures at that time.
    """

    temperature: float
    grid: PoseGrid
    checkpoint: Checkpoint
    members: tuple[float, ...] = ()

    def matches(
        self, grid: PoseGrid, checkpoint: Checkpoint, members: tuple[float, ...] = ()
    ) -> bool:
        """Whether scores of these candidates and weights are those that it was fitted to."""
        return (grid, checkpoint, members) == (self.grid, self.checkpoint, self.members)


@dataclass(frozen=True)
class RunFolder:
    """The names of a run's files; see this module's text.

    Parameters
    ----------
    path : Path
        The folder.
    """

    path: Path

    @property
    def config_file(self) -> Path:
        """The settings."""
        return self.path / "config.yaml"

    @property
    def metrics_file(self) -> Path:
        """The metrics of each epoch."""
        return self.path / "metrics.jsonl"

    @property
    def bad_samples_file(self) -> Path:
        """Samples that could not be read in training."""
        return self.path / "bad_samples.jsonl"

    @property
    def calibration_file(self) -> Path:
        """The temperature, and how it was fitted."""
        return self.path / "calibration.json"

    @property
    def ensemble_file(self) -> Path:
        """The temperature of an ensemble's scores, and how it was fitted."""
        return self.path / "ensemble.json"

    @property
    def members_folder(self) -> Path:
        """Where the further networks of an ensemble are."""
        return self.path / "members"

    def members(self) -> list["RunFolder"]:
        """The further networks of an ensemble, in the order of their names; of others none.

        Raises
        ------
        RunError
            If the run is what is left of an ensemble.
        """
        folders = sorted(path for path in self.members_folder.glob("*") if path.is_dir())
        if self.ensemble_file.is_file() and not folders:
            raise RunError(
                f"{self.ensemble_file}: is of an ensemble, and {self.members_folder} holds no "
                "network; copy the ensemble whole, or remove the file"
            )
        return [RunFolder(folder) for folder in folders]

    @property
    def stages_file(self) -> Path:
        """The stages of its encoders."""
        return self.path / "stages.json"

    @property
    def packed_weights(self) -> Path:
        """The weights of a packed run (`slicematch.runs.packed`)."""
        return self.path / "weights.safetensors"

    def checkpoint(self, which: str) -> Path:
        """The checkpoint "best" or "last"; a packed run's weights are its best."""
        path = self.path / "checkpoints" / f"{which}.ckpt"
        packed = which == "best" and self.packed_weights.is_file() and not path.exists()
        return self.packed_weights if packed else path

    def load_config(self) -> TrainConfig:
        """The run's settings.

        Raises
        ------
        RunError
            If the folder is no run, or its settings are cut short.
        ConfigError
            If its settings are unreadable.
        """
        if not self.config_file.is_file():
            raise RunError(
                f"{self.path}: is no run folder, since it has no {self.config_file.name}; name "
                f"one that `slicemask train` wrote{_or_shipped()}"
            )
        return TrainConfig.load(self.config_file, self.read_settings())

    def read_settings(self) -> dict[str, Any]:
        """The run's settings as they stand in its file, of any version.

        Raises
        ------
        RunError
            If the file is cut short, so that defaults would stand in for the run's own settings.
        ConfigError
            If it is unreadable.
        """
        settings = read_settings(self.config_file)
        missing = [name for name in _IN_EVERY_RUN if name not in settings]
        if not missing and self.config_file.read_bytes().endswith(b"\n"):
            return settings
        lack = f"it lacks {missing[0]}" if missing else "its last line has no end"
        raise RunError(
            f"{self.config_file}: is cut short, {lack}; put the run's own file back, or train into "
            "another folder"
        )

    def load_metrics(self) -> list[dict[str, Any]]:
        """The metrics of each epoch, in order; a line that a crash has spoilt is passed over."""
        try:
            lines = self.metrics_file.read_bytes().splitlines(keepends=True)
        except FileNotFoundError:
            return []
        return [entry for entry in map(_metrics, lines) if entry is not None]

    def load_calibration(
        self, config: TrainConfig, ensemble: bool = False
    ) -> FittedTemperature | None:
        """The temperature that was fitted to the scores of the run, of these settings, if any was.

        Parameters
        ----------
        config : TrainConfig
            The run's settings.
        ensemble : bool
            Of the scores that all networks of an ensemble give together, instead of the first's.

        Raises
        ------
        RunError
            If the file that should hold it does not.
        """
        file = self.ensemble_file if ensemble else self.calibration_file
        again = "write it again with `slicemask calibrate`"
        if not ensemble and self.members():  # which `calibrate` fits to all of them together
            again = "pack the run again"
        try:
            content = json.loads(file.read_text("utf-8"))
            temperature, checkpoint = content["temperature"], content["checkpoint"]
            if not (isinstance(temperature, float) and 0.0 < temperature < math.inf):
                raise ValueError(f"temperature is {temperature!r}")
            if checkpoint not in get_args(Checkpoint):
                raise ValueError(f"checkpoint is {checkpoint!r}")
            grid = config.grid("test_grid", str(content["grid"]))
            members = tuple(map(float, content.get("members", ())))
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            raise RunError(
                f"{file}: holds no temperature greater than 0 with its grid and "
                f"checkpoint ({error!r}); remove it, or {again}"
            ) from error
        return FittedTemperature(temperature, grid, checkpoint, members)

    def save_stages(self, model: SliceMatch) -> None:
        """Keep what the encoders of a model give."""
        content = [stages.to_dict() for stages in model.stages]
        write_text(self.stages_file, json.dumps(content) + "\n", RunError)

    def load_stages(self) -> tuple[Stages, Stages] | None:
        """What its encoders give, if that was kept; what cannot be read is found out again."""
        try:
            ground, aerial = json.loads(self.stages_file.read_text("utf-8"))
            return Stages.from_dict(ground), Stages.from_dict(aerial)
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            return None

    def load_model(self, which: Checkpoint = "best") -> tuple[TrainConfig, SliceMatch]:
        """The run's settings and its model with trained weights, on the CPU, set to evaluate.

        Raises
        ------
        RunError
            If the folder is no run, or the checkpoint is missing, is not safe to read, does not
            fit the settings or is that of a run that diverged.
        """
        config = self.load_config()
        path = self.checkpoint(which)
        content = read_checkpoint(path)
        known = self.load_stages()
        try:
            model = build_model(config, "none", known)
            load_weights(model, content, path)
        except Exception:  # timm's of stages that a backbone lacks, or ours of weights
            if known is None:
                raise
            model = build_model(config, "none")
            load_weights(model, content, path)
        return config, model.eval()


def _or_shipped() -> str:
    """The end of a sentence that says what runs there are."""
    names = shipped_runs()
    return f", or {' or '.join(names)}, which comes with slicemask" if names else ""


def _metrics(line: bytes) -> dict[str, Any] | None:
    """What a line of the metrics holds; None if it is not whole."""
    try:
        entry = json.loads(line)
    except (ValueError, RecursionError):
        return None
    whole = line.endswith(b"\n") and isinstance(entry, dict) and isinstance(entry.get("epoch"), int)
    return entry if whole else None


def plan_run(
    settings: Mapping[str, Any],
    config_file: str | Path | None = None,
    out: str | Path | None = None,
    resume: bool = False,
) -> tuple[TrainConfig, Path]:
    """The settings and the folder of a run to train.

    Parameters
    ----------
    settings : mapping
        Settings asked for by name; they go before all others. With ``init``, a run's settings of
        the network stand behind them.
    config_file : path, optional
        A YAML file of further settings.
    out : path, optional
        The run folder; ``runs/<data>`` by default.
    resume : bool
        Take what is still open from the run that is in the folder, if there is one.

    Raises
    ------
    ConfigError
        If a file is unreadable or a setting invalid.
    RunError
        If the settings of the run to resume are cut short.
    """
    asked = {**(read_settings(config_file) if config_file is not None else {}), **settings}
    folder = Path(out) if out is not None else Path("runs", str(asked.get("data", "run")))
    run = RunFolder(folder)
    if resume and run.config_file.is_file():
        # A recipe is asked for as its settings are: those of another run may not change.
        saved, recipe = run.read_settings(), find_recipe(asked.pop("recipe", "paper"))
        asked = {**saved, **recipe.of(saved.get("projection")), **asked}
    elif asked.get("init") is not None:
        from slicematch.runs.start import network_settings  # which needs this file

        asked = {**network_settings(asked["init"]), **asked}
    return TrainConfig.from_dict(asked), folder


def build_model(
    config: TrainConfig,
    weights: str | None = None,
    known: tuple[Stages, Stages] | None = None,
) -> SliceMatch:
    """The model that the settings describe.

    ``weights`` replaces what its encoders start from; ``known`` is what they give, if it is known.
    """
    return SliceMatch(
        encoder=config.encoder,
        weights=config.weights if weights is None else weights,
        ground_size=config.ground_size or config.data_config().ground_size,
        aerial_size=config.aerial_size,
        stride=config.stride,
        pyramid=config.pyramid,
        pyramid_to=config.pyramid_to,
        slices=config.slices,
        cross_view_attention=config.cross_view_attention,
        bands=_range_bands(config),
        known=known,
    )


def _range_bands(config: TrainConfig) -> RangeBands | None:
    """What the network has to know of the settings' bands; None where slices have none."""
    if not config.bands:
        return None
    # As they are once training has completed them.
    height, projection = cast(float, config.camera_height_m), cast(Projection, config.projection)
    shown = config.elevations or image_elevations(
        projection,
        cast(float, config.hfov_deg),
        cast(float, config.ground_aspect),
        config.left_deg,
        config.horizon,
    )
    return RangeBands(
        ranges_m=config.band_ranges_m(),
        camera_height_m=height,
        elevations_deg=shown,
        projection=projection,
        rows=config.band_rows,
        value_maps=config.band_values,
        weights=config.band_weights,
    )


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint's plain content; nothing in the file is run.

    Raises
    ------
    RunError
        If it is missing, broken, or holds anything but plain values and tensors.
    """
    if not path.is_file():
        raise RunError(
            f"{path}: there is no such checkpoint; the run may have stopped before the end of "
            "its first epoch"
        )
    try:
        if path.suffix == ".safetensors":
            return {"state_dict": {key: _widened(value) for key, value in load_file(path).items()}}
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # a hostile or broken file can provoke nearly anything
        reason = str(error).strip().split("\n")[0] or type(error).__name__
        raise RunError(
            f"{path}: is not a checkpoint of plain values and tensors ({reason[:200]}); nothing "
            "in it was run; take a checkpoint that slicemask wrote"
        ) from error
    if not (isinstance(content, dict) and isinstance(content.get("state_dict"), Mapping)):
        raise RunError(f"{path}: holds no weights; take a checkpoint that slicemask wrote")
    return content


def _widened(tensor: torch.Tensor) -> torch.Tensor:
    """Half precision is for files alone."""
    return tensor.float() if tensor.is_floating_point() else tensor


def load_weights(model: SliceMatch, content: Mapping[str, Any], path: Path) -> None:
    """Give a model the weights of a checkpoint that was read from a path.

    Raises
    ------
    RunError
        If they do not fit the model, or are not finite.
    """
    weights = {key.removeprefix("model."): value for key, value in content["state_dict"].items()}
    # Runs of 0.1 also hold blocks that no feature needs.
    held = model.state_dict().keys()
    weights = {
        key: value
        for key, value in weights.items()
        if key in held or not re.match(r"\w+_encoder\.backbone\.blocks\.\d+\.", key)
    }
    try:
        model.load_state_dict(weights)
    except (RuntimeError, TypeError, AttributeError) as error:
        reason = " ".join(str(error).split())
        raise RunError(
            f"{path}: does not fit the run's config.yaml ({reason[:200]}); both must come from "
            "the same run"
        ) from error
    if not all(bool(value.isfinite().all()) for value in weights.values()):
        raise RunError(
            f"{path}: holds weights that are not finite numbers, so the run has diverged; train "
            "again with a lower learning rate"
        )
