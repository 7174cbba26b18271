"""Draw the README's picture: a small town from the street and from above, cut into slices.

The town is made up: a height map with colours, which is looked at from above for the aerial tile
and from a camera in the street for the panorama. Both therefore show the same place, and slice n
of one is slice n of the other.

    python examples/readme_picture.py [docs/images/slices.png]
"""

import sys
from dataclasses import dataclass

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image, ImageDraw, ImageFilter

from slicemask import Frustum, slice_masks
from slicemask.plot import draw_pose, slice_colours

WORLD_M, TILE_M, PIXELS_PER_METRE = 160.0, 96.0, 10
TILT_DEG = 14.0  # of the streets against the tile
CAMERA_HEIGHT_M = 2.4
POSE = (0.47, 0.56, 346.0)
FRUSTUM = Frustum(hfov_deg=360.0, slices=16)
CELLS = 32
CLEAR_M = 78.0  # no car stands in front of the camera

GRASS, PARK, ROAD, PAVEMENT, LINE = "#a9b58c", "#96ab78", "#75797d", "#bdb9b0", "#e9e6da"
ROOFS = ("#a2624f", "#8a7a6b", "#77818b", "#b08962", "#93554d", "#6f6f76")
WALLS = ("#dccdb4", "#c9a58c", "#d9d6cf", "#b9c0c4", "#cfb48c", "#e3dccb")


@dataclass
class Town:
    """A square of land: colours from above, colours of walls, and heights in metres."""

    ground: Image.Image
    walls: Image.Image
    height: Image.Image

    @classmethod
    def empty(cls) -> "Town":
        """A square of grass."""
        size = (int(WORLD_M * PIXELS_PER_METRE),) * 2
        return cls(
            Image.new("RGB", size, GRASS), Image.new("RGB", size, GRASS), Image.new("F", size, 0.0)
        )

    def paint(self, box: tuple[float, float, float, float], colour: str) -> None:
        """Paint a flat rectangle (west, north, east, south), in metres."""
        ImageDraw.Draw(self.ground).rectangle([edge * PIXELS_PER_METRE for edge in box], colour)

    def wall(self, pixels: list[int], colour: str) -> None:
        """Paint walls, and a little beyond them so that turning the town mixes nothing in."""
        west, north, east, south = pixels
        ImageDraw.Draw(self.walls).rectangle((west - 3, north - 3, east + 3, south + 3), colour)

    def house(self, box: tuple[float, ...], eaves_m: float, roof: str, wall: str) -> None:
        """Add a house with a hipped roof."""
        pixels = [round(edge * PIXELS_PER_METRE) for edge in box]
        ImageDraw.Draw(self.ground).rectangle(pixels, roof)
        self.wall(pixels, wall)
        drawing = ImageDraw.Draw(self.height)
        depth = min(pixels[2] - pixels[0], pixels[3] - pixels[1]) // 2
        for inward in range(depth + 1):
            west, north, east, south = pixels
            ring = (west + inward, north + inward, east - inward, south - inward)
            drawing.rectangle(ring, eaves_m + 0.45 * inward / PIXELS_PER_METRE)

    def block(self, box: tuple[float, ...], top_m: float, roof: str, wall: str) -> None:
        """Add a flat-roofed building with a parapet, or a car."""
        pixels = [round(edge * PIXELS_PER_METRE) for edge in box]
        ImageDraw.Draw(self.ground).rectangle(pixels, roof)
        self.wall(pixels, wall)
        ImageDraw.Draw(self.height).rectangle(pixels, top_m)

    def tree(self, x: float, y: float, radius_m: float, colour: str) -> None:
        """Add a tree: a dome of leaves."""
        drawing = ImageDraw.Draw(self.height)
        for share in np.linspace(1.0, 0.05, 24):
            top = radius_m * (1.3 + 1.4 * np.sqrt(1.0 - share**2))
            reach = radius_m * share
            box = [edge * PIXELS_PER_METRE for edge in (x - reach, y - reach, x + reach, y + reach)]
            drawing.ellipse(box, float(top))
            if share == 1.0:
                ImageDraw.Draw(self.ground).ellipse(box, colour)
                ImageDraw.Draw(self.walls).ellipse(box, colour)


def build_town() -> Town:
    """Lay out streets, houses, trees and cars; the same ones every time."""
    rng = np.random.default_rng(7)
    town = Town.empty()
    streets = {"v": (22.0, 80.0, 134.0), "h": (30.0, 86.0, 140.0)}
    for x in streets["v"]:
        town.paint((x - 7, 0, x + 7, WORLD_M), PAVEMENT)
    for y in streets["h"]:
        town.paint((0, y - 6.5, WORLD_M, y + 6.5), PAVEMENT)
    for x in streets["v"]:
        town.paint((x - 4.6, 0, x + 4.6, WORLD_M), ROAD)
    for y in streets["h"]:
        town.paint((0, y - 4.2, WORLD_M, y + 4.2), ROAD)
    for start in np.arange(0, WORLD_M, 5.0):
        for x in streets["v"]:
            if min(abs(start + 1 - y) for y in streets["h"]) > 8:
                town.paint((x - 0.12, start, x + 0.12, start + 2.4), LINE)
        for y in streets["h"]:
            if min(abs(start + 1 - x) for x in streets["v"]) > 8:
                town.paint((start, y - 0.12, start + 2.4, y + 0.12), LINE)
    for x in streets["v"]:
        for y in streets["h"]:
            for stripe in np.arange(-4.0, 4.1, 1.1):
                town.paint((x + stripe - 0.3, y - 7.4, x + stripe + 0.3, y - 4.9), LINE)
                town.paint((x + stripe - 0.3, y + 4.9, x + stripe + 0.3, y + 7.4), LINE)

    for west, east in ((31, 72), (88, 126), (142, 160), (0, 14)):
        for north, south in ((38, 78), (94, 132), (0, 22), (148, 160)):
            if (west, north) == (88, 94):  # a park, with a path across it
                town.paint((west, north, east, south), PARK)
                town.paint((west, 112, east, 113.6), PAVEMENT)
                for _ in range(26):
                    x, y = rng.uniform(west + 3, east - 3), rng.uniform(north + 3, south - 3)
                    if abs(y - 112.8) > 3:
                        town.tree(x, y, rng.uniform(1.6, 3.2), _green(rng))
                continue
            _fill_block(town, rng, west, north, east, south)
    for x in streets["v"]:
        for y in np.arange(4, WORLD_M, 11.5):
            if min(abs(y - other) for other in streets["h"]) > 10:
                for side in (-6.0, 6.0):
                    if rng.random() < 0.6:
                        town.tree(x + side, y, rng.uniform(1.2, 1.9), _green(rng))
                if rng.random() < 0.5 and abs(y - CLEAR_M) > 12:
                    colour = ("#c84f43", "#e8e8e6", "#3d4650", "#5f86b3")[rng.integers(4)]
                    x0 = x + (2.5 if rng.random() < 0.5 else -4.3)
                    town.block((x0, y, x0 + 1.8, y + 4.3), 1.5, colour, colour)
    return town


def _fill_block(
    town: Town, rng: np.random.Generator, west: float, north: float, east: float, south: float
) -> None:
    """Fill the land between streets with buildings around a green yard."""
    deep = 10.5
    yard = south - north > 2 * deep + 8
    for y in (north + 1.0, south - 1.0 - deep) if yard else (north + 1.0,):
        x = west + 1.0
        while x < east - 7.0:
            wide = min(rng.uniform(8.0, 14.0), east - 1.0 - x)
            kind = rng.integers(len(ROOFS))
            box = (x, y + rng.uniform(0, 1), x + wide, y + deep - rng.uniform(0, 1.5))
            if rng.random() < 0.3:
                town.block(box, rng.uniform(9.0, 13.0), "#a9aaa8", WALLS[kind])
            else:
                town.house(box, rng.uniform(4.5, 8.5), ROOFS[kind], WALLS[kind])
            x += wide + rng.uniform(1.2, 4.0)
    for _ in range(int((east - west) * (south - north) / 130) if yard else 0):
        x, y = rng.uniform(west + 3, east - 3), rng.uniform(north + 14, south - 14)
        town.tree(x, y, rng.uniform(1.4, 2.6), _green(rng))


def _green(rng: np.random.Generator) -> str:
    return ("#5d7a4a", "#6b8a52", "#54734c", "#7c9354")[rng.integers(4)]


def light(town: Town) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Turn the town by its tilt and light it from the north-west.

    Returns
    -------
    above, walls : float64 [S, S, 3]
        Colours in [0, 1] from above, lit, and of walls.
    height : float64 [S, S]
        In metres.
    """
    above, walls = (
        np.asarray(image.rotate(TILT_DEG, Image.Resampling.BICUBIC), dtype=np.float64) / 255.0
        for image in (town.ground.filter(ImageFilter.GaussianBlur(0.6)), town.walls)
    )
    height = np.asarray(town.height.rotate(TILT_DEG), dtype=np.float64)
    shadow = np.zeros_like(height)
    for step in range(1, 130):  # a shadow falls 1 metre a metre, to the south-east
        shifted = np.roll(height, (step, step), axis=(0, 1)) - step * 2**0.5 / PIXELS_PER_METRE
        shadow = np.maximum(shadow, shifted)
    slope_v, slope_u = np.gradient(height, 1.0 / PIXELS_PER_METRE)
    lit = 1.0 + 0.35 * np.clip((slope_u + slope_v) / 2**0.5, -0.8, 0.8)
    lit *= np.where(shadow > height + 0.3, 0.66, 1.0)
    return np.clip(above * lit[..., None], 0.0, 1.0), walls, height


def panorama(
    above: np.ndarray, walls: np.ndarray, height: np.ndarray, pose: tuple[float, float, float]
) -> np.ndarray:
    """Look around from a camera in the town: float64 [H, W, 3], the heading in the middle column.

    A ray at elevation e meets the first surface that rises to it, so the surface's index is
    found in the running maximum of (height - camera) / distance along the column's azimuth.
    """
    columns, rows = 1440, 300
    azimuth = np.radians(pose[2] + 180.0 * (2.0 * (np.arange(columns) + 0.5) / columns - 1.0))
    elevation = np.linspace(0.52, -0.36, rows)  # tangents
    distance = np.geomspace(1.2, 75.0, 1600)
    origin = (WORLD_M - TILE_M) / 2
    x = origin + pose[0] * TILE_M + distance[:, None] * np.sin(azimuth)
    y = origin + pose[1] * TILE_M - distance[:, None] * np.cos(azimuth)
    at = tuple(
        np.clip((place * PIXELS_PER_METRE).astype(int), 0, len(height) - 1) for place in (y, x)
    )
    tops = height[at]
    rise = np.maximum.accumulate((tops - CAMERA_HEIGHT_M) / distance[:, None], axis=0)
    sky = np.linspace(0.0, 1.0, rows)[:, None]
    # One of the town's own two axes runs along any wall, and the other is constant on it.
    tilt = np.radians(TILT_DEG)
    across, down = np.cos(tilt) + np.sin(tilt), np.cos(tilt) - np.sin(tilt)
    picture = np.empty((rows, columns, 3))
    for column in range(columns):
        hit = np.searchsorted(rise[:, column], elevation)
        seen = np.minimum(hit, len(distance) - 1)
        where = at[0][seen, column], at[1][seen, column]
        level = CAMERA_HEIGHT_M + distance[seen] * elevation
        below = tops[seen, column] - level
        # Windows, on what is tall and not green.
        wall = walls[where]
        stone = wall[:, 0] > wall[:, 1] * 0.96
        along = (x[seen, column] * across + y[seen, column] * down) % 2.6
        window = stone & (tops[seen, column] > 4.0) & (along > 0.8) & (along < 1.8)
        window &= (level % 3.0 > 0.9) & (level % 3.0 < 2.2) & (below > 0.7)
        wall = np.where(window[:, None], (0.33, 0.39, 0.45), wall * (0.8 + 0.05 * level[:, None]))
        colour = np.where((below > 0.25)[:, None], wall, above[where])
        haze = np.clip(distance[seen] / 110.0, 0.0, 0.6)[:, None]
        colour = (1.0 - haze) * colour + haze * np.array([0.86, 0.90, 0.93])
        blue = (1.0 - sky) * np.array([0.55, 0.71, 0.86]) + sky * np.array([0.93, 0.95, 0.96])
        picture[:, column] = np.where((hit == len(distance))[:, None], blue, colour)
    return np.clip(picture, 0.0, 1.0)


def draw_strip(picture: np.ndarray, frustum: Frustum, width: float) -> Figure:
    """Draw the panorama with its slices marked, ``width`` inches wide."""
    figure = Figure(figsize=(width, 2.95), facecolor="white")
    axes = figure.add_axes((0.8 / width, 0.05 / 2.95, (width - 1.6) / width, 2.2 / 2.95))
    axes.imshow(picture, extent=(0, frustum.slices, 0, 1), aspect="auto")
    axes.set(xlim=(0, frustum.slices), ylim=(-0.07, 1.0), xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    for n, colour in enumerate(slice_colours(frustum.slices)):
        axes.fill((n, n + 1, n + 1, n), (-0.07, -0.07, 0, 0), color=colour, linewidth=0)
        axes.fill((n, n + 1, n + 1, n), (0, 0, 1, 1), color=colour, linewidth=0, alpha=0.12)
        axes.text(
            n + 0.5, 1.03, str(n), ha="center", fontsize=8.5, fontweight="bold", color=0.72 * colour
        )
        axes.axvline(n, color="white", linewidth=1.4)
    figure.text(
        0.8 / width,
        1 - 0.42 / 2.95,
        f"A panorama, cut into {frustum.slices} slices …",
        fontsize=14,
        fontweight="bold",
        color="#17212b",
    )
    return figure


def pixels(figure: Figure) -> Image.Image:
    """Render a figure."""
    figure.set_dpi(140)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")


def main(path: str = "docs/images/slices.png") -> None:
    """Draw the picture and write it."""
    above, walls, height = light(build_town())
    margin = round((WORLD_M - TILE_M) / 2 * PIXELS_PER_METRE)
    tile = Image.fromarray((above[margin:-margin, margin:-margin] * 255).astype(np.uint8))
    masks = slice_masks([POSE], FRUSTUM, CELLS)[0]
    title = "… and the share of every aerial cell that each slice covers, exactly"
    lower = draw_pose(masks, POSE, FRUSTUM, aerial=tile, title=title)
    upper = draw_strip(panorama(above, walls, height, POSE), FRUSTUM, lower.get_figwidth())
    parts = [pixels(upper), pixels(lower)]
    whole = Image.new("RGB", (parts[1].width, parts[0].height + parts[1].height), "white")
    whole.paste(parts[0], (0, 0))
    whole.paste(parts[1], (0, parts[0].height))
    # Shades four levels apart look the same and make the file a third smaller.
    shades = np.minimum((np.asarray(whole, dtype=np.uint16) + 2) // 4 * 4, 255)
    Image.fromarray(shades.astype(np.uint8)).save(path, optimize=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
