"""KITTI as cut by LM: a forward camera and an aerial tile around the car's GPS position.

Geiger, Lenz, Stiller, Urtasun, "Vision meets Robotics: The KITTI Dataset", IJRR 2013; cut and
split by Shi, Li, "Beyond Cross-view Image Retrieval: Highly Accurate Vehicle Localization Using
Satellite Image" (LM), CVPR 2022.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import torch
from PIL import Image

from slicematch.data.dataset import BadSamples, DataConfig, PoseDataset, read_lines
from slicematch.data.errors import DatasetError, ImageError, SampleError
from slicematch.data.images import check_shape, normalise, read_image, resize

Test = Literal["test1", "test2"]

# Of the aerial tiles: web mercator at zoom 18, double scale, at KITTI's latitude.
METRES_PER_PIXEL = 156543.03392 * np.cos(np.radians(49.015)) / 2**18 / 2
CROP_PIXELS = 512
SPAN_M = CROP_PIXELS * METRES_PER_PIXEL
SHIFT_RANGE_M = 20.0
# From the GPS unit, at the tile's centre, to the camera: metres ahead and metres to the left.
CAMERA_OFFSET_M = np.array([1.08, -0.26])
GROUND_ASPECT = 1242 / 375
DEFAULT_HFOV_DEG = 81.5


@dataclass(frozen=True, kw_only=True)
class KittiConfig(DataConfig):
    """Settings of a KITTI data set: those of `DataConfig` and the following.

    Parameters
    ----------
    ground_size, aerial_size
        256x1024 and 512 by default, as in the paper.
    heading_prior_deg
        Is centred on east, where the car drives before the aerial tile is turned: 10 is what
        LM calls a 20-degree prior, None turns the tile by up to 180 degrees to either side.
    test : {"test1", "test2"}
        The test file: test1 in the training area (same area), test2 elsewhere (cross area).
    splits : path or None
        The folder of ``train_files.txt``, ``test1_files.txt`` and ``test2_files.txt``; the root
        by default.

    Raises
    ------
    DatasetError
        If a value is out of its range.
    """

    ground_size: tuple[int, int] = (256, 1024)
    test: Test = "test1"
    splits: str | Path | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.test not in get_args(Test):
            raise DatasetError(
                f"test is {self.test!r}; it must be one of {', '.join(get_args(Test))}"
            )


def camera_pose(shift: np.ndarray, turn_deg: float) -> np.ndarray:
    """The camera's pose in a crop cut with a shift and a turn, in closed form.

    Parameters
    ----------
    shift : float64 [2]
        Metres that the camera lies right of and above the crop's centre before the turn.
    turn_deg : float
        Degrees counter-clockwise that the crop is turned by, about its centre.

    Returns
    -------
    float64 [3]
        u, v, heading_deg in the crop.
    """
    right, up = _rotation(np.radians(turn_deg)) @ shift
    # Twice, because the first may round a tiny negative number up to 360 itself.
    heading_deg = (90.0 - turn_deg) % 360.0 % 360.0
    return np.array([0.5 + right / SPAN_M, 0.5 - up / SPAN_M, heading_deg])


def cut_tile(tile: Image.Image, heading: float, shift: np.ndarray, turn_deg: float) -> Image.Image:
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
    shift, turn_deg
        As for `camera_pose`.
    """
    # East and north of the tile's centre, in metres: q = A p + b for right and up p in the crop.
    turn_back = _rotation(-np.radians(turn_deg))
    matrix = _rotation(heading) @ turn_back
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


def _rotation(angle: float) -> np.ndarray:
    """Rotation by an angle in radians, counter-clockwise where the second axis points up."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


class KittiDataset(PoseDataset):
    """KITTI's left colour camera and the aerial crop around it.

    Test samples have the shift and turn of their test file. Training draws them at random, +-20 m
    along and across the driving direction and +-`heading_prior_deg`; so does validation, once.

    Parameters
    ----------
    config : KittiConfig
    part : {"train", "validation", "test"}
        Training and validation share the training file (`validation_fraction`).
    bad_samples : BadSamples, optional
        Where samples that cannot be read are written down; without it they raise.

    Raises
    ------
    DatasetError
        If a split or calibration file is missing or broken, or no sample remains.
    """

    projection = "pinhole"
    prior_centre_deg = 90.0

    def __init__(
        self,
        config: KittiConfig,
        part: str = "train",
        bad_samples: BadSamples | None = None,
    ):
        super().__init__(config, part, bad_samples)
        self._root = Path(config.root)
        name = f"{config.test if part == 'test' else 'train'}_files.txt"
        paths, draws = read_split(
            Path(config.splits or config.root) / name, with_pose=part == "test"
        )
        chosen = np.arange(len(paths)) if part == "test" else self._choose_part(len(paths))
        self.names = [paths[k] for k in chosen]
        self._draws = draws
        self.tile_metres = np.full(len(chosen), SPAN_M)
        self.hfov_deg = find_hfov_deg(self._root)
        self._check_not_empty()

    def _pose(self, index: int) -> np.ndarray:
        return camera_pose(*self._cut(index))

    def _load(self, index: int) -> tuple[torch.Tensor, torch.Tensor]:
        drive, frame = self.names[index].rsplit("/", 1)
        raw = self._root / "raw_data" / drive
        ground_file = raw / "image_02" / "data" / frame
        ground = read_image(ground_file)
        check_shape(ground, ground_file, GROUND_ASPECT, "a ground image")
        tile_file = self._root / "satmap" / drive / frame
        tile = read_image(tile_file)
        check_shape(tile, tile_file, 1.0, "an aerial tile")
        if tile.width < CROP_PIXELS:
            raise ImageError(
                f"{tile_file}: {tile.width}x{tile.height} pixels; an aerial tile must not be "
                f"smaller than its crop of {CROP_PIXELS}x{CROP_PIXELS}, so fetch the original"
            )
        heading = read_heading(raw / "oxts" / "data" / Path(frame).with_suffix(".txt"))
        aerial = cut_tile(tile, heading, *self._cut(index))
        if self.aerial_size != CROP_PIXELS:
            aerial = resize(aerial, (self.aerial_size, self.aerial_size))
        return normalise(resize(ground, self.config.ground_size)), normalise(aerial)

    def _cut(self, index: int) -> tuple[np.ndarray, float]:
        """The shift (right and up, metres) and turn (degrees) that a sample is cut with."""
        if self._draws is None:
            *shift, turn = self._random(index).uniform(-1, 1, 3)
        else:
            *shift, turn = self._draws[index]
        reach = 180.0 if self.heading_prior_deg is None else self.heading_prior_deg[1]
        return SHIFT_RANGE_M * np.array(shift), reach * turn


def read_split(path: str | Path, with_pose: bool) -> tuple[list[str], np.ndarray | None]:
    """Read a split file of LM: a path a line and, in test files, sx, sy and theta in [-1, 1].

    Returns
    -------
    paths : list of str
        ``<date>/<drive>/<frame>.png``, n of them.
    draws : float64 [n, 3] or None
        sx, sy, theta; None for a file without them.

    Raises
    ------
    DatasetError
        If the file is missing or a line is no such line; the text names file and line.
    """
    path = Path(path)
    hint = "it comes with HighlyAccurate (LM), not with the images; put it there or set splits"
    paths, draws = [], []
    for number, line in enumerate(read_lines(path, "the split file", hint), start=1):
        name, *values = line.split()
        try:
            draw = [float(value) for value in values]
        except ValueError:
            draw = [np.nan]
        shaped = name.count("/") == 2 and name.endswith(".png")
        if not (shaped and len(draw) == (3 if with_pose else 0) and np.all(np.abs(draw) <= 1)):
            expected = " sx sy theta, those in [-1, 1]" if with_pose else ""
            raise DatasetError(
                f"{path}, line {number}: {line[:80]!r} is no sample; expected "
                f"<date>/<drive>/<frame>.png{expected}"
            )
        paths.append(name)
        draws.append(draw)
    return paths, np.array(draws) if with_pose else None


def read_heading(path: str | Path) -> float:
    """Read the heading of a frame: radians, 0 east, counter-clockwise.

    Raises
    ------
    SampleError
        If the oxts file is missing or its first line has no finite field 5.
    """
    try:
        heading = float(Path(path).read_text(encoding="utf-8").split("\n")[0].split()[5])
    except (OSError, ValueError, IndexError) as error:
        raise SampleError(
            f"{path}: cannot be read as an oxts file, whose field 5 is the heading ({error}); "
            "fetch it anew"
        ) from error
    if not np.isfinite(heading):
        raise SampleError(f"{path}: the heading is {heading}; it must be finite, fetch it anew")
    return heading


def find_hfov_deg(root: str | Path) -> float:
    """The ground images' horizontal field of view: the median of the days' calibration files.

    It differs by up to 0.4 degrees from day to day (81.4 to 81.8); one value serves all, since one
    bank of masks does. Without any calibration file it is 81.5.

    Raises
    ------
    DatasetError
        If a calibration file has no usable ``P_rect_02``.
    """
    files = sorted(Path(root).glob("raw_data/*/calib_cam_to_cam.txt"))
    return float(np.median([read_hfov_deg(file) for file in files])) if files else DEFAULT_HFOV_DEG


def read_hfov_deg(path: str | Path) -> float:
    """Read the left colour camera's horizontal field of view, in degrees, off a calibration file.

    It is 2 atan(W / 2 / f): f is the first number of ``P_rect_02``, W that of ``S_rect_02`` or,
    without one, 1242.

    Raises
    ------
    DatasetError
        If there is no such number or the result is no field of view.
    """
    lines = read_lines(Path(path), "the calibration file", "fetch it anew")
    rows = {key.strip(): values.split() for key, _, values in (x.partition(":") for x in lines)}
    try:
        focal = float(rows["P_rect_02"][0])
        width = float(rows["S_rect_02"][0]) if "S_rect_02" in rows else 1242.0
    except (KeyError, IndexError, ValueError) as error:
        raise DatasetError(
            f"{path}: no focal length; expected a line 'P_rect_02: ' and twelve numbers"
        ) from error
    hfov_deg = float(np.degrees(2 * np.arctan2(width / 2, focal)))
    if not 0 < hfov_deg < 180:
        raise DatasetError(
            f"{path}: focal length {focal:g} and width {width:g} give a field of view of "
            f"{hfov_deg:g} degrees; expected 81.4 to 81.8"
        )
    return hfov_deg
