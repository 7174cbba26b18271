"""A generated city as photographs of one's own: a map, tables of photographs, and the truth.

The city, the places of its panoramas and their looks are those of VIGOR's format with the same
seed. Each place is photographed twice, by a panorama that faces any heading and by a pinhole camera
whose principal point is off the centre. The tables hold the truth, and the photographs' EXIF data
what a phone would write: a position and a compass that are a little off.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slicemask.synth.formats.exif import photograph_exif
from slicemask.synth.formats.files import is_complete, write_picture, write_text
from slicemask.synth.formats.geotiff import Ground
from slicemask.synth.formats.map_blocks import MapTask, map_tasks
from slicemask.synth.formats.vigor import CAMERA_HEIGHT_M, CITIES, VigorSpec, plan_city
from slicemask.synth.render.cameras import Panorama, Pinhole
from slicemask.synth.render.grade import Grade
from slicemask.synth.render.light import Light
from slicemask.synth.render.render import render
from slicemask.synth.render.scene import Scene, View, build_scene

# Ground around the outermost tiles of VIGOR's format, so that tiles can be cut off their centres.
MARGIN_M = 25.0
PHONE_HEIGHT_M = 1.65
# Of pinhole images 640 pixels wide: their focal length, and how far the principal point is off.
WIDTH, FOCAL_PIXELS, OFF_CENTRE_PIXELS = 640, 500.0, 40.0
# Standard deviations of what EXIF data say: metres to the east and to the north, and degrees.
GPS_NOISE_M, COMPASS_NOISE_DEG = 5.0, 5.0


@dataclass(frozen=True)
class TableSpec:
    """What decides every byte.

    Parameters
    ----------
    seed
        Of the city.
    panoramas
        Places where a panorama and a pinhole image are taken.
    panorama_size, image_size : (columns, rows)
    tile_size
        Pixels of the map along a tile's side of VIGOR's format.
    """

    seed: int
    panoramas: int
    panorama_size: tuple[int, int]
    image_size: tuple[int, int]
    tile_size: int

    @property
    def city(self) -> VigorSpec:
        """The same city in VIGOR's format."""
        return VigorSpec(self.seed, 0, self.panoramas, self.panorama_size, self.tile_size)

    def random(self, *what: int) -> np.random.Generator:
        """Random numbers of a part of the city."""
        return self.city.random(*what)

    def map_ground(self) -> tuple[Ground, int]:
        """The map's place on Earth, and its side in pixels."""
        plan = plan_photographs(self)
        return plan.ground, plan.map_pixels

    def aerial_scene(self) -> Scene:
        """What the map shows."""
        return _scene(self.city, "aerial")

    @property
    def scale(self) -> float:
        """By which the intrinsic parameters of the pinhole images are scaled."""
        return self.image_size[0] / WIDTH

    @property
    def principal_point(self) -> tuple[float, float]:
        """Column and row, of pinhole images."""
        columns, rows = self.image_size
        return columns / 2 + OFF_CENTRE_PIXELS * self.scale, rows / 2


@dataclass(frozen=True)
class TablePlan:
    """Where photographs are taken, before anything is rendered.

    Parameters
    ----------
    ground : Ground
        The map's place on Earth.
    map_pixels : int
        Side of the map.
    lat, lon : float64 [P]
        Of the places, degrees.
    headings_deg : dict of str to float64 [P]
        Of the "panoramas" and of the "front" images, clockwise from true north.
    split : list of str
        "train" or "test".
    """

    ground: Ground
    map_pixels: int
    lat: NDArray[np.float64]
    lon: NDArray[np.float64]
    headings_deg: dict[str, NDArray[np.float64]]
    split: list[str]


@lru_cache(maxsize=2)
def plan_photographs(spec: TableSpec) -> TablePlan:
    """Choose the headings of photographs, and lay the city on the globe."""
    plan, city = plan_city(spec.city), spec.city
    metres = city.metres_per_pixel
    step = round(city.step_m / metres)
    pixels = (plan.tiles_a_side - 1) * step + spec.tile_size + 2 * round(MARGIN_M / metres)
    info = CITIES[0]
    ground = Ground.around(info.latitude, info.longitude, pixels * metres / 2, metres)
    lat, lon = ground.on_globe(plan.places)
    rng = city.random(6)
    # A panorama is rolled by whole columns.
    columns = rng.integers(spec.panorama_size[0], size=spec.panoramas)
    on_grid = {
        "panoramas": columns * 360.0 / spec.panorama_size[0],
        "front": rng.uniform(0.0, 360.0, spec.panoramas),
    }
    off_north_deg = ground.convergence_deg(plan.places)
    order = city.random(5).permutation(spec.panoramas)
    training = set(order[: (spec.panoramas + 1) // 2].tolist())
    return TablePlan(
        ground,
        pixels,
        lat,
        lon,
        {kind: (heading + off_north_deg) % 360.0 for kind, heading in on_grid.items()},
        ["train" if k in training else "test" for k in range(spec.panoramas)],
    )


@lru_cache(maxsize=1)
def _scene(spec: VigorSpec, view: View) -> Scene:
    return build_scene(plan_city(spec).city, view)


@dataclass(frozen=True)
class PhotographTask:
    """Renders one photograph: a panorama, or an image of the pinhole camera."""

    root: Path
    spec: TableSpec
    kind: str
    number: int

    images = 1

    def run(self) -> int:
        """Write the photograph unless it is complete; give the number of images written."""
        spec = self.spec
        path = photograph_path(self.root, self.kind, self.number)
        size = spec.panorama_size if self.kind == "panoramas" else spec.image_size
        if is_complete(path, size):
            return 0
        pixels = self._panorama() if self.kind == "panoramas" else self._front()
        write_picture(path, pixels, exif=self._exif())
        return 1

    def _on_grid_deg(self) -> float:
        """Heading from the map's north, which is not true north."""
        plan = plan_photographs(self.spec)
        place = plan_city(self.spec.city).places[self.number : self.number + 1]
        heading_deg = plan.headings_deg[self.kind][self.number]
        return float(heading_deg - plan.ground.convergence_deg(place)[0])

    def _panorama(self) -> NDArray[np.uint8]:
        city = self.spec.city
        rng = city.random(2, self.number)
        x, y = plan_city(city).places[self.number].tolist()
        position = (x, y, CAMERA_HEIGHT_M + float(rng.normal(0, 0.08)))
        camera = Panorama(position, city.panorama_size[::-1])
        image = render(_scene(city, "ground"), camera, Light.draw(rng))
        pixels = Grade.draw(rng).apply(image, rng)
        columns = round(self._on_grid_deg() * city.panorama_size[0] / 360.0)
        return np.roll(pixels, -columns, axis=1)

    def _front(self) -> NDArray[np.uint8]:
        spec, city = self.spec, self.spec.city
        rng = city.random(8, self.number)
        x, y = plan_city(city).places[self.number].tolist()
        column, row = spec.principal_point
        camera = Pinhole(
            (x, y, PHONE_HEIGHT_M),
            self._on_grid_deg(),
            spec.image_size[::-1],
            FOCAL_PIXELS * spec.scale,
            row,
            column,
        )
        image = render(_scene(city, "ground"), camera, Light.draw(rng))
        return Grade.draw(rng).apply(image, rng)

    def _exif(self) -> bytes:
        spec, plan = self.spec, plan_photographs(self.spec)
        front = self.kind == "front"
        rng = spec.city.random(7, self.number, front)
        place = plan_city(spec.city).places[self.number] + rng.normal(0.0, GPS_NOISE_M, 2)
        lat, lon = plan.ground.on_globe(place[None])
        compass_deg = plan.headings_deg[self.kind][self.number]
        focal_mm = FOCAL_PIXELS * spec.scale * math.hypot(36, 24) / math.hypot(*spec.image_size)
        return photograph_exif(
            float(lat[0]),
            float(lon[0]),
            (compass_deg + rng.normal(0.0, COMPASS_NOISE_DEG)) % 360.0,
            GPS_NOISE_M,
            focal_mm if front else None,
        )


def photograph_path(root: Path, kind: str, number: int) -> Path:
    """The file of a photograph."""
    return root / kind / f"{number:05d}.jpg"


def list_tasks(root: Path, spec: TableSpec) -> list[MapTask | PhotographTask]:
    """The tasks that render the map and the photographs."""
    photographs = [
        PhotographTask(root, spec, kind, number)
        for kind in ("panoramas", "front")
        for number in range(spec.panoramas)
    ]
    return [*map_tasks(root, spec), *photographs]


def write_tables(root: Path, spec: TableSpec) -> None:
    """Write the tables of panoramas and of pinhole images with the truth, and the cameras."""
    plan = plan_photographs(spec)
    for name, kind, camera in (("photos", "panoramas", "panorama"), ("front", "front", "front")):
        lines = ["id,ground,lat,lon,heading_deg,camera,split"]
        for number, part in enumerate(plan.split):
            cells: Sequence[str] = (
                f"{kind}{number:05d}",
                photograph_path(Path(), kind, number).as_posix(),
                f"{plan.lat[number]:.9f}",
                f"{plan.lon[number]:.9f}",
                f"{plan.headings_deg[kind][number]:.6f}",
                camera,
                part,
            )
            lines.append(",".join(cells))
        write_text(root / f"{name}.csv", "\n".join(lines) + "\n")
    columns, rows = spec.image_size
    cx, cy = spec.principal_point
    write_text(
        root / "cameras.yaml",
        "panorama: {projection: equirectangular}\n"
        f"front: {{projection: pinhole, width: {columns}, height: {rows}, "
        f"fx: {FOCAL_PIXELS * spec.scale:g}, cx: {cx:g}, cy: {cy:g}}}\n",
    )
