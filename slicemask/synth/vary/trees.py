"""Trees with crowns of leaves, of several species, with canopies that reach over the street."""

from dataclasses import dataclass, replace

import numpy as np

from slicemask.synth.layout.city import City
from slicemask.synth.layout.elements import Colour, Tree
from slicemask.synth.layout.palette import vary_colour

GREENS: dict[str, tuple[Colour, ...]] = {
    "broad": ((0.24, 0.36, 0.14), (0.32, 0.42, 0.17), (0.19, 0.30, 0.13), (0.38, 0.43, 0.17)),
    "gum": ((0.36, 0.40, 0.26), (0.30, 0.36, 0.24), (0.42, 0.43, 0.29)),
    "wood": ((0.24, 0.35, 0.15), (0.30, 0.40, 0.18), (0.20, 0.30, 0.14), (0.36, 0.40, 0.18)),
    "fir": ((0.15, 0.25, 0.15), (0.20, 0.29, 0.17), (0.17, 0.24, 0.19)),
    "bush": ((0.26, 0.36, 0.16), (0.36, 0.38, 0.20), (0.22, 0.28, 0.15), (0.45, 0.36, 0.24)),
    "bare": ((0.35, 0.30, 0.25),),
    "sparse": ((0.34, 0.40, 0.18), (0.42, 0.42, 0.22)),
}
# Height in metres and radius against the height.
SIZES: dict[str, tuple[float, float, float, float]] = {
    "broad": (6.0, 15.0, 0.30, 0.50),
    "gum": (9.0, 19.0, 0.24, 0.40),
    "wood": (8.0, 17.0, 0.22, 0.36),
    "fir": (7.0, 18.0, 0.16, 0.26),
    "bush": (0.7, 3.0, 0.50, 0.90),
    "bare": (6.0, 14.0, 0.30, 0.45),
    "sparse": (4.0, 11.0, 0.28, 0.45),
}


@dataclass(frozen=True)
class Flora:
    """The trees of a place: which species, in what shares, how tall."""

    shares: dict[str, float]
    size: float

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "Flora":
        """Draw a place's trees: two or three species dominate."""
        names = ("broad", "gum", "wood", "fir", "sparse", "bare")
        weights = rng.dirichlet([1.3, 1.0, 0.5, 0.4, 0.4, 0.15])
        return cls(dict(zip(names, weights.tolist(), strict=True)), float(rng.uniform(0.75, 1.25)))

    def tree(self, x: float, y: float, rng: np.random.Generator, species: str = "") -> Tree:
        """Draw a tree at a place, of a species or of any."""
        if not species:
            species = str(rng.choice(list(self.shares), p=list(self.shares.values())))
        low, high, narrow, wide = SIZES[species]
        height = rng.uniform(low, high) * (1.0 if species == "bush" else self.size)
        radius = height * rng.uniform(narrow, wide)
        colour = vary_colour(rng, GREENS[species], 0.14)
        return Tree(x, y, float(height), float(radius), species == "fir", colour, species)


def grow(city: City, flora: Flora, rng: np.random.Generator) -> City:
    """Give all trees of a city a species; street trees may grow far over the street."""
    old = bool(rng.random() < 0.5)
    trees = []
    for tree in city.trees:
        if tree.species:
            trees.append(tree)
            continue
        grown = flora.tree(tree.x, tree.y, rng)
        scale = 1.0 if old else float(rng.uniform(0.4, 0.8))
        trees.append(
            replace(grown, height_m=grown.height_m * scale, radius_m=grown.radius_m * scale)
        )
    return replace(city, trees=tuple(trees))
