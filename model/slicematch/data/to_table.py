"""Tables of photographs, made from what is there: VIGOR, KITTI, or a folder of photographs."""

import logging
import math
import os
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from slicemask.files import check_target, write_text
from slicematch.data.errors import DatasetError, SampleError
from slicematch.data.kitti import (
    CAMERA_OFFSET_M,
    DEFAULT_HFOV_DEG,
    METRES_PER_PIXEL,
    TEST_FILES,
    read_heading,
    read_split,
)
from slicematch.data.optics import read_optics
from slicematch.data.positions import read_fix
from slicematch.data.source import Part, Split
from slicematch.data.table_cameras import FILE as CAMERAS_FILE
from slicematch.data.table_files import SUFFIXES, write_table
from slicematch.data.text import parse_number, read_lines
from slicematch.data.vigor import VigorConfig, VigorSource
from slicematch.data.windows import tile_pixels

log = logging.getLogger(__name__)

Progress = Callable[[int, int], None]
_IMAGES = (".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff")
_PARTS: tuple[Part, ...] = ("train", "test")


@dataclass(frozen=True)
class WrittenTable:
    """A table that was written.

    Attributes
    ----------
    path : Path
        The table.
    rows : int
        Its photographs.
    cameras : Path or None
        The file of cameras beside it, if one was written.
    left_out : dict of str to str
        Photographs that are not in it, with the reason.
    """

    path: Path
    rows: int
    cameras: Path | None = None
    left_out: Mapping[str, str] = field(default_factory=dict)


def table_from_vigor(
    root: str | Path,
    out: str | Path,
    *,
    split: Split = "same-area",
    cities: tuple[str, ...] | None = None,
    labels: str = "corrected",
    overwrite: bool = False,
) -> WrittenTable:
    """Write the positive pairs of a VIGOR tree as a table.

    Parameters
    ----------
    root : path
        Of the tree.
    out : path
        The table: ``.csv``, ``.parquet`` or ``.geojson``. Files are named from its folder.
    split : {"same-area", "cross-area"}
        What its column ``split`` follows.
    cities, labels
        As `slicematch.data.vigor.VigorConfig` takes them.
    overwrite : bool
        Replace a table that is there.

    Raises
    ------
    DatasetError
        If the tree is unreadable, or the table cannot be written.
    """
    target = _Target(out, overwrite)
    config = VigorConfig(
        root=root, split=split, cities=cities, labels=labels, validation_fraction=0.0
    )
    config.check_root()
    rows = []
    for part in _PARTS:
        source = VigorSource(config, part)
        unused = np.random.default_rng(0)  # headings are not drawn here
        for index, (panorama, tile) in enumerate(source.files):
            u, v, _ = source.pose(index, unused)
            pixels = tile_pixels(str(tile))
            if not pixels:
                raise DatasetError(f"{tile}: is missing or no image; fetch it again")
            rows.append(
                {
                    "id": source.names[index],
                    "ground": target.relative(panorama),
                    "tile": target.relative(tile),
                    "u": u,
                    "v": v,
                    "heading_deg": 0.0,
                    "metres_per_pixel": source.tile_metres[index] / pixels,
                    "split": part,
                }
            )
    return target.write(rows)


def table_from_kitti(
    root: str | Path,
    out: str | Path,
    *,
    split: Split = "same-area",
    split_dir: str | Path | None = None,
    overwrite: bool = False,
) -> WrittenTable:
    """Write the frames of a KITTI tree, as cut by LM, as a table with its cameras.

    A frame is a row, once; the shifts and turns of the test files are left out, since a table's
    tiles lie north up and are shifted when they are cut.

    Parameters
    ----------
    root : path
        Of the tree.
    out : path
        The table: ``.csv``, ``.parquet`` or ``.geojson``. Files are named from its folder.
    split : {"same-area", "cross-area"}
        Which test file the test part is.
    split_dir : path, optional
        Where the split files lie; the root by default.
    overwrite : bool
        Replace a table that is there.

    Raises
    ------
    DatasetError
        If the tree is unreadable, or the table cannot be written.
    """
    target = _Target(out, overwrite)
    root = Path(root)
    folder = root if split_dir is None else Path(split_dir)
    rows: list[dict[str, Any]] = []
    cameras: dict[str, Any] = {}
    left_out: dict[str, str] = {}
    for part, name in zip(_PARTS, ("train_files.txt", TEST_FILES[split]), strict=True):
        frames, _ = read_split(folder / name, with_pose=part == "test")
        for frame in dict.fromkeys(frames):
            date = frame.split("/", 1)[0]
            if date not in cameras:
                cameras[date] = _kitti_camera(root / "raw_data" / date / "calib_cam_to_cam.txt")
            try:
                rows.append(_kitti_row(target, root, frame, part))
            except SampleError as error:
                left_out[frame] = str(error)
    return target.write(rows, cameras, left_out)


def _kitti_row(target: "_Target", root: Path, frame: str, part: Part) -> dict[str, Any]:
    drive, file = frame.rsplit("/", 1)
    raw, tile = root / "raw_data" / drive, root / "satmap" / frame
    pixels = tile_pixels(str(tile))
    if not pixels:
        raise SampleError(f"{tile}: is missing or no image; fetch it again")
    angle = read_heading(raw / "oxts" / "data" / Path(file).with_suffix(".txt"))
    ahead, left = CAMERA_OFFSET_M
    east = ahead * math.cos(angle) - left * math.sin(angle)
    north = ahead * math.sin(angle) + left * math.cos(angle)
    side_m = pixels * METRES_PER_PIXEL
    return {
        "id": frame,
        "ground": target.relative(raw / "image_02" / "data" / file),
        "tile": target.relative(tile),
        "u": 0.5 + east / side_m,
        "v": 0.5 - north / side_m,
        "heading_deg": (90.0 - math.degrees(angle)) % 360.0,
        "metres_per_pixel": METRES_PER_PIXEL,
        "camera": frame.split("/", 1)[0],
        "split": part,
    }


def _kitti_camera(path: Path) -> dict[str, Any]:
    """The left colour camera of a day, by its calibration file if that is there."""
    if not path.exists():
        return {
            "projection": "pinhole",
            "width": 1242,
            "height": 375,
            "hfov_deg": DEFAULT_HFOV_DEG,
        }
    parts = (line.partition(":") for _, line in read_lines(path, "the calibration file", ""))
    rows = {key.strip(): [parse_number(text) for text in rest.split()] for key, _, rest in parts}
    size, matrix = rows.get("S_rect_02", [1242.0, 375.0]), rows.get("P_rect_02", [])
    if len(size) != 2 or len(matrix) != 12 or None in size or None in matrix:
        raise DatasetError(
            f"{path}: expected a line 'P_rect_02: ' and twelve numbers, and 'S_rect_02: ' and two; "
            "fetch it again"
        )
    named = {"fx": matrix[0], "fy": matrix[5], "cx": matrix[2], "cy": matrix[6]}
    width, height = (int(side or 0) for side in size)
    return {"projection": "pinhole", "width": width, "height": height, **named}


def table_from_exif(
    folder: str | Path,
    out: str | Path,
    *,
    hfov_deg: float | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> WrittenTable:
    """Write the photographs of a folder, and of those in it, as a table with their cameras.

    Place, accuracy and heading are those of EXIF's GPS data, the heading of a panorama that of its
    GPano data, and the place else that of a file's name
    (`slicematch.data.positions.read_fix`, `slicematch.data.optics.read_optics`).

    Parameters
    ----------
    folder : path
        Of the photographs.
    out : path
        The table: ``.csv``, ``.parquet`` or ``.geojson``. Files are named from its folder.
    hfov_deg : float, optional
        Horizontal field of view of photographs that say none, degrees.
    overwrite : bool
        Replace a table that is there.
    progress : callable, optional
        Called with (photographs done, photographs in all).

    Raises
    ------
    DatasetError
        If no photograph says where it was taken, or the table cannot be written.
    """
    target = _Target(out, overwrite)
    if not Path(folder).is_dir():
        raise DatasetError(f"{folder}: there is no such folder; name that of the photographs")
    if hfov_deg is not None and not 0.0 < hfov_deg < 180.0:
        raise DatasetError(f"hfov is {hfov_deg:g}; of a pinhole camera it is from 0 to 180 degrees")
    files = sorted(path for path in Path(folder).rglob("*") if path.suffix.lower() in _IMAGES)
    rows: list[dict[str, Any]] = []
    cameras: dict[str, Any] = {}
    left_out: dict[str, str] = {}
    for number, path in enumerate(files, start=1):
        try:
            rows.append(_exif_row(target, path, cameras, hfov_deg))
        except SampleError as error:
            left_out[str(path)] = str(error)
        if progress is not None:
            progress(number, len(files))
    if not rows:
        first = f"; the first one: {next(iter(left_out.values()))}" if left_out else ""
        raise DatasetError(
            f"{folder}: none of its {len(files)} photographs says where and by what camera it was "
            f"taken{first}"
        )
    if set(cameras) == {"panorama"}:  # what a table without cameras holds
        cameras = {}
        for row in rows:
            del row["camera"]
    return target.write(rows, cameras, left_out)


def _exif_row(
    target: "_Target", path: Path, cameras: dict[str, Any], hfov_deg: float | None
) -> dict[str, Any]:
    fix, optics = read_fix(path), read_optics(path, hfov_deg)
    cameras[optics.name] = optics.parameters or {"projection": "equirectangular"}
    heading_deg = fix.heading_deg if optics.heading_deg is None else optics.heading_deg
    return {
        "id": target.relative(path),
        "ground": target.relative(path),
        "lat": fix.lat,
        "lon": fix.lon,
        "heading_deg": heading_deg,
        "accuracy_m": fix.accuracy_m,
        "camera": optics.name,
    }


class _Target:
    """The table to be written and the cameras beside it, checked before the work."""

    def __init__(self, out: str | Path, overwrite: bool) -> None:
        self.path = check_target(out, SUFFIXES, DatasetError)
        self._overwrite = overwrite
        if self.path.exists() and not overwrite:
            raise DatasetError(
                f"{self.path}: is there already; replace it with --overwrite, or name another file"
            )

    def relative(self, path: Path) -> str:
        """A file's name as the table holds it, seen from its folder."""
        return Path(os.path.relpath(path, self.path.parent)).as_posix()

    def write(
        self,
        rows: list[dict[str, Any]],
        cameras: Mapping[str, Any] | None = None,
        left_out: Mapping[str, str] | None = None,
    ) -> WrittenTable:
        """Write the cameras, if there are any, and the table."""
        if not rows:
            first = f"; the first one: {next(iter(left_out.values()))}" if left_out else ""
            raise DatasetError(f"{self.path}: there is no photograph to list{first}")
        beside = self._write_cameras(cameras) if cameras else None
        seen: Counter[str] = Counter()
        for row in rows:  # a photograph may be of both parts
            seen[row["id"]] += 1
            if seen[row["id"]] > 1:
                row["id"] = f"{row['id']}#{seen[row['id']]}"
        columns = {name: [_plain(row.get(name)) for row in rows] for name in rows[0]}
        write_table(self.path, columns)
        return WrittenTable(self.path, len(rows), beside, left_out or {})

    def _write_cameras(self, cameras: Mapping[str, Any]) -> Path:
        import yaml

        path = self.path.with_name(CAMERAS_FILE)
        text = yaml.safe_dump(dict(cameras), sort_keys=False, default_flow_style=None)
        if path.exists() and not self._overwrite and path.read_text(encoding="utf-8") != text:
            raise DatasetError(
                f"{path}: holds other cameras; replace it with --overwrite, or name a table in "
                "another folder"
            )
        write_text(path, text, DatasetError)
        return path


def _plain(value: Any) -> Any:
    """A value without NumPy's types, as files hold it."""
    return value.item() if isinstance(value, np.generic) else value
