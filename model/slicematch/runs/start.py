"""What a training takes over from a run that it starts from: its network, and its weights."""

from pathlib import Path
from typing import Any

from slicematch.errors import ConfigError
from slicematch.network.slicematch import SliceMatch
from slicematch.runs.config import plain
from slicematch.runs.folder import RunFolder
from slicematch.runs.shipped import find_run

# Settings that make the network, or that its weights were trained for.
_NETWORK = (
    *("encoder", "stride", "pyramid", "pyramid_to", "ground_size", "aerial_size", "elevations"),
    *("image_mean", "image_std", "slices", "bands", "band_rows", "band_values", "band_weights"),
    *("cross_view_attention", "alpha", "tau"),
)


def network_settings(run: str | Path) -> dict[str, Any]:
    """The settings of a run that a training from its weights has to share.

    Parameters
    ----------
    run : path or str
        A run folder, or the name of a run that comes with the package.

    Returns
    -------
    settings : dict
        By the names of `TrainConfig`, and ``init``, the run.

    Raises
    ------
    RunError
        If the folder is no run.

    Notes
    -----
    ``TrainConfig(data="table", root="photos.csv", **network_settings("runs/city"))`` is a training
    that starts from that run.
    """
    config = RunFolder(find_run(run)).load_config()
    settings = {name: plain(getattr(config, name)) for name in _NETWORK}
    return {**settings, "init": str(run)}


def start_from(model: SliceMatch, run: str | Path) -> None:
    """Give a model the weights of a run's best checkpoint.

    Raises
    ------
    RunError
        If the run cannot be loaded.
    ConfigError
        If the model is another than the run's.
    """
    _, trained = RunFolder(find_run(run)).load_model("best")
    weights, held = trained.state_dict(), model.state_dict()
    for name in sorted(weights.keys() | held.keys()):
        if name not in held or name not in weights or weights[name].shape != held[name].shape:
            raise ConfigError(
                f"init is {str(run)!r}, whose network is another than the settings describe: they "
                f"differ in {name}; leave out the settings of the network, which are the run's"
            )
    model.load_state_dict(weights)
