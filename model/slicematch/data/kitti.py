"""KITTI as cut by LM: a forward camera and an aerial tile around the car's GPS position.

Geiger, Lenz, Stiller, Urtasun, "Vision meets Robotics: The KITTI Dataset", IJRR 2013; cut and
split by Shi, Li, "Beyond Cross-view Image Retrieval: Highly Accurate Vehicle Localization Using
Satellite Image" (LM), CVPR 2022.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from slicemask import Frustum
from slicemask.errors import ImageError, SpecError
from slicemask.images import read_aerial, read_image, resize
from slicematch.data.elevations import check_elevations, frame_ground
from slicematch.data.errors import DatasetError, SampleError
from slicematch.data.source import DataConfig, Part, Source
from slicematch.data.text import parse_number, read_lines

TEST_FILES = {"same-area": "test1_files.txt", "cross-area": "test2_files.txt"}

# Of the aerial tiles: web mercator at zoom 18, double scale, at KITTI's latitude.
METRES_PER_PIXEL = 156543.03392 * math.cos(math.radians(49.015)) / 2**18 / 2
CROP_PIXELS = 512
SPAN_M = CROP_PIXELS * METRES_PER_PIXEL
SHIFT_RANGE_M = 20.0
# From the GPS unit, at the tile's centre, to the camera: metres ahead and metres to the left.
CAMERA_OFFSET_M = np.array([1.08, -0.26])
DEFAULT_HFOV_DEG = 81.5


@dataclass(frozen=True, kw_only=True)
class KittiConfig(DataConfig):
    """Settings of a KITTI data set: those of `DataConfig` and the following.

    The sizes and grids are the paper's (SliceMatch, CVPR 2023, section 4.2). A heading prior is
    centred on east, where the car drives before the aerial tile is turned: a half width of 10 is
    what LM calls a 20-degree prior, None turns the tile by up to 180 degrees to either side. The
    same-area test file is test1, in the training area; cross-area is test2, elsewhere.

    Parameters
    ----------
    split_dir : path or None
        The folder of ``train_files.txt``, ``test1_files.txt`` and ``test2_files.txt``; None for
        the root.

    Raises
    ------
    DatasetError
        If a value is out of its range.
    """

    projection = "pinhole"
    ground_aspect = 1242 / 375
    camera_height_m = 1.65
    prior_centre_deg = 90.0
    train_grid = "5x5x16"
    test_grid = "15x15x64"

    ground_size: tuple[int, int] = (256, 1024)
    split_dir: str | None = None

    def default_extent(self) -> tuple[float, float, float, float]:
        """The square in the middle where all cameras stand (ours).

        They stand within 20 m of the centre of a 100.26 m tile, along and across the heading, and
        are then turned with it. The paper does not say what its grid fills, but 49 % of its
        lateral errors are below 1 m, and 15 columns over the whole tile would allow at most 30 %.
        """
        half_width = self.heading_half_width_deg
        rotation = math.radians(min(45.0, 180.0 if half_width is None else half_width))
        reach_m = SHIFT_RANGE_M * (math.cos(rotation) + math.sin(rotation))
        half = math.ceil(100 * reach_m / SPAN_M) / 100  # a hundredth, for the sake of names
        low, high = round(0.5 - half, 2), round(0.5 + half, 2)
        return low, low, high, high

    def open(self, part: Part) -> "KittiSource":
        """Open the samples of a part; see `DataConfig.open`."""
        return KittiSource(self, part)


def camera_pose(shift: NDArray[np.float64], rotation_deg: float) -> NDArray[np.float64]:
    """The camera's pose in a crop cut with a shift and a turn, in closed form.

    Parameters
    ----------
    shift : float64 [2]
        Metres that the camera lies right of and above the crop's centre before the turn.
    rotation_deg : float
        Degrees counter-clockwise that the crop is turned by, about its centre.

    Returns
    -------
    float64 [3]
        u, v, heading_deg in the crop.
    """
    right, up = _rotation(np.radians(rotation_deg)) @ shift
    # Twice, because the first may round a tiny negative number up to 360 itself.
    heading_deg = (90.0 - rotation_deg) % 360.0 % 360.0
    return np.array([0.5 + right / SPAN_M, 0.5 - up / SPAN_M, heading_deg])


def cut_tile(
    tile: Image.Image, heading: float, shift: NDArray[np.float64], rotation_deg: float
) -> Image.Image:
    """Cut LM's 512-pixel crop out of an aerial tile, in one affine resampling.

    In LM's words: turn the tile so that the car drives east, move the camera to the centre, shift,
    turn counter-clockwise, crop. Here each pixel of the crop is traced back to the tile, which is
    sampled once, bilinearly; what lies off the tile is black.

    Parameters
    ----------
    tile : PIL.Image.Image
        Centred on the GPS unit, north up, at `METRES_PER_PIXEL`.
    heading : float
        Radians, 0 east, counter-clockwise.
    shift : float64 [2]
        Metres that the camera lies right of and above the crop's centre before the turn.
    rotation_deg : float
        Degrees counter-clockwise that the crop is turned by, about its centre.

    Returns
    -------
    PIL.Image.Image
        512x512 pixels.
    """
    # East and north of the tile's centre, in metres: q = A p + b for right and up p in the crop.
    unrotate = _rotation(-np.radians(rotation_deg))
    matrix = _rotation(heading) @ unrotate
    offset = _rotation(heading) @ (CAMERA_OFFSET_M - shift)
    # The same in pixels from the top left corner, where y grows down.
    flip = np.diag([1.0, -1.0])
    matrix = flip @ matrix @ flip
    origin = (
        np.array(tile.size) / 2
        + flip @ offset / METRES_PER_PIXEL
        - matrix @ np.full(2, CROP_PIXELS / 2)
    )
    coefficients = (*matrix[0], origin[0], *matrix[1], origin[1])
    return tile.transform(
        (CROP_PIXELS, CROP_PIXELS), Image.Transform.AFFINE, coefficients, Image.Resampling.BILINEAR
    )


def _rotation(angle: float) -> NDArray[np.float64]:
    """Rotation by an angle in radians, counter-clockwise where the second axis points up."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


class KittiSource(Source):
    """KITTI's left colour camera and the aerial crop around it.

    Test samples have the shift and turn of their test file. Training and validation draw them at
    random: +-20 m along and across the driving direction and +-`heading_half_width_deg`.

    Parameters
    ----------
    config : KittiConfig
        Settings.
    part : {"train", "validation", "test"}
        Training and validation share the training file (`validation_fraction`).

    Raises
    ------
    DatasetError
        If a split or calibration file is missing or broken.
    """

    def __init__(self, config: KittiConfig, part: Part) -> None:
        self.config = config
        self._root = Path(config.root)
        name = TEST_FILES[config.split] if part == "test" else "train_files.txt"
        folder = Path(config.split_dir or config.root)
        paths, self._draws = read_split(folder / name, with_pose=part == "test")
        chosen = config.choose(part, len(paths))
        self.names = [paths[k] for k in chosen]
        self.tile_metres = np.full(len(chosen), SPAN_M)
        if config.hfov_deg is None:
            self._view = find_view(self._root)
        else:
            self._view = CameraView(config.hfov_deg, config.left_deg, config.horizon)
        self.hfov_deg, self.left_deg, self.horizon = self._view
        check_elevations(
            config.elevations,
            config.projection,
            self.hfov_deg,
            config.ground_aspect,
            self.left_deg,
            self.horizon,
        )

    def pose(self, index: int, random: np.random.Generator) -> NDArray[np.float64]:
        """The true pose of a sample; see `Source.pose`."""
        return camera_pose(*self._cut(index, random))

    def images(self, index: int, random: np.random.Generator) -> tuple[Image.Image, Image.Image]:
        """The images of a sample; see `Source.images`."""
        drive, frame = self.names[index].rsplit("/", 1)
        raw = self._root / "raw_data" / drive
        ground_file = raw / "image_02" / "data" / frame
        config = self.config
        ground = frame_ground(
            read_image(ground_file),
            config.ground_aspect,
            config.ground_fit,
            config.elevations,
            *self._view,
        )
        tile_file = self._root / "satmap" / drive / frame
        tile = read_aerial(tile_file)
        if tile.width < CROP_PIXELS:
            raise ImageError(
                f"{tile_file}: {tile.width}x{tile.height} pixels; an aerial tile must not be "
                f"smaller than its crop of {CROP_PIXELS}x{CROP_PIXELS}, so fetch the original"
            )
        heading = read_heading(raw / "oxts" / "data" / Path(frame).with_suffix(".txt"))
        aerial = cut_tile(tile, heading, *self._cut(index, random))
        size = self.config.aerial_size
        if size != CROP_PIXELS:
            aerial = resize(aerial, (size, size))
        return resize(ground, self.config.ground_size), aerial

    def _cut(self, index: int, random: np.random.Generator) -> tuple[NDArray[np.float64], float]:
        """The shift (right and up, metres) and turn (degrees) that a sample is cut with."""
        *shift, rotation = random.uniform(-1, 1, 3) if self._draws is None else self._draws[index]
        prior = self.config.heading_prior
        return SHIFT_RANGE_M * np.array(shift), (180.0 if prior is None else prior[1]) * rotation


def read_split(path: str | Path, with_pose: bool) -> tuple[list[str], NDArray[np.float64] | None]:
    """Read a split file of LM: a path on each line and, in test files, sx, sy and theta.

    Parameters
    ----------
    path : path
        The file.
    with_pose : bool
        Whether it is a test file. Its sx, sy and theta lie in [-1, 1].

    Returns
    -------
    paths : list of str
        ``<date>/<drive>/<frame>.png``, n of them; the same frame may come several times.
    draws : float64 [n, 3] or None
        sx, sy, theta; None for a file without them.

    Raises
    ------
    DatasetError
        If the file is missing or a line is invalid; the text names the file, line and field.
    """
    path = Path(path)
    hint = "it comes with HighlyAccurate (LM), not with the images; put it there or set split_dir"
    form = f"<date>/<drive>/<frame>.png{' sx sy theta, those in [-1, 1]' if with_pose else ''}"
    paths, draws = [], []
    for number, line in read_lines(path, "the split file", hint):
        name, *fields = line.split()
        values = [parse_number(field) for field in fields]
        fault = None
        if not (name.count("/") == 2 and name.endswith(".png")):
            fault = f"field 1 is {name!r}"
        elif len(values) != (3 if with_pose else 0):
            fault = f"{len(values)} fields follow the path"
        else:
            for column, (field, value) in enumerate(zip(fields, values, strict=True), start=2):
                if value is None or abs(value) > 1:
                    fault = f"field {column} is {field!r}"
                    break
        if fault:
            raise DatasetError(
                f"{path}, line {number}: is no sample, since {fault}; expected {form}"
            )
        paths.append(name)
        draws.append(values)
    return paths, np.array(draws, dtype=np.float64) if with_pose else None


def read_heading(path: str | Path) -> float:
    """Read the heading of a frame: radians, 0 east, counter-clockwise.

    Raises
    ------
    SampleError
        If the oxts file is missing or its first line has no finite field 5.
    """
    try:
        _, line = read_lines(Path(path), "the oxts file", "fetch it again")[0]
    except DatasetError as error:  # it is one sample that lacks it
        raise SampleError(str(error)) from error
    fields = line.split()
    heading = parse_number(fields[5]) if len(fields) > 5 else None
    if heading is None:
        found = repr(fields[5]) if len(fields) > 5 else f"missing: there are {len(fields)} fields"
        raise SampleError(
            f"{path}: field 5 (from 0), the heading in radians, is {found}; expected a number: "
            "fetch the file again"
        )
    return heading


class CameraView(NamedTuple):
    """What a pinhole camera shows, whatever its images' size.

    Attributes
    ----------
    hfov_deg : float
        Horizontal field of view.
    left_deg : float or None
        Azimuth of the image's left edge from the optical axis; None for an axis in the centre.
    horizon : float
        Where the optical axis is, from the image's top, as a fraction of its height.
    """

    hfov_deg: float
    left_deg: float | None = None
    horizon: float = 0.5


def find_view(root: str | Path) -> CameraView:
    """What the ground images show: the median of the days' calibration files.

    The field of view differs by up to 0.4 degrees from day to day (81.4 to 81.8), the principal
    point by some pixels; one value serves all, since one bank of masks does. Without any
    calibration file it is 81.5, and the principal point in the centre.

    Raises
    ------
    DatasetError
        If a calibration file has no usable ``P_rect_02``.
    """
    files = sorted(Path(root).glob("raw_data/*/calib_cam_to_cam.txt"))
    if not files:
        return CameraView(DEFAULT_HFOV_DEG)
    frusta, horizons = zip(*map(read_calibration, files), strict=True)
    if all(frustum.left_deg is None for frustum in frusta):
        hfov_deg = float(np.median([frustum.hfov_deg for frustum in frusta]))
        return CameraView(hfov_deg, None, float(np.median(horizons)))
    right_deg = float(np.median([frustum.right_deg for frustum in frusta]))
    left_deg = float(np.median([frustum.right_deg - frustum.hfov_deg for frustum in frusta]))
    return CameraView(right_deg - left_deg, left_deg, float(np.median(horizons)))


def read_calibration(path: str | Path) -> tuple[Frustum, float]:
    """Read the left colour camera off a calibration file.

    Its focal length and principal point are the 1st, 3rd and 7th number of ``P_rect_02``, the size
    of its images the two of ``S_rect_02`` or, without it, 1242x375.

    Returns
    -------
    frustum : Frustum
        Of one slice.
    horizon : float
        Where the optical axis is, from the image's top, as a fraction of its height.

    Raises
    ------
    DatasetError
        If there are no such numbers, or they are no camera's.
    """
    lines = read_lines(Path(path), "the calibration file", "fetch it again")
    parts = (line.partition(":") for _, line in lines)
    rows = {key.strip(): rest.split() for key, _, rest in parts}

    def number(key: str, position: int) -> float:
        row = rows.get(key, [])
        value = parse_number(row[position]) if position < len(row) else None
        if value is None:
            raise DatasetError(
                f"{path}: {key} is {' '.join(row) or 'missing'!r}, so there is no focal length and "
                "principal point; expected a line 'P_rect_02: ' and twelve numbers"
            )
        return value

    width, height = 1242.0, 375.0
    if "S_rect_02" in rows:
        width, height = number("S_rect_02", 0), number("S_rect_02", 1)
    focal, cx, cy = (number("P_rect_02", position) for position in (0, 2, 6))
    try:
        frustum = Frustum.from_intrinsics(focal, cx, width, 1)
    except SpecError as error:
        raise DatasetError(
            f"{path}: focal length {focal:g}, principal point {cx:g} and width {width:g} are no "
            f"camera's ({error}); expected some 720, 610 and 1242"
        ) from error
    if not 0.0 < cy < height:
        raise DatasetError(
            f"{path}: the principal point's row is {cy:g} of {height:g}; expected some 173 of 375"
        )
    return frustum, cy / height
