"""Data sets of ground and aerial images with known poses, by name.

A data set is one file and one line here: a class of settings, derived from
`slicematch.data.source.DataConfig`, that knows the defaults and opens the samples. The file is
imported when the data set is asked for, and imports no torch.
"""

import importlib

from slicematch.data.source import DataConfig
from slicematch.errors import ConfigError

DATA_SETS = {
    "vigor": ("slicematch.data.vigor", "VigorConfig"),
    "kitti": ("slicematch.data.kitti", "KittiConfig"),
    "table": ("slicematch.data.table", "TableConfig"),
}
# No name for commands: a program hands such samples to `train` and `evaluate` itself.
OWN = "own"


def config_class(name: str) -> type[DataConfig]:
    """The settings of a data set.

    Parameters
    ----------
    name : str
        A key of `DATA_SETS`, or `OWN`.

    Returns
    -------
    type
        A subclass of `DataConfig`.

    Raises
    ------
    ConfigError
        If there is no such data set.
    """
    known = {**DATA_SETS, OWN: ("slicematch.data.own", "OwnConfig")}
    if name not in known:
        raise ConfigError(f"data is {name!r}; it must be one of {', '.join(known)}")
    module, config = known[name]
    found: type[DataConfig] = getattr(importlib.import_module(module), config)
    return found
