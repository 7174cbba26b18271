"""The samples of a data set that are evaluated."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from torch.utils.data import Dataset

from slicematch.data.dataset import PoseDataset, Sample
from slicematch.errors import ConfigError


def check_one_source(
    dataset: Any, data: str | None, root: str | None, data_settings: Mapping[str, Any] | None
) -> None:
    """Refuse a data set of the program's own beside one that is named."""
    named = {"data": data, "root": root, "data_settings": data_settings}
    given = [f"{name} is {value!r}" for name, value in named.items() if value]
    if dataset is not None and given:
        raise ConfigError(
            f"{given[0]}, and a dataset of the program's own is handed over, too; leave one out"
        )


def evenly_spaced_indices(count: int, limit: int | None) -> list[int]:
    """At most `limit` of the numbers 0 to count - 1, evenly spaced; all of them without a limit.

    Examples
    --------
    >>> evenly_spaced_indices(5, 3)
    [0, 2, 4]
    """
    some = count if limit is None else min(limit, count)
    indices: list[int] = np.linspace(0, count - 1, some).round().astype(int).tolist()
    return indices


class ChosenSamples(Dataset[Sample | None]):
    """Some samples of a data set, each itself or None: no other stands in for an unreadable one.

    Parameters
    ----------
    dataset : PoseDataset
        Of any part. In training another sample stands in for an unreadable one, which would count
        twice here.
    indices : sequence of int
        Places in the data set's list.
    """

    def __init__(self, dataset: PoseDataset, indices: Sequence[int]) -> None:
        self.dataset = dataset
        self.indices = indices

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, number: int) -> Sample | None:
        return self.dataset.sample(self.indices[number])
