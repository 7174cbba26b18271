"""Generated drives in KITTI's on-disk format, with aerial tiles and splits as cut by LM.

Two cities: one for training and for the first test (same area), another for the second test (cross
area). Cameras look along their lanes, level, and stand ahead and to the right of the GPS unit,
around which the aerial tiles are centred, as the loaders of LM's data expect.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString

from slicemask.synth.formats.files import is_complete, write_picture, write_text
from slicemask.synth.formats.tiles import missing_tiles, write_tiles
from slicemask.synth.layout.city import City, lay_out_city
from slicemask.synth.layout.streets import point_and_direction
from slicemask.synth.render.cameras import Pinhole
from slicemask.synth.render.grade import Grade
from slicemask.synth.render.light import Light
from slicemask.synth.render.render import render
from slicemask.synth.render.scene import Scene, View, build_scene
from slicemask.synth.vary.pictures import AerialLook

# Web mercator at zoom 18, double scale, at KITTI's latitude.
METRES_PER_PIXEL = 156543.03392 * float(np.cos(np.radians(49.015))) / 2**18 / 2
CAMERA_AHEAD_M, CAMERA_RIGHT_M = 1.08, 0.26  # of the GPS unit
CAMERA_HEIGHT_M = 1.65
FOCAL_PIXELS, HORIZON_ROW = 721.5377, 172.854  # of images 1242 pixels wide and 375 high
COLUMNS, ROWS = 1242, 375
DATES = ("2011_09_26", "2011_09_28")
LATITUDE, LONGITUDE = 49.015, 8.42
METRES_PER_DEGREE = 111_320.0
FRAME_STEP_M = 4.0
FRAME_STEP_S = 0.4  # so that cars drive at 10 m/s: KITTI's frames are 0.1 s apart
MOST_FRAMES = 20  # of a drive
# About the fractions that LM's files have.
TRAIN_FRACTION, TEST1_FRACTION = 0.64, 0.12


@dataclass(frozen=True)
class KittiSpec:
    """What decides every byte of one of the two cities.

    Parameters
    ----------
    seed, area
        The layout's seed; 0 is the training area, 1 the other.
    counts
        Frames of each part in this area: training and first test, or the second test alone.
    image_size : (columns, rows)
        Of ground images. The focal length scales with the columns.
    tile_size
        Pixels a side of aerial tiles, at `METRES_PER_PIXEL` whatever their size.
    """

    seed: int
    area: int
    counts: tuple[int, ...]
    image_size: tuple[int, int]
    tile_size: int

    @property
    def focal_pixels(self) -> float:
        """Focal length of the ground images."""
        return FOCAL_PIXELS * self.image_size[0] / COLUMNS

    def random(self, *what: int) -> np.random.Generator:
        """Random numbers of a part of the city."""
        return np.random.default_rng([self.seed, 100 + self.area, *what])


@dataclass(frozen=True)
class KittiPlan:
    """A city and the frames taken in it, before anything is rendered.

    Parameters
    ----------
    city : City
        Its ground view is clear of cars around the cameras.
    gps, places : float64 [F, 2]
        GPS unit (the centre of the aerial tile) and camera, metres east and north of the city's
        centre. The GPS unit's places are whole aerial pixels apart.
    headings_deg : float64 [F]
        Clockwise from north.
    frames : F paths ``<date>/<drive>/<frame>.png``
    part : int [F]
        Index into the counts of the spec.
    """

    city: City
    gps: NDArray[np.float64]
    places: NDArray[np.float64]
    headings_deg: NDArray[np.float64]
    frames: tuple[str, ...]
    part: NDArray[np.intp]


def count_frames(frames: int) -> tuple[tuple[int, int], tuple[int]]:
    """Frames of (training, first test) and of (second test), none of them empty."""
    train = max(1, round(frames * TRAIN_FRACTION))
    test1 = max(1, round(frames * TEST1_FRACTION))
    return (train, test1), (max(1, frames - train - test1),)


@lru_cache(maxsize=1)
def plan_drives(spec: KittiSpec) -> KittiPlan:
    """Lay out a city and choose its drives."""
    total = sum(spec.counts)
    # Enough streets for all frames, and city as far as the tiles reach.
    reach_m = float(np.clip(np.sqrt(300.0 * total) / 2, 60.0, 400.0))
    half_extent_m = reach_m + spec.tile_size / 2 * METRES_PER_PIXEL + 10.0
    city = lay_out_city((spec.seed, 100 + spec.area), half_extent_m)
    rng = spec.random(1)
    lanes = _lanes_within(city, reach_m)
    lengths = np.array([lane.length for lane in lanes])
    places, headings, frames, parts = [], [], [], []
    drive = 0
    for part, count in enumerate(spec.counts):
        left = count
        while left:
            lane = lanes[rng.choice(len(lanes), p=lengths / lengths.sum())]
            run = min(left, MOST_FRAMES, int(lane.length / FRAME_STEP_M))
            start = rng.uniform(0, lane.length - (run - 1) * FRAME_STEP_M)
            drive += 1
            name = f"{DATES[spec.area]}/{DATES[spec.area]}_drive_{drive:04d}_sync"
            for frame in range(run):
                point, along = point_and_direction(lane, start + frame * FRAME_STEP_M)
                places.append(point + rng.normal(0, 0.15, 2))
                off_lane_deg = rng.normal(0, 1.0)
                headings.append((np.degrees(np.arctan2(along[0], along[1])) + off_lane_deg) % 360.0)
                frames.append(f"{name}/{frame:010d}.png")
                parts.append(part)
            left -= run
    headings_deg = np.array(headings)
    angle = np.radians(headings_deg)
    ahead = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    right = np.stack([np.cos(angle), -np.sin(angle)], axis=1)
    offset = CAMERA_AHEAD_M * ahead + CAMERA_RIGHT_M * right
    gps = np.rint((np.array(places) - offset) / METRES_PER_PIXEL) * METRES_PER_PIXEL
    cameras = gps + offset
    return KittiPlan(
        city.clear_of_cars(cameras), gps, cameras, headings_deg, tuple(frames), np.array(parts)
    )


def _lanes_within(city: City, reach_m: float) -> list[LineString]:
    """Stretches of lanes in the square that reaches so far from the centre."""
    square = shapely.box(-reach_m, -reach_m, reach_m, reach_m)
    inside = shapely.intersection(np.array(city.drives(), dtype=object), square)
    return [
        part
        for part in shapely.get_parts(inside)
        if isinstance(part, LineString) and part.length > 10.0
    ]


@lru_cache(maxsize=1)
def _scene(spec: KittiSpec, view: View) -> Scene:
    return build_scene(plan_drives(spec).city, view)


@dataclass(frozen=True)
class GroundTask:
    """Renders the ground image of one frame."""

    root: Path
    spec: KittiSpec
    number: int

    images = 1

    def run(self) -> int:
        """Write the image unless it is complete; give the number of images written."""
        plan, spec = plan_drives(self.spec), self.spec
        path = ground_path(self.root, plan.frames[self.number])
        if is_complete(path, spec.image_size):
            return 0
        columns, rows = spec.image_size
        x, y = plan.places[self.number].tolist()
        camera = Pinhole(
            (x, y, CAMERA_HEIGHT_M),
            float(plan.headings_deg[self.number]),
            (rows, columns),
            spec.focal_pixels,
            HORIZON_ROW * rows / ROWS,
        )
        rng = spec.random(2, self.number)
        image = render(_scene(spec, "ground"), camera, Light.draw(rng))
        write_picture(path, Grade.draw(rng).apply(image, rng))
        return 1


@dataclass(frozen=True)
class DriveTilesTask:
    """Renders the aerial tiles of a drive, which overlap, in one picture."""

    root: Path
    spec: KittiSpec
    numbers: tuple[int, ...]

    @property
    def images(self) -> int:
        """Number of tiles."""
        return len(self.numbers)

    def run(self) -> int:
        """Write the tiles that are not complete; give the number of images written."""
        plan, spec = plan_drives(self.spec), self.spec
        paths = [self.root / "satmap" / plan.frames[number] for number in self.numbers]
        missing = missing_tiles(paths, spec.tile_size)
        if missing:
            rng = spec.random(3)  # the pictures from above are of one day
            write_tiles(
                _scene(spec, "aerial"),
                plan.gps[list(self.numbers)],
                METRES_PER_PIXEL,
                spec.tile_size,
                AerialLook(Light.draw(rng, aerial=True), Grade.draw(rng)),
                {k: (paths[k], spec.random(4, self.numbers[k])) for k in missing},
            )
        return len(missing)


def ground_path(root: Path, frame: str) -> Path:
    """The ground image of a frame ``<date>/<drive>/<frame>.png``."""
    path = Path(frame)
    return root / "raw_data" / path.parent / "image_02" / "data" / path.name


def list_tasks(root: Path, spec: KittiSpec) -> list[DriveTilesTask | GroundTask]:
    """The tasks that render one of the two cities."""
    drives: dict[str, list[int]] = {}
    for number, frame in enumerate(plan_drives(spec).frames):
        drives.setdefault(frame.rsplit("/", 1)[0], []).append(number)
    tiles = [DriveTilesTask(root, spec, tuple(numbers)) for numbers in drives.values()]
    return [*tiles, *(GroundTask(root, spec, number) for number in range(sum(spec.counts)))]


def write_records(root: Path, spec: KittiSpec) -> None:
    """Write a city's oxts and calibration files, and its split files."""
    plan = plan_drives(spec)
    east_m = METRES_PER_DEGREE * np.cos(np.radians(LATITUDE))
    speeds = _speeds(plan)
    for frame, gps, heading_deg, speed in zip(
        plan.frames, plan.gps, plan.headings_deg, speeds, strict=True
    ):
        # Radians, 0 east, counter-clockwise, in [-pi, pi).
        yaw = np.radians((90.0 - heading_deg + 180.0) % 360.0 - 180.0)
        latitude = LATITUDE + gps[1] / METRES_PER_DEGREE
        longitude = LONGITUDE + gps[0] / east_m
        # latitude, longitude, altitude, roll, pitch, yaw; then speeds, accelerations (none), and
        # how fast the car turns: about its upright axis alone.
        north, east, forward, left, turning = speed
        fields = [latitude, longitude, 112.8, 0.0, 0.0, yaw, north, east, forward, left, 0.0]
        fields += [0.0] * 6 + [0.0, 0.0, turning, 0.0, 0.0, turning]
        text = " ".join(f"{value:.13f}" for value in fields)
        path = ground_path(root, frame)
        oxts = path.parents[2] / "oxts" / "data" / f"{path.stem}.txt"
        write_text(oxts, f"{text} 0.05 0.01 4 10 4 4 0\n")
    for folder, count in _counts(plan).items():
        write_text(root / "raw_data" / folder / "oxts" / "timestamps.txt", _times(count))
    columns, rows = spec.image_size
    focal = spec.focal_pixels
    matrix = [focal, 0, columns / 2, 0, 0, focal, HORIZON_ROW * rows / ROWS, 0, 0, 0, 1, 0]
    write_text(
        root / "raw_data" / DATES[spec.area] / "calib_cam_to_cam.txt",
        f"S_rect_02: {columns:.6e} {rows:.6e}\n"
        f"P_rect_02: {' '.join(f'{value:.6e}' for value in matrix)}\n",
    )
    rng = spec.random(5)
    for part in range(len(spec.counts)):
        frames = [plan.frames[k] for k in np.flatnonzero(plan.part == part)]
        if spec.area == 0 and part == 0:
            name, lines = "train", frames
        else:
            name = "test2" if spec.area else "test1"
            draws = rng.uniform(-1, 1, (len(frames), 3))
            lines = [
                f"{frame} {sx:.6f} {sy:.6f} {theta:.6f}"
                for frame, (sx, sy, theta) in zip(frames, draws, strict=True)
            ]
        write_text(root / f"{name}_files.txt", "".join(line + "\n" for line in lines))


def _counts(plan: KittiPlan) -> dict[str, int]:
    """How many frames each drive has."""
    counts: dict[str, int] = {}
    for frame in plan.frames:
        drive = frame.rsplit("/", 1)[0]
        counts[drive] = counts.get(drive, 0) + 1
    return counts


def _times(count: int) -> str:
    """The times of a drive's frames, one a line, at noon."""
    lines = []
    for number in range(count):
        seconds = number * FRAME_STEP_S
        lines.append(f"2011-09-26 12:{int(seconds // 60):02d}:{seconds % 60:012.9f}\n")
    return "".join(lines)


def _speeds(plan: KittiPlan) -> NDArray[np.float64]:
    """Speeds to the north, east, ahead and left, m/s, and yaw rates, rad/s: float64 [F, 5].

    They are means between the frames before and after, or between one of these and the frame, as
    places and headings change; of a drive of one frame they are 0.
    """
    found = np.zeros((len(plan.frames), 5))
    first = 0
    for count in _counts(plan).values():
        part = slice(first, first + count)
        first += count
        if count == 1:
            continue
        angle = np.unwrap(np.radians(plan.headings_deg[part]))
        east, north = np.gradient(plan.gps[part], FRAME_STEP_S, axis=0).T
        sin, cos = np.sin(angle), np.cos(angle)
        turning = -np.gradient(angle, FRAME_STEP_S)
        ahead, left = east * sin + north * cos, north * sin - east * cos
        found[part] = np.stack([north, east, ahead, left, turning], axis=1)
    return found
