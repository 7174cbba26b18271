"""Training SliceMatch with Lightning.

What is random in an epoch (order, headings, shifts, dropout) is drawn from the seed and the
epoch's number alone, so a run that is resumed from its last finished epoch repeats exactly what
an uninterrupted one does.
"""

import json
import logging
import os
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DistributedSampler

from slicemask import PoseGrid, build_bank, slice_masks
from slicemask.files import check_folder, write_text
from slicemask.plot import save_figure
from slicemask.threads import thread_count
from slicematch import _torchvision  # noqa: F401  before lightning: see there
from slicematch.data.dataset import BadSampleLog, PoseDataset, collate
from slicematch.data.images import denormalise
from slicematch.data.loading import PoseLoader
from slicematch.devices import device_name
from slicematch.errors import ConfigError, RunError
from slicematch.evaluation.calibration import calibrate
from slicematch.evaluation.drawing import draw_estimate
from slicematch.evaluation.metrics import pose_errors
from slicematch.localization.localizer import load_candidates
from slicematch.network.slicematch import SliceMatch
from slicematch.priors import PosePrior
from slicematch.runs.config import TrainConfig
from slicematch.runs.folder import RunFolder, build_model, load_weights, read_checkpoint
from slicematch.scoring.candidates import Candidates
from slicematch.scoring.scores import heat_map, score_candidates, score_masks
from slicematch.training.losses import contrastive_loss
from slicematch.training.negatives import jittered_candidates, near_poses

import lightning.pytorch as lightning  # isort: skip
from lightning.pytorch.callbacks import ModelCheckpoint, RichProgressBar  # isort: skip
from lightning.pytorch.loggers import TensorBoardLogger  # isort: skip
from lightning.pytorch.utilities.exceptions import MisconfigurationException  # isort: skip

log = logging.getLogger(__name__)


# Settings that a resumed run may change: where things are and how long to train, not what.
_FREE = (
    "root",
    "split_dir",
    "epochs",
    "workers",
    "accelerator",
    "heat_map_every",
    "max_bad_samples",
)


def train(
    config: TrainConfig,
    out: str | Path,
    *,
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
    resume : bool
        Go on from the last finished epoch of the run that is there, with the same losses as if
        it had never stopped; without one, start. The settings must be those of the run, but for
        where the data lie, how long to train, and the machine's.
    cache : path, optional
        The folder of banks, as for `slicemask.build_bank`.
    progress : bool
        Whether to draw a progress bar.

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
    # The processes of further devices find the folder that the first one has made.
    if is_first_process() and not resume and run.path.exists() and any(run.path.iterdir()):
        raise RunError(
            f"{run.path}: is not empty; go on with the run that is there by --resume, or name "
            "another folder with --out"
        )
    lightning.seed_everything(config.seed, workers=True, verbose=False)
    training = config.dataset("train")
    validation = config.dataset("validation") if config.validation_fraction > 0 else None
    datasets = [training] if validation is None else [training, validation]
    if config.hfov_deg is None:
        config = replace(config, hfov_deg=training.hfov_deg)
    last = run.checkpoint("last")
    resuming = resume and last.is_file()
    if resuming:
        _check_same(run, config)
    # A resumed run takes its weights from the checkpoint; the encoders' own need not be there.
    model = build_model(config, weights="none" if resuming else None)
    first_epoch = _finished_epoch(last, model) + 1 if resuming else 0
    grids = {name: config.grid(name) for name in ("train_grid", "test_grid")}
    train_candidates, test_candidates = (
        _candidates(config, grid, model.cells, cache) for grid in grids.values()
    )

    callbacks = [*_checkpoints(run, validated=validation is not None), _Metrics(run), _Moved()]
    if config.heat_map_every:
        shown = training if validation is None else validation
        callbacks.append(_Example(run, shown, grids["test_grid"], config.heat_map_every))
    if progress:
        callbacks.append(RichProgressBar(console_kwargs={"stderr": True}))
    trainer = _trainer(config, run, callbacks, progress)

    if is_first_process():
        run.path.mkdir(parents=True, exist_ok=True)
        config.save(run.config_file)
        _warn_of_places_outside(config, datasets)
    bad_sample_log = BadSampleLog(
        run.bad_samples_file, config.max_bad_samples, keep=resuming or not is_first_process()
    )
    for dataset in datasets:
        dataset.bad_sample_log = bad_sample_log
    module = TrainingModule(config, model, train_candidates, test_candidates)
    data = _Data(config, training, validation, first_epoch)
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
        if message := bad_sample_log.report():
            log.warning(message)
        if validation is not None:
            device = "cpu" if config.accelerator == "cpu" else "auto"
            calibrate(run.path, device=device, cache=cache)
    return run.path


def is_first_process() -> bool:
    """Whether this is the process that was started, not one that Lightning adds for a device."""
    return os.environ.get("LOCAL_RANK", "0") == "0"


def _check_same(run: RunFolder, config: TrainConfig) -> None:
    """Refuse to resume a run with other settings than its own."""
    before, now = run.load_config().flat(), config.flat()
    # A schedule that comes down at the end is laid out for a number of epochs.
    fixed = {"epochs"} if config.schedule != "constant" else set()
    for name, value in now.items():
        if (name not in _FREE or name in fixed) and before[name] != value:
            raise RunError(
                f"{run.path}: was trained with {name} {before[name]!r}, and {value!r} is asked "
                "for; resume with the run's own settings, or train into another folder"
            )


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
    outside = sum(
        dataset.count_outside(config.extent, place_prior=config.place_prior) for dataset in datasets
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


def _checkpoints(run: RunFolder, validated: bool) -> list[lightning.Callback]:
    best, last = run.checkpoint("best"), run.checkpoint("last")
    shared = {"enable_version_counter": False, "save_on_train_epoch_end": True}
    return [
        ModelCheckpoint(
            dirpath=best.parent,
            filename=best.stem,
            monitor="validation/place_mean_m" if validated else "train/loss_epoch",
            save_weights_only=True,
            **shared,
        ),
        ModelCheckpoint(dirpath=last.parent, filename=last.stem, **shared),
    ]


def _trainer(
    config: TrainConfig, run: RunFolder, callbacks: list[lightning.Callback], progress: bool
) -> lightning.Trainer:
    accelerator = device_name(config.accelerator)
    processors = thread_count(None)
    if accelerator == "cpu" and config.devices > processors:
        raise ConfigError(
            f"devices is {config.devices}; on the CPU each is a process, so it must be at most "
            f"{processors}, the number of processors"
        )
    try:
        return lightning.Trainer(
            default_root_dir=run.path,
            max_epochs=config.epochs,
            accelerator=accelerator,
            devices=config.devices,
            # Some backbones have parameters beyond the stage they are cut at.
            strategy="ddp_find_unused_parameters_true" if config.devices > 1 else "auto",
            precision=config.precision,
            logger=TensorBoardLogger(run.path, name="tensorboard", version=""),
            callbacks=callbacks,
            enable_progress_bar=progress,
            enable_model_summary=False,
            num_sanity_val_steps=0,
            limit_val_batches=1.0 if config.validation_fraction > 0 else 0,
            log_every_n_steps=1,
            use_distributed_sampler=False,  # the loaders have their own
        )
    except (MisconfigurationException, ValueError) as error:
        reason = " ".join(str(error).split())
        raise ConfigError(
            f"accelerator {config.accelerator!r} with {config.devices} devices and precision "
            f"{config.precision!r} cannot be used here ({reason})"
        ) from error


class TrainingModule(lightning.LightningModule):
    """SliceMatch with its loss and optimiser.

    Parameters
    ----------
    config : TrainConfig
        With `hfov_deg` known.
    model : SliceMatch
        What is trained.
    train_candidates, test_candidates : Candidates
        Of the training and the test grid, within the priors.
    """

    def __init__(
        self,
        config: TrainConfig,
        model: SliceMatch,
        train_candidates: Candidates,
        test_candidates: Candidates,
    ) -> None:
        super().__init__()
        self.config = config
        self.model = model
        self.frustum = config.frustum()
        self.train_candidates = train_candidates
        self.test_candidates = test_candidates
        self.train_grid = config.grid("train_grid")
        self.prior = PosePrior(config.extent, config.heading_prior(), config.place_prior)
        self.jittered_candidates: list[Candidates] = []
        if config.grid_jitter:
            self.jittered_candidates = jittered_candidates(
                train_candidates.poses,
                self.train_grid,
                self.prior,
                self.frustum,
                model.cells,
                config.seed,
            )
        self._estimates: list[tuple[Tensor, ...]] = []

    def configure_optimizers(self) -> torch.optim.Optimizer | dict[str, Any]:
        """Adam, as in the paper, with its constant learning rate or the one-cycle schedule."""
        optimizer = torch.optim.Adam(self.parameters(), lr=self.config.learning_rate)
        if self.config.schedule == "constant":
            return optimizer
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimizer,
            max_lr=self.config.learning_rate,
            total_steps=int(self.trainer.estimated_stepping_batches),
            pct_start=0.1,
            cycle_momentum=False,  # the betas are Adam's own throughout
        )
        return {
            "optimizer": optimizer,
            "lr_scheduler": {"scheduler": schedule, "interval": "step"},
        }

    def on_fit_start(self) -> None:
        """Bring the candidates to the model's device."""
        self.train_candidates = self.train_candidates.to(self.device)
        self.test_candidates = self.test_candidates.to(self.device)
        self.jittered_candidates = [some.to(self.device) for some in self.jittered_candidates]

    def on_train_epoch_start(self) -> None:
        """Let the epoch's draws depend on the seed and the epoch's number alone."""
        self.trainer.datamodule.training.set_epoch(self.current_epoch)
        state = [self.config.seed, self.current_epoch, self.global_rank]
        torch.manual_seed(int(np.random.SeedSequence(state).generate_state(1)[0]))

    def training_step(self, batch: dict[str, Any], _: int) -> Tensor:
        """Loss of a batch: the exact true pose against the training grid (eq. 1)."""
        ground = self.model.encode_ground(batch["ground"])
        aerial = self.model.encode_aerial(batch["aerial"])
        attention = self.model.attend(aerial, ground)
        masks = slice_masks(batch["pose"], self.frustum, self.model.cells, engine="rays")
        truth = score_masks(ground, aerial, attention, masks[:, None])[:, 0]
        scores = score_candidates(ground, aerial, attention, self._negatives())
        if self.config.near_negatives:
            near = near_poses(
                batch["pose"],
                self.config.near_negatives,
                self.train_grid,
                self.prior,
            )
            masks = slice_masks(near.flatten(0, 1), self.frustum, self.model.cells, engine="rays")
            masks = masks.unflatten(0, near.shape[:2])
            scores = torch.cat([scores, score_masks(ground, aerial, attention, masks)], dim=1)
        loss = contrastive_loss(truth, scores, self.config.alpha, self.config.tau).mean()
        self._check_finite("training loss", loss)
        self.log(
            "train/loss",
            loss,
            on_step=True,
            on_epoch=True,
            prog_bar=True,
            batch_size=len(ground),
            sync_dist=True,
        )
        return loss

    def _check_finite(self, what: str, values: Tensor) -> None:
        """Stop where numbers are finite no longer, before a checkpoint is written."""
        finite = bool(values.isfinite().all())
        # All devices stop together: one that went on would wait for the others for ever.
        if not self.trainer.strategy.reduce_boolean_decision(finite):
            raise RunError(
                f"the {what} of epoch {self.current_epoch} is not finite: training with "
                f"learning_rate {self.config.learning_rate:g} has diverged; the checkpoints of "
                "epochs before, if any, are kept; train into another folder with a lower "
                "learning_rate"
            )

    def _negatives(self) -> Candidates:
        """The training grid, or one of its offsets at random."""
        if not self.jittered_candidates:
            return self.train_candidates
        count = len(self.jittered_candidates)
        return self.jittered_candidates[int(torch.randint(count, ()))]

    def validation_step(self, batch: dict[str, Any] | None, _: int) -> None:
        """Estimates of a batch on the test grid."""
        if batch is None:  # no sample of it could be read
            return
        scores = self.model(batch["ground"], batch["aerial"], self.test_candidates)
        best = scores.max(dim=1)
        estimates = torch.from_numpy(self.test_candidates.poses)[best.indices.cpu()]
        metres = batch["metres_per_pixel"].cpu() * batch["aerial"].shape[-1]
        self._estimates.append((best.values.cpu(), estimates, batch["pose"].cpu(), metres))

    def on_validation_epoch_end(self) -> None:
        """Log mean and median errors."""
        if not self._estimates:
            return
        scores, estimates, truths, metres = (
            torch.cat(parts) for parts in zip(*self._estimates, strict=True)
        )
        self._estimates.clear()
        self._check_finite("validation score", scores)
        found = pose_errors(estimates.numpy(), truths.numpy(), metres.numpy()).summary()
        for name, value in found.items():
            if "recall" not in name:
                self.log(
                    f"validation/{name}",
                    value,
                    prog_bar=name == "place_mean_m",
                    batch_size=len(truths),
                    sync_dist=True,
                )


class _Data(lightning.LightningDataModule):
    """Loaders whose order and draws depend on seed and epoch alone, on any number of devices."""

    def __init__(
        self,
        config: TrainConfig,
        training: PoseDataset,
        validation: PoseDataset | None,
        first_epoch: int,
    ) -> None:
        super().__init__()
        self.config = config
        self.training = training
        self.validation = validation
        self.first_epoch = first_epoch

    def train_dataloader(self) -> PoseLoader:
        return self._loader(self.training, shuffle=True)

    def val_dataloader(self) -> PoseLoader | list:
        return [] if self.validation is None else self._loader(self.validation, shuffle=False)

    def _loader(self, dataset: PoseDataset, shuffle: bool) -> PoseLoader:
        sampler = DistributedSampler(
            dataset,
            num_replicas=self.trainer.world_size,
            rank=self.trainer.global_rank,
            shuffle=shuffle,
            seed=self.config.seed,
        )
        # Lightning numbers the later epochs, but starts the first one's workers before it has.
        sampler.set_epoch(self.first_epoch)
        dataset.set_epoch(self.first_epoch)
        return PoseLoader(
            dataset,
            self.config.batch_size,
            sampler=sampler,
            num_workers=self.config.workers,
            collate_fn=collate,
            # Its own: a loader made before or after an epoch is seeded would move what a model
            # with dropout draws in it.
            generator=torch.Generator().manual_seed(self.config.seed),
            pin_memory=torch.cuda.is_available(),
        )


class _Metrics(lightning.Callback):
    """Writes a line of JSON at the end of each epoch."""

    def __init__(self, run: RunFolder) -> None:
        self.path = run.metrics_file

    def on_train_start(self, trainer: lightning.Trainer, _: lightning.LightningModule) -> None:
        """Forget the lines of epochs that a resumed run goes through again."""
        if trainer.is_global_zero and self.path.exists():
            lines = self.path.read_text(encoding="utf-8").splitlines(keepends=True)
            kept = "".join(lines[: trainer.current_epoch])
            write_text(self.path, kept, RunError)

    def on_train_epoch_end(self, trainer: lightning.Trainer, _: lightning.LightningModule) -> None:
        if not trainer.is_global_zero:
            return
        metrics = {
            name.removesuffix("_epoch"): value.item()
            for name, value in trainer.callback_metrics.items()
            if name != "train/loss" and not name.endswith("_step")
        }
        line = {"epoch": trainer.current_epoch, "step": trainer.global_step, **metrics}
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line, allow_nan=False) + "\n")


class _Moved(lightning.Callback):
    """Lets a run whose folder was moved know its best checkpoint and score again."""

    def on_load_checkpoint(
        self, trainer: lightning.Trainer, _: lightning.LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        folder = str(trainer.checkpoint_callback.dirpath)
        for state in checkpoint["callbacks"].values():
            before = state.get("dirpath")
            if not before:
                continue
            moved = {
                name: folder + value.removeprefix(before)
                for name, value in state.items()
                if isinstance(value, str) and value.startswith(before)
            }
            scores = {
                folder + path.removeprefix(before): score
                for path, score in state["best_k_models"].items()
            }
            state.update(moved, best_k_models=scores)


class _Example(lightning.Callback):
    """Draws the heat map of one sample every so many epochs."""

    def __init__(self, run: RunFolder, dataset: PoseDataset, grid: PoseGrid, every: int) -> None:
        self.folder = run.path / "heat_maps"
        self.dataset = dataset
        self.grid = grid
        self.every = every

    def on_train_epoch_end(
        self, trainer: lightning.Trainer, module: lightning.LightningModule
    ) -> None:
        epoch = trainer.current_epoch
        if not trainer.is_global_zero or (epoch + 1) % self.every:
            return
        sample = self.dataset[0]
        if sample is None:  # it could not be read, and is written down
            return
        candidates, model = module.test_candidates, module.model
        model.eval()
        with torch.no_grad():
            images = (sample[kind][None].to(module.device) for kind in ("ground", "aerial"))
            scores = model(*images, candidates)
        model.train()
        figure = draw_estimate(
            denormalise(sample["aerial"]),
            heat_map(candidates.scatter_to_grid(scores))[0].cpu().numpy(),
            self.grid,
            candidates.poses[int(scores.argmax())],
            module.frustum,
            truth=sample["pose"].numpy(),
            title=f"epoch {epoch}",
        )
        self.folder.mkdir(exist_ok=True)
        save_figure(figure, self.folder / f"epoch_{epoch:04d}.png")
        trainer.logger.experiment.add_figure("heat_map", figure, trainer.global_step)
