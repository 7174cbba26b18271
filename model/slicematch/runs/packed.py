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
    The temperature of the scores that they give together (`slicematch.calibrate`). Without it
    their own temperatures make one.

Commands and functions that only read a run take a packed one as they take a run folder.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from safetensors.torch import save

from slicemask.files import atomic_write, check_folder, write_text
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
    source = RunFolder(find_run(run))
    config, model = source.load_model(checkpoint)
    if grid is not None:
        config = replace(config, test_grid=grid)
    fitted = source.load_calibration(config)
    target = RunFolder(check_folder(out, RunError))
    if target.path.exists() and any(target.path.iterdir()):
        raise RunError(f"{target.path}: is not empty; name another folder")
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
    names = _names_of([*(one.path for one in source.members()), *members], config)
    target.path.mkdir(parents=True, exist_ok=True)
    with atomic_write(target.packed_weights, RunError) as partial:
        partial.write_bytes(save(weights))
    _without_paths(config).save(target.config_file)
    target.save_stages(model)
    if fitted is not None and fitted.checkpoint == checkpoint:
        text = source.calibration_file.read_text("utf-8").replace('"last"', '"best"')
        write_text(target.calibration_file, text, RunError)
    for name, member in names.items():
        pack(member, target.members_folder / name, checkpoint)
    if source.ensemble_file.is_file() and not members:  # fitted to these networks' scores
        write_text(target.ensemble_file, source.ensemble_file.read_text("utf-8"), RunError)
    return target.path


def _names_of(members: Sequence[str | Path], first: TrainConfig) -> dict[str, str | Path]:
    """The names of further runs in an ensemble, all of which are found fit before any is packed."""
    from slicematch.localization.members import check_sees_alike  # which needs this package

    names: dict[str, str | Path] = {}
    for member in members:
        path = find_run(member)
        if path.name in names:
            raise ConfigError(
                f"{member}: another run of the name {path.name!r} is in the ensemble; give one of "
                "the folders another name"
            )
        check_sees_alike(first, RunFolder(path).load_config(), str(member))
        names[path.name] = member
    return names


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
