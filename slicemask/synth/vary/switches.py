"""The switches of domain randomisation: their names, what each varies, and their random numbers."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slicemask.errors import SynthError


@dataclass(frozen=True)
class Switch:
    """One family of variation.

    Parameters
    ----------
    name
        As it is typed.
    stream
        Number of its random numbers, never to be changed: what a switch draws must not depend on
        which others are on.
    help
        What it varies.
    """

    name: str
    stream: int
    help: str


SWITCHES = {
    switch.name: switch
    for switch in (
        Switch("light", 1, "sun's height and azimuth, clouds, haze, glare"),
        Switch("exposure", 2, "exposure, white balance, contrast, saturation"),
        Switch(
            "camera", 3, "height, pitch, roll, bonnet, stitching seams, cropped elevations, blur"
        ),
        Switch("imagery", 4, "tiles' resolution, leaning facades, mosaic seams, sharpening, JPEG"),
        Switch("roads", 5, "asphalt, concrete, gravel or dirt; faded, other or no markings"),
        Switch("trees", 6, "trees of leaves and branches, canopies over the street"),
        Switch("suburbs", 7, "some layouts are detached houses, gardens, verges, bent streets"),
        Switch("country", 8, "some layouts are single roads, fields, woods, farms"),
        Switch("season", 9, "colours of leaves and grass, bare trees"),
        Switch("junctions", 10, "roundabouts"),
    )
}


def check_switches(names: Sequence[str]) -> tuple[str, ...]:
    """Names of switches in the registry's order; "all" names every one.

    Raises
    ------
    SynthError
        If a name is unknown.
    """
    for name in names:
        if name not in SWITCHES and name != "all":
            raise SynthError(f"vary names {name!r}; it must be all, or of {', '.join(SWITCHES)}")
    return tuple(name for name in SWITCHES if "all" in names or name in names)


@dataclass(frozen=True)
class Variation:
    """The switches that are on for a place, and their random numbers.

    Parameters
    ----------
    names
        Of the switches that are on.
    seed
        Of the place.
    """

    names: tuple[str, ...]
    seed: tuple[int, ...]

    def __contains__(self, name: str) -> bool:
        return name in self.names

    def random(self, name: str, *what: int) -> np.random.Generator:
        """Random numbers of a switch, for a part of the place such as one of its pictures."""
        return np.random.default_rng([*self.seed, 7000 + SWITCHES[name].stream, *what])
