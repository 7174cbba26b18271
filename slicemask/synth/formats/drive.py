"""Drives through a generated city: frames at camera rate, odometry, fixes, and the map.

A car with a panoramic camera that looks ahead drives along the streets, turns at junctions and
stops at some. Each drive is a table with a row for each frame: what the sensors said, and the
truth.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slicemask.errors import SynthError
from slicemask.synth.formats.files import is_complete, write_picture, write_text
from slicemask.synth.formats.geotiff import Ground
from slicemask.synth.formats.map_blocks import MapTask, map_tasks
from slicemask.synth.formats.vigor import CAMERA_HEIGHT_M, CITIES, LABEL_PIXELS
from slicemask.synth.layout.city import City, lay_out_city
from slicemask.synth.layout.routes import Motion, draw_route, drive_along
from slicemask.synth.layout.sensors import FIX_M, measure_fixes, measure_odometry
from slicemask.synth.render.cameras import Panorama
from slicemask.synth.render.grade import Grade
from slicemask.synth.render.light import Light
from slicemask.synth.render.render import render
from slicemask.synth.render.scene import Scene, View, build_scene

# Drives stay in the square that reaches so far from the city's centre.
REACH_M = 190.0
# Around it there is map for the tiles, and then city, so that no street ends in sight.
MAP_MARGIN_M, CITY_MARGIN_M = 45.0, 40.0
FIX_EVERY_S = 1.0
ROUTES = 100  # that are tried for a drive
FASTEST_MPS = 11.0


@dataclass(frozen=True)
class DriveSpec:
    """What decides every byte.

    Parameters
    ----------
    seed : int
        Of the city.
    drives : int
    seconds, rate_hz : float
        Of each drive, and of its frames.
    panorama_size : (columns, rows)
    tile_size : int
        Pixels of the map along a tile's side of VIGOR's format.
    """

    seed: int
    drives: int
    seconds: float
    rate_hz: float
    panorama_size: tuple[int, int]
    tile_size: int

    @property
    def frames(self) -> int:
        """Of each drive."""
        return max(1, round(self.seconds * self.rate_hz))

    def random(self, *what: int) -> np.random.Generator:
        """Random numbers of a part of the city."""
        return np.random.default_rng([self.seed, 300, *what])

    def map_ground(self) -> tuple[Ground, int]:
        """The map's place on Earth, and its side in pixels."""
        info = CITIES[0]
        metres = info.metres_per_pixel * LABEL_PIXELS / self.tile_size
        pixels = 2 * round((REACH_M + MAP_MARGIN_M) / metres)
        ground = Ground.around(info.latitude, info.longitude, pixels * metres / 2, metres)
        return ground, pixels

    def aerial_scene(self) -> Scene:
        """What the map shows."""
        return _scene(self, "aerial")


@dataclass(frozen=True)
class DrivePlan:
    """A city and the drives through it, before anything is rendered."""

    city: City
    motions: tuple[Motion, ...]


@lru_cache(maxsize=2)
def plan_drives(spec: DriveSpec) -> DrivePlan:
    """Lay out the city and choose its drives; its ground view is clear of cars in their way.

    Raises
    ------
    SynthError
        If its streets have no way as long as the drives.
    """
    city = lay_out_city((spec.seed, 300), REACH_M + MAP_MARGIN_M + CITY_MARGIN_M)
    motions = tuple(_draw_motion(spec, city, drive) for drive in range(spec.drives))
    places = np.concatenate([motion.places for motion in motions])
    spread = places[np.unique(np.rint(places), axis=0, return_index=True)[1]]
    return DrivePlan(city.clear_of_cars(spread), motions)


def _draw_motion(spec: DriveSpec, city: City, drive: int) -> Motion:
    rng = spec.random(1, drive)
    length_m = FASTEST_MPS * spec.seconds + 20.0
    for _ in range(ROUTES):
        route = draw_route(city, REACH_M, length_m, rng)
        motion = None if route is None else drive_along(route, spec.seconds, spec.rate_hz, rng)
        if motion is not None:
            return motion
    raise SynthError(
        f"seconds is {spec.seconds:g} and seed is {spec.seed}; the streets of that city have no "
        "way that is as long: choose fewer seconds or another seed"
    )


@lru_cache(maxsize=1)
def _scene(spec: DriveSpec, view: View) -> Scene:
    return build_scene(plan_drives(spec).city, view)


@dataclass(frozen=True)
class FrameTask:
    """Renders one frame of a drive."""

    root: Path
    spec: DriveSpec
    drive: int
    number: int

    images = 1

    def run(self) -> int:
        """Write the frame unless it is complete; give the number of images written."""
        spec = self.spec
        path = self.root / frame_path(self.drive, self.number)
        if is_complete(path, spec.panorama_size):
            return 0
        write_picture(path, self._pixels())
        return 1

    def _pixels(self) -> NDArray[np.uint8]:
        spec, motion = self.spec, plan_drives(self.spec).motions[self.drive]
        rng = spec.random(2, self.drive)  # light and sensor are those of the drive
        light, grade = Light.draw(rng), Grade.draw(rng)
        x, y = motion.places[self.number].tolist()
        camera = Panorama(
            (x, y, CAMERA_HEIGHT_M),
            spec.panorama_size[::-1],
            heading_deg=float(motion.headings_deg[self.number]),
        )
        image = render(_scene(spec, "ground"), camera, light)
        return grade.apply(image, spec.random(4, self.drive, self.number))


def frame_path(drive: int, number: int) -> Path:
    """The file of a frame, within the data set."""
    return Path(f"drive_{drive:02d}") / f"{number:05d}.jpg"


def list_tasks(root: Path, spec: DriveSpec) -> list[MapTask | FrameTask]:
    """The tasks that render the map and the frames."""
    frames = [
        FrameTask(root, spec, drive, number)
        for drive in range(spec.drives)
        for number in range(spec.frames)
    ]
    return [*map_tasks(root, spec), *frames]


def write_tables(root: Path, spec: DriveSpec) -> None:
    """Write the tables of the drives, and the camera."""
    plan, ground = plan_drives(spec), spec.map_ground()[0]
    for drive, motion in enumerate(plan.motions):
        lat, lon = ground.on_globe(motion.places)
        north_deg = ground.convergence_deg(motion.places)
        speed, yaw = measure_odometry(motion, spec.random(5, drive))
        fixes = ground.on_globe(measure_fixes(motion, spec.random(6, drive)))
        lines = [
            "time_s,ground,camera,speed_mps,yaw_rate_dps,gnss_lat,gnss_lon,gnss_accuracy_m,"
            "lat,lon,heading_deg"
        ]
        every = max(1, round(FIX_EVERY_S * spec.rate_hz))
        for k in range(spec.frames):
            fix = f"{fixes[0][k]:.9f},{fixes[1][k]:.9f},{FIX_M:g}" if k % every == 0 else ",,"
            heading_deg = (motion.headings_deg[k] + north_deg[k]) % 360.0
            lines.append(
                f"{motion.times_s[k]:.3f},{frame_path(drive, k).as_posix()},panorama,"
                f"{speed[k]:.4f},{yaw[k]:.4f},{fix},{lat[k]:.9f},{lon[k]:.9f},{heading_deg:.6f}"
            )
        write_text(root / f"drive_{drive:02d}.csv", "\n".join(lines) + "\n")
    write_text(root / "cameras.yaml", "panorama: {projection: equirectangular}\n")
