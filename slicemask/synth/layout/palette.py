"""Colours of walls, roofs and things that stand out, and the look of facades."""

from dataclasses import replace

import numpy as np

from slicemask.synth.layout.elements import Colour, Facade
from slicemask.synth.layout.streets import Style

WALLS: tuple[Colour, ...] = (
    (0.74, 0.68, 0.58), (0.62, 0.40, 0.31), (0.80, 0.78, 0.73), (0.58, 0.60, 0.62),
    (0.70, 0.58, 0.42), (0.52, 0.33, 0.27), (0.83, 0.76, 0.60), (0.60, 0.66, 0.62),
    (0.46, 0.44, 0.43), (0.78, 0.66, 0.62), (0.55, 0.62, 0.70), (0.86, 0.85, 0.82),
)  # fmt: skip
FLAT_ROOFS: tuple[Colour, ...] = (
    (0.62, 0.61, 0.58), (0.42, 0.42, 0.43), (0.75, 0.74, 0.72), (0.52, 0.48, 0.43),
    (0.33, 0.33, 0.35), (0.60, 0.52, 0.45), (0.45, 0.52, 0.46), (0.68, 0.66, 0.60),
)  # fmt: skip
TILED_ROOFS: tuple[Colour, ...] = (
    (0.55, 0.29, 0.21), (0.40, 0.36, 0.34), (0.33, 0.35, 0.39), (0.47, 0.37, 0.28),
    (0.60, 0.36, 0.26), (0.37, 0.41, 0.38), (0.28, 0.27, 0.28), (0.50, 0.24, 0.20),
)  # fmt: skip
BRIGHT: tuple[Colour, ...] = (
    (0.80, 0.12, 0.10), (0.10, 0.35, 0.75), (0.95, 0.70, 0.05), (0.05, 0.55, 0.35),
    (0.55, 0.15, 0.60), (0.95, 0.45, 0.08), (0.05, 0.60, 0.70), (0.90, 0.90, 0.92),
)  # fmt: skip
CONCRETE: Colour = (0.60, 0.59, 0.56)


def vary_colour(
    rng: np.random.Generator, colours: tuple[Colour, ...], spread: float = 0.06
) -> Colour:
    """Pick a colour and vary its brightness and tint a little."""
    colour = np.array(colours[rng.integers(len(colours))])
    colour = colour * (1 + rng.normal(0, spread)) + rng.normal(0, spread / 4, 3)
    red, green, blue = np.clip(colour, 0.03, 0.95).tolist()
    return red, green, blue


def draw_facade(style: Style, kind: str, rng: np.random.Generator) -> Facade:
    """Draw the look of a "house", a "row", a "tower" or a "shed"."""
    wall = vary_colour(rng, WALLS)
    wall = (
        min(max(wall[0] + style.wall_hue, 0.05), 0.95),
        wall[1],
        min(max(wall[2] - style.wall_hue, 0.05), 0.95),
    )
    facade = Facade(
        colour=wall,
        window=vary_colour(rng, ((0.20, 0.24, 0.29), (0.28, 0.33, 0.37), (0.16, 0.18, 0.20))),
        shop=vary_colour(rng, BRIGHT),
        pitch_m=float(rng.uniform(2.0, 3.6)),
        storey_m=float(rng.uniform(2.8, 3.5)),
        width=float(rng.uniform(0.32, 0.6)),
        height=float(rng.uniform(0.42, 0.6)),
        bricks=float(rng.choice([0.0, 0.0, 1.0])),
    )
    if kind == "house":
        return facade
    if kind == "tower" and rng.random() < 0.6:
        # A curtain wall, or bands of glass.
        return replace(
            facade,
            window=vary_colour(rng, ((0.25, 0.35, 0.45), (0.18, 0.28, 0.30), (0.38, 0.46, 0.52))),
            width=float(rng.choice([0.88, 1.0])),
            height=float(rng.uniform(0.55, 0.88)),
            bricks=0.0,
            shops=True,
        )
    if kind == "shed":
        return replace(facade, width=0.0, bricks=0.0, shops=bool(rng.random() < 0.6))
    return replace(facade, shops=bool(rng.random() < 0.45))
