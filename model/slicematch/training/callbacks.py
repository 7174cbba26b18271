"""What is done at the end of an epoch: metrics, checkpoints, an example of a heat map."""

import json
from typing import Any, cast

import torch

from slicemask import PoseGrid
from slicemask.files import write_text
from slicemask.plot import save_figure
from slicematch import _torchvision  # noqa: F401  before lightning: see there
from slicematch.data.dataset import PoseDataset
from slicematch.data.images import denormalise
from slicematch.errors import RunError
from slicematch.evaluation.drawing import draw_estimate
from slicematch.runs.config import TrainConfig
from slicematch.runs.folder import RunFolder
from slicematch.scoring.scores import heat_map
from slicematch.training.module import TrainingModule

import lightning.pytorch as lightning  # isort: skip
from lightning.pytorch.callbacks import ModelCheckpoint  # isort: skip
from lightning.pytorch.loggers import TensorBoardLogger  # isort: skip


def make_callbacks(
    run: RunFolder, config: TrainConfig, training: PoseDataset, validation: PoseDataset | None
) -> list[lightning.Callback]:
    """What a run writes down on its way, as its settings ask for it.

    Parameters
    ----------
    run : RunFolder
        Where it goes.
    config : TrainConfig
        The run's settings.
    training, validation : PoseDataset
        The parts; without validation, the training loss chooses the best checkpoint.
    """
    callbacks: list[lightning.Callback] = [
        *_checkpoints(run, validated=validation is not None),
        _JsonLinesLogger(run),
        _RelocateCheckpoints(),
    ]
    if config.heat_map_every:
        shown = training if validation is None else validation
        grid = config.grid("test_grid")
        callbacks.append(_HeatMapExample(run, shown, grid, config.heat_map_every))
    return callbacks


def _checkpoints(run: RunFolder, validated: bool) -> list[ModelCheckpoint]:
    """The best checkpoint's weights, and the last one with all that resuming takes."""
    best, last = run.checkpoint("best"), run.checkpoint("last")
    return [
        ModelCheckpoint(
            dirpath=best.parent,
            filename=best.stem,
            monitor="validation/place_mean_m" if validated else "train/loss_epoch",
            save_weights_only=True,
            enable_version_counter=False,
            save_on_train_epoch_end=True,
        ),
        ModelCheckpoint(
            dirpath=last.parent,
            filename=last.stem,
            enable_version_counter=False,
            save_on_train_epoch_end=True,
        ),
    ]


class _JsonLinesLogger(lightning.Callback):
    """Writes a line of JSON at the end of each epoch."""

    def __init__(self, run: RunFolder) -> None:
        self.run = run

    def on_train_start(
        self, trainer: lightning.Trainer, pl_module: lightning.LightningModule
    ) -> None:
        """Forget the lines of epochs that a resumed run goes through again."""
        if trainer.is_global_zero and self.run.metrics_file.exists():
            done = [e for e in self.run.load_metrics() if e["epoch"] < trainer.current_epoch]
            write_text(self.run.metrics_file, "".join(map(_line, done)), RunError)

    def on_train_epoch_end(
        self, trainer: lightning.Trainer, pl_module: lightning.LightningModule
    ) -> None:
        if not trainer.is_global_zero:
            return
        metrics = {
            name.removesuffix("_epoch"): value.item()
            for name, value in trainer.callback_metrics.items()
            if name != "train/loss" and not name.endswith("_step")
        }
        line = {"epoch": trainer.current_epoch, "step": trainer.global_step, **metrics}
        with self.run.metrics_file.open("a", encoding="utf-8") as file:
            file.write(_line(line))


def _line(metrics: dict[str, Any]) -> str:
    return json.dumps(metrics, allow_nan=False) + "\n"


class _RelocateCheckpoints(lightning.Callback):
    """Lets a run whose folder was moved know its best checkpoint and score again."""

    def on_load_checkpoint(
        self,
        trainer: lightning.Trainer,
        pl_module: lightning.LightningModule,
        checkpoint: dict[str, Any],
    ) -> None:
        folder = str(cast(ModelCheckpoint, trainer.checkpoint_callback).dirpath)
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


class _HeatMapExample(lightning.Callback):
    """Draws the heat map of one sample every so many epochs."""

    def __init__(self, run: RunFolder, dataset: PoseDataset, grid: PoseGrid, every: int) -> None:
        self.folder = run.path / "heat_maps"
        self.dataset = dataset
        self.grid = grid
        self.every = every

    def on_train_epoch_end(
        self, trainer: lightning.Trainer, pl_module: lightning.LightningModule
    ) -> None:
        epoch = trainer.current_epoch + 1  # people count from 1
        if not trainer.is_global_zero or epoch % self.every:
            return
        sample = self.dataset[0]
        if sample is None:  # it could not be read, and is written down
            return
        module, settings = cast(TrainingModule, pl_module), self.dataset.config
        candidates, model = module.test_candidates, module.model
        model.eval()
        with torch.no_grad():
            images = (sample[kind][None].to(module.device) for kind in ("ground", "aerial"))
            scores = model(*images, candidates)
        model.train()
        figure = draw_estimate(
            denormalise(sample["aerial"], settings.image_mean, settings.image_std),
            heat_map(candidates.scatter_to_grid(scores))[0].cpu().numpy(),
            self.grid,
            candidates.poses[int(scores.argmax())],
            module.frustum,
            truth=sample["pose"].numpy(),
            title=f"epoch {epoch}",
        )
        self.folder.mkdir(exist_ok=True)
        save_figure(figure, self.folder / f"epoch_{epoch:04d}.png")
        writer = cast(TensorBoardLogger, trainer.logger).experiment
        writer.add_figure("heat_map", figure, trainer.global_step)
