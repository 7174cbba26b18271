"""A packed run: what answering takes, small enough to hand on, or to come with the package.

``config.yaml``, ``calibration.json``, ``stages.json``
    The run's own.
``weights.safetensors``
    The weights of one checkpoint, floating-point ones in half precision. They count as the best.
``README.md``
    Its model card, if it has one.
``members/NAME/``
    Of an ensemble: further networks that answer with the first, packed likewise.
``ensemble.json``
    The temperature of the scores that they give together (`slicematch.evaluation.calibration`).
    Without it their own temperatures make one.

Commands and functions that only read a run take a packed one as they take a run folder.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from safetensors.torch import save

from slicemask.files import atomic_folder, atomic_write, check_new_folder, write_text
from slicematch.errors import ConfigError, RunError
from slicematch.runs.config import TrainConfig
from slicematch.runs.folder import Checkpoint, RunFolder
from slicematch.runs.shipped import find_run


def pack(
    run: str | Path,
    out: str | Path,
    checkpoint: Checkpoint = "best",
    grid: str | None = None,
    members: Sequence[str | Path] = (),
) -> Path:
    """Write what answering with a run takes into a folder of its own.

    With further runs the folder is an ensemble: all of them answer together, by the mean of their
    scores, each over its own temperature. An ensemble is packed with all its networks.

    Parameters
    ----------
    run : path
        A run folder.
    out : path
        The folder to write, new or empty.
    checkpoint : {"best", "last"}
        Which weights.
    grid : str, optional
        Candidates that it is to answer with unless told otherwise, such as "21x21x64"; the run's
        test grid by default.
    members : sequence of path
        Runs that are to answer with it. Networks, slices and bands may differ; the images that they
        take may not.

    Returns
    -------
    path : Path
        The folder.

    Raises
    ------
    RunError
        If the run cannot be loaded, the folder holds something or cannot be written, or a weight
        is too large for half precision.
    ConfigError
        If a run takes other images than the first one, or two have the same name.
    slicemask.errors.SpecError
        If the grid is invalid.
    """
    target = check_new_folder(out, RunError)
    source = RunFolder(find_run(run))
    config = source.load_config()
    others = _members_by_name([*(one.path for one in source.members()), *members], config)
    with atomic_folder(target, RunError) as folder:
        partial = RunFolder(folder)
        _write(source, partial, checkpoint, grid)
        for name, member in others.items():
            _write(member, RunFolder(partial.members_folder / name), checkpoint)
        if not members and source.load_calibration(config, ensemble=True) is not None:
            _copy_text(source.ensemble_file, partial.ensemble_file)
    return target


def _write(
    source: RunFolder, target: RunFolder, which: Checkpoint, grid: str | None = None
) -> None:
    """Pack one network into a new folder."""
    if not source.checkpoint(which).exists() and source.packed_weights.is_file():
        which = "best"  # all that a packed run has
    config, model = source.load_model(which)
    fitted = source.load_calibration(config)
    weights = {
        key: (tensor.half() if tensor.is_floating_point() else tensor).contiguous()
        for key, tensor in model.state_dict().items()
    }
    too_large = [key for key, tensor in weights.items() if not tensor.isfinite().all()]
    if too_large:
        raise RunError(
            f"{source.path}: its {too_large[0]} is too large for half precision (65504); hand on "
            "the run folder instead"
        )
    target.path.mkdir(parents=True, exist_ok=True)
    with atomic_write(target.packed_weights, RunError) as partial:
        partial.write_bytes(save(weights))
    config = config if grid is None else replace(config, test_grid=grid)
    _without_paths(config).save(target.config_file)
    target.save_stages(model)
    if fitted is not None and fitted.checkpoint == which:
        _copy_text(source.calibration_file, target.calibration_file, ('"last"', '"best"'))


def _copy_text(source: Path, target: Path, change: tuple[str, str] = ("", "")) -> None:
    write_text(target, source.read_text("utf-8").replace(*change), RunError)


def _members_by_name(members: Sequence[str | Path], first: TrainConfig) -> dict[str, RunFolder]:
    """Further runs, each with those that answer with it, by the names of their folders."""
    from slicematch.localization.members import check_sees_alike  # which needs this package

    folders = [RunFolder(find_run(member).resolve()) for member in members]
    folders = [one for folder in folders for one in (folder, *folder.members())]
    found: dict[str, RunFolder] = {}
    for folder in folders:
        check_sees_alike(first, folder.load_config(), str(folder.path))
        # Some file systems tell names apart by their letters alone, not by their case.
        if folder.path.name.casefold() in map(str.casefold, found):
            raise ConfigError(
                f"{folder.path}: another run of the name {folder.path.name!r} is in the ensemble; "
                "give one of the folders another name"
            )
        found[folder.path.name] = folder
    return found


def _without_paths(config: TrainConfig) -> TrainConfig:
    """The settings with names of folders and files alone: their paths mean nothing elsewhere."""
    own = {
        name: Path(value).name if name.endswith("_dir") and value else value
        for name, value in config.data_settings.items()
    }
    return replace(
        config,
        root=Path(config.root).name,
        weights=Path(config.weights).name,
        init=None if config.init is None else Path(config.init).name,
        data_settings=own,
    )
