"""Recipes: named sets of settings that a run starts from; what is asked for goes before them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from slicematch.errors import ConfigError

RecipeName = Literal["paper", "fast"]


@dataclass(frozen=True)
class Recipe:
    """Settings by name: of any ground images, and those that panoramas alone take."""

    settings: Mapping[str, Any] = field(default_factory=dict)
    panoramas: Mapping[str, Any] = field(default_factory=dict)

    def of(self, projection: str | None) -> dict[str, Any]:
        """The settings for ground images of a projection; None where it is not known yet."""
        further = self.panoramas if projection == "equirectangular" else {}
        return {**self.settings, **further}


# "paper" is SliceMatch to the letter, which the settings' own defaults are. "fast" is ours: what
# answers soonest on a processor, and with fewer errors (docs/results.md, docs/scoring.md).
RECIPES: dict[str, Recipe] = {
    "paper": Recipe(),
    "fast": Recipe(
        {
            "encoder": "tf_efficientnet_lite0",
            "stride": 8,
            # Its 1x1 convolutions bring features to 64 channels before slices are pooled.
            "pyramid": 64,
            "pyramid_to": 16,
            "ground_size": (128, 512),
            "aerial_size": 256,
            "slices": 32,
            "bands": (6.0, 12.0, 24.0),
            "cross_view_attention": False,
            "alpha": None,
            "learning_rate": 5e-4,
            "schedule": "one-cycle",
            "augment": True,
        },
        # Sky and car say nothing of the place.
        panoramas={"elevations": (-30.0, 30.0)},
    ),
}


def find_recipe(name: object) -> Recipe:
    """The recipe of a name.

    Raises
    ------
    ConfigError
        If there is none.
    """
    if name not in get_args(RecipeName):
        raise ConfigError(f"recipe is {name!r}; it must be {' or '.join(get_args(RecipeName))}")
    return RECIPES[str(name)]
