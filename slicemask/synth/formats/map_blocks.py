"""The map of a generated city: rendered in blocks, and put together as one GeoTIFF."""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from slicemask.synth.formats.files import is_complete, write_picture
from slicemask.synth.formats.geotiff import Ground, is_map
from slicemask.synth.render.cameras import Aerial
from slicemask.synth.render.grade import Grade
from slicemask.synth.render.light import Light
from slicemask.synth.render.render import render
from slicemask.synth.render.scene import Scene

MAP_FILE = "map.tif"
PARTS_FOLDER = ".map"  # pieces of the map, until they are put together
BLOCK_PIXELS = 1024


class MapSpec(Protocol):
    """What a format's spec says of its map."""

    def map_ground(self) -> tuple[Ground, int]:
        """The map's place on Earth, and its side in pixels."""

    def aerial_scene(self) -> Scene:
        """What the map shows."""

    def random(self, *what: int) -> np.random.Generator:
        """Random numbers of a part of the city."""


@dataclass(frozen=True)
class MapTask:
    """Renders one block of the map."""

    root: Path
    spec: MapSpec
    row: int
    column: int

    images = 1

    @property
    def path(self) -> Path:
        """The block's file, until the map is put together."""
        return self.root / PARTS_FOLDER / f"{self.row}_{self.column}.png"

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns: less than a block's at the map's southern and eastern edges."""
        pixels = self.spec.map_ground()[1]
        left = pixels - BLOCK_PIXELS * np.array([self.row, self.column])
        rows, columns = np.minimum(left, BLOCK_PIXELS).tolist()
        return rows, columns

    def run(self) -> int:
        """Write the block unless it or the map is complete; give the number of images written."""
        ground, pixels = self.spec.map_ground()
        rows, columns = self.shape
        done = is_map(self.root / MAP_FILE, pixels)
        if done or is_complete(self.path, (columns, rows)):
            return 0
        rng = self.spec.random(3)  # the pictures from above are of one day
        light, grade = Light.draw(rng, aerial=True), Grade.draw(rng)
        # Which pixels get more rays depends on their neighbours: a pixel of those around the block.
        metres, half_m = ground.metres_per_pixel, ground.half_side_m
        corner = (
            -half_m + (self.column * BLOCK_PIXELS - 1) * metres,
            half_m - (self.row * BLOCK_PIXELS - 1) * metres,
        )
        camera = Aerial(corner, metres, (rows + 2, columns + 2))
        image = render(self.spec.aerial_scene(), camera, light)[1:-1, 1:-1]
        write_picture(self.path, grade.apply(image, self.spec.random(9, self.row, self.column)))
        return 1


def map_tasks(root: Path, spec: MapSpec) -> list[MapTask]:
    """The tasks that render the map."""
    blocks = range(-(-spec.map_ground()[1] // BLOCK_PIXELS))
    return [MapTask(root, spec, row, column) for row in blocks for column in blocks]


def write_map(root: Path, spec: MapSpec) -> None:
    """Put the map together from its blocks, and remove them."""
    ground, pixels = spec.map_ground()
    tasks = map_tasks(root, spec)
    path = root / MAP_FILE
    if not is_map(path, pixels):
        places = [(task.row * BLOCK_PIXELS, task.column * BLOCK_PIXELS) for task in tasks]
        ground.write_map(path, pixels, [task.path for task in tasks], places)
    for task in tasks:
        task.path.unlink(missing_ok=True)
    if (root / PARTS_FOLDER).exists():
        (root / PARTS_FOLDER).rmdir()
