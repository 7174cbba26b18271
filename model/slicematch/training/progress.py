"""How far a training is, as lines for where nobody watches a bar."""

import logging
import time
from collections.abc import Callable
from typing import Any

from slicemask.progress import SECONDS_BETWEEN_LINES, readable_time
from slicematch import _torchvision  # noqa: F401  before lightning: see there

import lightning.pytorch as lightning  # isort: skip

log = logging.getLogger(__name__)


class ProgressLines(lightning.Callback):
    """Logs a line at the end of each epoch, and about every 30 seconds, with the time left.

    Parameters
    ----------
    clock : callable
        Gives seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._start = self._said = clock()
        self._first_epoch = 0

    def on_train_start(
        self, trainer: lightning.Trainer, pl_module: lightning.LightningModule
    ) -> None:
        """Begin to count; a resumed run has done some epochs already."""
        self._start = self._said = self._clock()
        self._first_epoch = trainer.current_epoch

    def on_train_batch_end(
        self,
        trainer: lightning.Trainer,
        pl_module: lightning.LightningModule,
        outputs: Any,
        batch: Any,
        batch_idx: int,
    ) -> None:
        """Say how far the epoch is, if it is time again."""
        self._say_if_time(trainer, "steps", batch_idx + 1, trainer.num_training_batches)

    def on_validation_batch_end(
        self,
        trainer: lightning.Trainer,
        pl_module: lightning.LightningModule,
        outputs: Any,
        batch: Any,
        batch_idx: int,
        dataloader_idx: int = 0,
    ) -> None:
        """Say how far the validation is, if it is time again."""
        (total,) = trainer.num_val_batches
        self._say_if_time(trainer, "batches validated", batch_idx + 1, total)

    def on_train_epoch_end(
        self, trainer: lightning.Trainer, pl_module: lightning.LightningModule
    ) -> None:
        """Say what the epoch came to."""
        if not trainer.is_global_zero:
            return
        self._said = self._clock()
        figures = ", ".join(
            f"{name.removesuffix('_epoch')} {value.item():.4g}"
            for name, value in sorted(trainer.callback_metrics.items())
            if name != "train/loss" and not name.endswith("_step")
        )
        left = self._left(trainer, 1.0)
        log.info("%s: %s%s", _epoch(trainer), figures, f"; about {left} left" if left else "")

    def _say_if_time(
        self, trainer: lightning.Trainer, unit: str, done: int, total: int | float
    ) -> None:
        now = self._clock()
        if not trainer.is_global_zero or now - self._said < SECONDS_BETWEEN_LINES:
            return
        self._said = now
        # Only steps tell how much of an epoch is done: validation comes at its end.
        left = self._left(trainer, done / total if unit == "steps" else 1.0)
        log.info(
            "%s: %s of %s %s%s",
            _epoch(trainer),
            f"{done:,}",
            f"{total:,}",
            unit,
            f", about {left} left" if left else "",
        )

    def _left(self, trainer: lightning.Trainer, share: float) -> str:
        """The time left, if a share of the epoch is done; nothing at the end."""
        epochs = trainer.max_epochs or 0
        done = trainer.current_epoch - self._first_epoch + share
        rest = epochs - self._first_epoch - done
        if rest <= 0:
            return ""
        return readable_time((self._clock() - self._start) / done * rest)


def _epoch(trainer: lightning.Trainer) -> str:
    return f"epoch {trainer.current_epoch + 1} of {trainer.max_epochs}"
