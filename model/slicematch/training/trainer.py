"""Lightning's trainer, as the settings ask for it."""

from slicemask.threads import thread_count
from slicematch import _torchvision  # noqa: F401  before lightning: see there
from slicematch.devices import device_name
from slicematch.errors import ConfigError
from slicematch.runs.config import TrainConfig
from slicematch.runs.folder import RunFolder

import lightning.pytorch as lightning  # isort: skip
from lightning.fabric.utilities.exceptions import MisconfigurationException  # isort: skip
from lightning.pytorch.loggers import TensorBoardLogger  # isort: skip


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
