"""Trees whose crowns are made of leaves, so that sky and ground show through them.

A template stands on z = 0, one unit high and one unit in radius; trees are stretched copies of one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import trimesh
from numpy.typing import NDArray

from slicemask.synth.layout.elements import Colour, Kind, Tree
from slicemask.synth.render import meshes

VARIANTS = 4  # templates of each species
BARK: tuple[Colour, ...] = ((0.28, 0.22, 0.17), (0.48, 0.44, 0.38), (0.20, 0.17, 0.14))
# Trees are about so many times as high as their crowns are wide to one side.
SLENDER = 2.4


@dataclass(frozen=True)
class Species:
    """How a crown is built.

    Parameters
    ----------
    leaves, leaf
        Number of triangles, and their size against the crown's radius.
    blobs, blob
        Number of the clusters that they form, and their size against the crown's radius.
    low, high
        Where clusters' centres lie, in heights.
    spread
        How far from the trunk they do, in radii.
    core
        Size of the dark inside that hides what lies behind, against that of a cluster.
    twigs
        Whether branches lead to the clusters.
    bark
        Colour of the wood, an index into `BARK`.
    cone
        Whether clusters are wide below and narrow above.
    """

    leaves: int
    leaf: float
    blobs: int
    blob: float
    low: float
    high: float
    spread: float
    core: float
    twigs: bool = True
    bark: int = 0
    cone: bool = False


SPECIES = {
    "broad": Species(800, 0.16, 11, 0.44, 0.38, 0.82, 0.62, 0.72),
    "gum": Species(640, 0.135, 12, 0.34, 0.50, 0.90, 0.72, 0.45, bark=1),
    "wood": Species(230, 0.30, 7, 0.50, 0.40, 0.82, 0.55, 0.72, twigs=False),
    "fir": Species(600, 0.22, 9, 0.80, 0.10, 0.93, 0.0, 0.62, twigs=False, bark=2, cone=True),
    "bush": Species(110, 0.30, 5, 0.60, 0.30, 0.55, 0.50, 0.80, twigs=False),
    "bare": Species(0, 0.1, 16, 0.40, 0.45, 0.95, 0.80, 0.0, bark=2),
    "sparse": Species(170, 0.16, 14, 0.34, 0.42, 0.92, 0.75, 0.0, bark=0),
}


@cache
def _template(name: str, variant: int, fine: bool) -> tuple[meshes.Soup, meshes.Soup, meshes.Soup]:
    """Leaves, dark cores and wood; finer where a camera may come near."""
    species = SPECIES[name]
    if fine:
        species = replace(species, leaves=3 * species.leaves, leaf=0.58 * species.leaf)
    rng = np.random.default_rng([len(name), ord(name[0]), variant])
    share = (np.arange(species.blobs) + 0.5) / species.blobs
    angle = 2.4 * np.arange(species.blobs) + rng.normal(0, 0.4, species.blobs)
    height = species.low + (species.high - species.low) * rng.permutation(share)
    if species.cone:
        height = species.low + (species.high - species.low) * share
    # Crowns are widest at half their height.
    middle = (species.low + species.high) / 2
    wide = np.sqrt(np.clip(1.1 - ((height - middle) / (species.high - species.low)) ** 2 * 3, 0, 1))
    out = species.spread * wide * np.sqrt(rng.uniform(0.15, 1.0, species.blobs))
    centres = np.stack([out * np.cos(angle), out * np.sin(angle), height], axis=1)
    sizes = species.blob * rng.uniform(0.75, 1.25, species.blobs)
    flat = np.array([1.0, 1.0, 0.8 / SLENDER])
    if species.cone:
        sizes = 0.95 * (1.03 - share) ** 0.9 * rng.uniform(0.9, 1.1, species.blobs) + 0.06
        flat = np.array([1.0, 1.0, 0.55 / SLENDER])
    ball = trimesh.creation.icosphere(subdivisions=int(fine)).triangles
    cores = [
        ball * flat * size * species.core + centre
        for centre, size in zip(centres, sizes, strict=True)
        if species.core
    ]
    leaves = _leaves(species, centres, sizes, flat, rng)
    wood = [meshes.tube(6) * [0.055, 0.055, 0.85 if species.cone else middle]]
    if species.twigs:
        for centre in centres:
            fork = np.array([0, 0, rng.uniform(0.25, 0.9) * min(centre[2], middle)])
            wood.append(_branch(fork, centre, 0.028))
            for _ in range(2 if name in ("bare", "sparse") else 0):
                tip = centre + rng.normal(0, 1, 3) * [0.3, 0.3, 0.13]
                wood.append(_branch(fork * 0.4 + centre * 0.6, tip, 0.014))
    return leaves, np.concatenate(cores or [np.empty((0, 3, 3))]), np.concatenate(wood)


def _leaves(
    species: Species,
    centres: NDArray[np.float64],
    sizes: NDArray[np.float64],
    flat: NDArray[np.float64],
    rng: np.random.Generator,
) -> meshes.Soup:
    """Triangles on the clusters, turned outwards more or less."""
    if not species.leaves:
        return np.empty((0, 3, 3))
    chance = sizes**2 / (sizes**2).sum()
    owner = rng.choice(species.blobs, species.leaves, p=chance)
    outward = rng.normal(0, 1, (species.leaves, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    if species.cone:  # branches end on the cone's surface
        outward[:, 2] = -np.abs(outward[:, 2]) * 0.4
    depth = sizes[owner] * rng.uniform(0.75, 1.05, species.leaves)
    middle = centres[owner] + outward * depth[:, None] * flat
    normal = outward + rng.normal(0, 0.55, outward.shape)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    aside = np.cross(normal, rng.normal(0, 1, normal.shape))
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    other = np.cross(normal, aside)
    turn = rng.uniform(0, 2 * np.pi, species.leaves)[:, None] + [0.0, 2.1, 4.2]
    size = species.leaf * rng.uniform(0.6, 1.3, (species.leaves, 1))
    corners = (
        size[..., None] * np.cos(turn)[..., None] * aside[:, None]
        + size[..., None] * np.sin(turn)[..., None] * other[:, None]
    )
    return middle[:, None] + corners * [1.0, 1.0, 1.0 / SLENDER]


def _branch(start: NDArray[np.float64], end: NDArray[np.float64], width: float) -> meshes.Soup:
    """A branch of three sides that narrows."""
    angle = np.array([0.0, 2.1, 4.2])
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(3)], axis=1) * width
    low, high = start + ring, end + ring * 0.4
    sides = []
    for k in range(3):
        n = (k + 1) % 3
        sides += [[low[k], low[n], high[n]], [low[k], high[n], high[k]]]
    return np.array(sides)


def foliage(
    trees: Sequence[Tree], near: Sequence[bool] | NDArray[np.bool_]
) -> list[tuple[meshes.Soup, NDArray[np.intp], list[Kind], list[Colour]]]:
    """Triangles [T, 3, 3] of trees that have a species, whose each is, kinds and colours.

    Trees that are `near` a camera's way are finer.
    """
    parts = []
    groups: dict[tuple[str, int, bool], list[Tree]] = {}
    for number, (tree, fine) in enumerate(zip(trees, near, strict=True)):
        groups.setdefault((tree.species, number % VARIANTS, bool(fine)), []).append(tree)
    for (name, variant, fine), chosen in groups.items():
        x, y, height, radius = np.array(
            [(tree.x, tree.y, tree.height_m, tree.radius_m) for tree in chosen]
        ).T
        scale = np.column_stack([radius, radius, height])
        rotation_deg = 137.5 * np.arange(len(chosen)) + 31.0 * variant
        leaves, cores, wood = _template(name, variant, fine)
        for soup, shade in ((leaves, 1.25), (cores, 0.6)):
            if len(soup):
                placed = meshes.instances(soup, x, y, np.zeros(len(x)), scale, rotation_deg)
                owner = np.repeat(np.arange(len(chosen)), len(soup))
                colours = [_shaded(tree.colour, shade) for tree in chosen]
                parts.append((placed, owner, [Kind.FOLIAGE] * len(chosen), colours))
        placed = meshes.instances(wood, x, y, np.zeros(len(x)), scale, rotation_deg)
        owner = np.zeros(len(placed), dtype=np.intp)
        parts.append((placed, owner, [Kind.PLAIN], [BARK[SPECIES[name].bark]]))
    return parts


def _shaded(colour: Colour, shade: float) -> Colour:
    return colour[0] * shade, colour[1] * shade, colour[2] * shade
