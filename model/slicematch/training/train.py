"""Training SliceMatch with Lightning.

What is random in an epoch (order, headings, shifts, dropout) is drawn from the seed and the
epoch's number alone, so a run that is resumed from its last finished epoch repeats exactly what
an uninterrupted one does.
"""

import logging
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from slicemask import PoseGrid, build_bank
from slicemask.files import check_folder
from slicemask.progress import TimedLines
from slicematch import _torchvision  # noqa: F401  before lightning: see there
from slicematch.data import OWN
from slicematch.data.dataset import BadSampleLog, PoseDataset
from slicematch.errors import ConfigError, RunError
from slicematch.evaluation.calibration import calibrate
from slicematch.localization.members import load_candidates
from slicematch.network.encoders import encoder_normalisation
from slicematch.network.slicematch import SliceMatch
from slicematch.runs.config import TrainConfig, plain
from slicematch.runs.folder import RunFolder, build_model, load_weights, read_checkpoint
from slicematch.runs.start import start_from
from slicematch.scoring.candidates import Candidates
from slicematch.training.callbacks import make_callbacks
from slicematch.training.loaders import PoseDataModule
from slicematch.training.module import TrainingModule
from slicematch.training.progress import ProgressLines
from slicematch.training.trainer import is_first_process, make_trainer, world_size

import lightning.pytorch as lightning  # isort: skip
from lightning.pytorch.callbacks import RichProgressBar  # isort: skip

log = logging.getLogger(__name__)


# Settings that a resumed run may change: where things are and how long to train, not what.
_MAY_CHANGE_ON_RESUME = (
    "root",
    "split_dir",
    "map",
    "epochs",
    "workers",
    "accelerator",
    "heat_map_every",
    "max_bad_samples",
    "tile_side_m",  # which runs of before do not say, and the data do
    "weights_source",
)


def train(
    config: TrainConfig,
    out: str | Path,
    *,
    dataset: Any = None,
    validation: Any = None,
    resume: bool = False,
    cache: str | Path | None = None,
    progress: bool = True,
) -> Path:
    """Train a model and leave a run folder.

    Parameters
    ----------
    config : TrainConfig
        What to train.
    out : path
        The run folder (`slicematch.runs.folder`), new or empty.
    dataset : torch.utils.data.Dataset, optional
        Samples of the program's own to train on, as `slicematch.PoseDataset` documents them; the
        settings' ``data`` is then "own".
    validation : torch.utils.data.Dataset, optional
        The same to validate with; without them there is no validation.
    resume : bool
        Go on from the last finished epoch of the run that is there, with the same losses as if
        it had never stopped; without one, start. The settings must be those of the run, but for
        where the data lie, how long to train, and the machine's.
    cache : path, optional
        The folder of banks, as for `slicemask.build_bank`.
    progress : bool
        Whether to draw a progress bar; else a line is logged for each epoch, and about every 30
        seconds, at level INFO.

    Returns
    -------
    path : Path
        The run folder.

    Raises
    ------
    RunError
        If the folder holds something already, or another run than the one to resume; or if the
        loss is finite no longer.
    ConfigError, WeightsError, DatasetError
        If the settings, weights or data cannot be used.
    """
    # Lightning introduces itself at length.
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)
    # Everything that can be wrong with the request is found before the folder is touched.
    run = RunFolder(check_folder(out, RunError))
    # The processes of further devices and nodes find the folder that the first one has made.
    if is_first_process(config) and not resume and run.path.exists() and any(run.path.iterdir()):
        raise RunError(
            f"{run.path}: is not empty; go on with the run that is there by --resume, or name "
            "another folder with --out"
        )
    lightning.seed_everything(config.seed, workers=True, verbose=False)
    last = run.checkpoint("last")
    resuming = resume and last.is_file()
    config = _with_normalisation(config, run.load_config() if resuming else None)
    training, validating = _parts(config, dataset, validation)
    datasets = [training] if validating is None else [training, validating]
    config = _with_facts_of_the_data(config, training, run.load_config() if resuming else None)
    if resuming:
        _check_same(run, config)
    # A resumed run takes its weights from the checkpoint; the encoders' own need not be there.
    model = build_model(config, weights="none" if resuming or config.init else None)
    if not resuming:
        source = model.ground_encoder.weights_source
        if config.init is not None:
            start_from(model, config.init)
            source = f"run {Path(config.init).name}"
        config = replace(config, weights_source=source)
    _check_batches(config, model, len(training))
    first_epoch = _finished_epoch(last, model) + 1 if resuming else 0
    train_candidates, test_candidates = (
        _candidates(config, config.grid(name), model.cells, cache)
        for name in ("train_grid", "test_grid")
    )

    callbacks = make_callbacks(run, config, training, validating)
    callbacks.append(
        RichProgressBar(console_kwargs={"stderr": True}) if progress else ProgressLines()
    )
    trainer = make_trainer(config, run, callbacks, progress)

    if is_first_process(config):
        run.path.mkdir(parents=True, exist_ok=True)
        config.save(run.config_file)
        run.save_stages(model)
        if config.weights_source is not None and not resuming:
            log.info("the encoders start from the weights %s", config.weights_source)
        _warn_of_places_outside(config, datasets)
    module = TrainingModule(config, model, train_candidates, test_candidates)
    data = PoseDataModule(
        config,
        training,
        validating,
        first_epoch,
        # Once all processes have met, and the first one has made the folder.
        lambda: BadSampleLog(
            run.bad_samples_file,
            config.max_bad_samples,
            keep=resuming or not is_first_process(config),
        ),
    )
    with warnings.catch_warnings():
        # Of Lightning's own use of torch; the checkpoints folder of a resumed run is not empty.
        warnings.filterwarnings("ignore", message=".*isinstance.treespec, LeafSpec.")
        warnings.filterwarnings("ignore", message="Checkpoint directory .* exists")
        try:
            trainer.fit(
                module, datamodule=data, ckpt_path=last if resuming else None, weights_only=True
            )
        except SystemExit:  # Lightning's way to end on Ctrl-C, without a word
            if trainer.is_global_zero:
                log.warning(
                    "%s: stopped, %s",
                    run.path,
                    "go on after the last epoch that ended by --resume"
                    if last.is_file()
                    else "before an epoch had ended",
                )
            raise
    if trainer.is_global_zero:
        if data.bad_sample_log and (message := data.bad_sample_log.report()):
            log.warning(message)
        if validating is not None:
            device = "cpu" if config.accelerator == "cpu" else "auto"
            calibrate(
                run.path,
                dataset=validation,
                device=device,
                cache=cache,
                progress=TimedLines("calibrating", "samples", log.info),
            )
    return run.path


def _parts(
    config: TrainConfig, dataset: Any, validation: Any
) -> tuple[PoseDataset, PoseDataset | None]:
    """The training and the validation part: the settings', or the program's own."""
    own_samples = dataset is not None
    if own_samples != (config.data == OWN) or (validation is not None and not own_samples):
        raise ConfigError(
            f"data is {config.data!r}; samples of a program's own (dataset=...) go with data "
            f"{OWN!r}, and other data without"
        )
    if dataset is not None:
        own = config.own_dataset
        return own(dataset, "train"), None if validation is None else own(validation, "validation")
    validated = config.validation_fraction > 0
    return config.dataset("train"), config.dataset("validation") if validated else None


def _with_normalisation(config: TrainConfig, before: TrainConfig | None) -> TrainConfig:
    """The settings with the images' mean and deviation: the run's own, or its encoder's."""
    if before is not None:
        mean, std = before.normalisation()
    else:
        mean, std = encoder_normalisation(config.encoder)
    config = replace(
        config, image_mean=config.image_mean or mean, image_std=config.image_std or std
    )
    if before is not None and config.weights_source is None:
        config = replace(config, weights_source=before.weights_source)
    return config


def _with_facts_of_the_data(
    config: TrainConfig, training: PoseDataset, before: TrainConfig | None
) -> TrainConfig:
    """The settings with what only the data say: field of view and size of the tiles.

    A resumed run keeps the size it has, which its bands are shares of.
    """
    side = None if before is None else before.tile_side_m
    own = {name: getattr(training.config, name) for name in training.config.own_settings()}
    if config.hfov_deg is None:
        config = replace(
            config,
            hfov_deg=training.hfov_deg,
            left_deg=training.left_deg,
            horizon=training.horizon,
        )
    return replace(
        config,
        data_settings={name: plain(value) for name, value in own.items()},
        tile_side_m=float(np.median(training.tile_metres)) if side is None else side,
    )


def _check_batches(config: TrainConfig, model: SliceMatch, samples: int) -> None:
    """Refuse a batch that is too small for the encoders, which would end the first epoch."""
    needed = max(stages.smallest_batch for stages in model.stages)
    each = -(-samples // world_size(config))  # the last ones are repeated
    smallest = min(config.batch_size, each % config.batch_size or config.batch_size)
    if smallest < needed:
        raise ConfigError(
            f"batch_size is {config.batch_size}, and of {each} samples a batch of {smallest} is "
            f"left; encoder {config.encoder!r} trains on images this small in batches of {needed} "
            "or more, for its batch normalisation; choose another batch_size or larger images"
        )


def _check_same(run: RunFolder, config: TrainConfig) -> None:
    """Refuse to resume a run with other settings than its own."""
    before, now = _comparable(run.load_config()).flat(), config.flat()
    # A schedule that comes down at the end is laid out for a number of epochs.
    fixed = {"epochs"} if config.schedule != "constant" else set()
    for name, value in now.items():
        if (name not in _MAY_CHANGE_ON_RESUME or name in fixed) and before[name] != value:
            raise RunError(
                f"{run.path}: was trained with {name} {before[name]!r}, and {value!r} is asked "
                "for; resume with the run's own settings, or train into another folder"
            )


def _comparable(config: TrainConfig) -> TrainConfig:
    """A run's settings with what runs of before do not say of themselves."""
    mean, std = config.normalisation()
    return replace(config, image_mean=mean, image_std=std)


def _finished_epoch(checkpoint: Path, model: SliceMatch) -> int:
    """The number of the epoch that a checkpoint was written after, if it can be resumed from."""
    content = read_checkpoint(checkpoint)
    epoch = content.get("epoch")
    if not isinstance(epoch, int) or epoch < 0:
        raise RunError(f"{checkpoint}: names no finished epoch; it cannot be resumed from")
    for part in ("optimizer_states", "lr_schedulers", "loops"):
        if part not in content:
            raise RunError(
                f"{checkpoint}: holds weights but no {part}, so it cannot be resumed from; put the "
                "run's own last.ckpt back, or train into another folder"
            )
    load_weights(model, content, checkpoint)
    return epoch


def _warn_of_places_outside(config: TrainConfig, datasets: list[PoseDataset]) -> None:
    """Say how many true places no candidate can find."""
    datasets = [dataset for dataset in datasets if not dataset.poses_need_images]
    outside = sum(
        dataset.count_outside(config.grid("test_grid").extent, place_prior=config.place_prior)
        for dataset in datasets
    )
    if outside:
        log.warning(
            "%d of the %d true places to train and validate with lie outside the extent or the "
            "place prior, where no candidate can find them",
            outside,
            sum(map(len, datasets)),
        )


def _candidates(
    config: TrainConfig, grid: PoseGrid, cells: int, cache: str | Path | None
) -> Candidates:
    """The grid's candidates within the priors; its bank is built if the cache lacks it."""
    bank = build_bank(grid, config.frustum(), cells, cache=cache).path
    candidates, _ = load_candidates(bank, config.frustum(), cells)
    return candidates.within(config.heading_prior(), config.place_prior)
