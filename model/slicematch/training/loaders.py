"""Loaders of the training and the validation part."""

from collections.abc import Callable
from typing import Any, cast

import torch
from torch.utils.data import DistributedSampler

from slicematch import _torchvision  # noqa: F401  before lightning: see there
from slicematch.data.dataset import BadSampleLog, PoseDataset, collate
from slicematch.data.loading import PoseLoader
from slicematch.runs.config import TrainConfig

import lightning.pytorch as lightning  # isort: skip


class PoseDataModule(lightning.LightningDataModule):
    """Loaders whose order and draws depend on seed and epoch alone, on any number of devices.

    Parameters
    ----------
    config : TrainConfig
        Batch size, seed and worker processes.
    training, validation : PoseDataset
        The parts; None for no validation.
    first_epoch : int
        From 0; a resumed run's first one is not.
    open_log : callable
        Gives the log of unreadable samples, when training begins.

    Attributes
    ----------
    bad_sample_log : BadSampleLog or None
        Once training has begun.
    """

    def __init__(
        self,
        config: TrainConfig,
        training: PoseDataset,
        validation: PoseDataset | None,
        first_epoch: int,
        open_log: Callable[[], BadSampleLog],
    ) -> None:
        super().__init__()
        self.config = config
        self.training = training
        self.validation = validation
        self.first_epoch = first_epoch
        self.bad_sample_log: BadSampleLog | None = None
        self._open_log = open_log

    def setup(self, stage: str) -> None:
        """Give the parts their log of unreadable samples."""
        self.bad_sample_log = self._open_log()
        for dataset in (self.training, self.validation):
            if dataset is not None:
                dataset.bad_sample_log = self.bad_sample_log

    def train_dataloader(self) -> PoseLoader:
        """The training part, shuffled."""
        return self._loader(self.training, shuffle=True)

    def val_dataloader(self) -> PoseLoader | list[PoseLoader]:
        """The validation part, in its order; no loader if there is none."""
        return [] if self.validation is None else self._loader(self.validation, shuffle=False)

    def _loader(self, dataset: PoseDataset, shuffle: bool) -> PoseLoader:
        trainer = cast(lightning.Trainer, self.trainer)  # which asks for the loaders
        sampler: DistributedSampler[Any] = DistributedSampler(
            dataset,
            num_replicas=trainer.world_size,
            rank=trainer.global_rank,
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
