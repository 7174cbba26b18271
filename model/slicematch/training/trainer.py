"""Lightning's trainer, as the settings ask for it."""

import os

import torch

from slicemask.threads import thread_count
from slicematch import _torchvision  # noqa: F401  before lightning: see there
from slicematch.devices import check_precision, device_name
from slicematch.errors import ConfigError
from slicematch.runs.config import TrainConfig
from slicematch.runs.folder import RunFolder

import lightning.pytorch as lightning  # isort: skip
from lightning.fabric.utilities.exceptions import MisconfigurationException  # isort: skip
from lightning.pytorch.loggers import TensorBoardLogger  # isort: skip

_RANKS = ("RANK", "LOCAL_RANK", "NODE_RANK", "GROUP_RANK", "SLURM_PROCID")


def make_trainer(
    config: TrainConfig, run: RunFolder, callbacks: list[lightning.Callback], progress: bool
) -> lightning.Trainer:
    """The trainer of a run.

    Parameters
    ----------
    config : TrainConfig
        Devices, precision and epochs.
    run : RunFolder
        Where its curves go.
    callbacks : list of Callback
        What else is done on the way.
    progress : bool
        Whether one of them is a progress bar.

    Raises
    ------
    ConfigError
        If the devices or the precision are not available here.
    """
    accelerator = device_name(config.accelerator)
    check_precision(config.precision, torch.device(accelerator))
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
            num_nodes=config.num_nodes,
            # Some backbones have parameters beyond the stage they are cut at.
            strategy="ddp_find_unused_parameters_true" if world_size(config) > 1 else "auto",
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
            f"accelerator {config.accelerator!r} with {config.devices} devices on "
            f"{config.num_nodes} nodes and precision {config.precision!r} cannot be used here "
            f"({reason})"
        ) from error


def world_size(config: TrainConfig) -> int:
    """How many processes train together."""
    return config.devices * config.num_nodes


def is_first_process(config: TrainConfig) -> bool:
    """Whether this is the process that speaks for all: the first one of the first node.

    Asked before Lightning has brought them together, it goes by what torchrun, SLURM and Lightning
    itself leave in the environment.
    """
    return world_size(config) == 1 or all(os.environ.get(name, "0") == "0" for name in _RANKS)
