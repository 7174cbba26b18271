"""Generate drives through a city: frames at camera rate, odometry, fixes, and a map."""

import math
import os
from pathlib import Path

from slicemask.errors import SynthError
from slicemask.synth.formats import drive
from slicemask.synth.formats.map_blocks import write_map
from slicemask.synth.generate import (
    VERSION,
    Progress,
    SynthResult,
    check_at_least,
    check_panorama_size,
    claim_folder,
    run_tasks,
)
from slicemask.threads import thread_count


def generate_drive(
    out: str | os.PathLike[str],
    *,
    drives: int = 1,
    seconds: float = 60.0,
    rate_hz: float = 10.0,
    seed: int = 0,
    panorama_size: tuple[int, int] = (512, 256),
    tile_size: int = 640,
    jobs: int | None = None,
    progress: Progress | None = None,
) -> SynthResult:
    """Generate drives through a city, with what sensors say of them, a map, and the truth.

    ``map.tif`` is a GeoTIFF of the city in UTM. Each drive is a table, ``drive_00.csv`` and so on,
    with a row for each frame: its time, its panorama, whose centre looks ahead, speed and yaw rate
    as odometry has them (a wheel's radius that is 1.5 % off, slip, a gyroscope's bias), each second
    a fix with an error of 4 m to the east and to the north (standard deviations) that lasts for
    some 20 s; and the true place and heading.

    Goes on, and depends on its arguments, as `generate_vigor` does.

    Parameters
    ----------
    out : path
        Folder of the data set: new, empty, or holding the same data set from an earlier call.
    drives : int
        Through the same city.
    seconds, rate_hz : float
        Of each drive, and how many frames a second.
    seed : int
        The layout of the city follows from it; it is none of `generate_vigor`'s.
    panorama_size : (columns, rows)
        Twice as wide as high.
    tile_size : int
        Pixels of the map along 72.48 m, a tile's side of VIGOR's format.
    jobs, progress
        As for `generate_vigor`.

    Raises
    ------
    SynthError
        If an argument is out of its range, or `out` holds something else or cannot be written.
    SpecError
        If `jobs` is less than 1.
    """
    check_at_least("drives", drives, 1)
    check_at_least("seed", seed, 0)
    check_at_least("tile_size", tile_size, 16)
    for name, value, least, most in (
        ("seconds", seconds, 1.0, 3600.0),
        ("rate_hz", rate_hz, 0.1, 100.0),
    ):
        if not (math.isfinite(value) and least <= value <= most):
            raise SynthError(f"{name} is {value:g}; it must be {least:g} to {most:g}")
    check_panorama_size(panorama_size)
    jobs = thread_count(jobs)
    root = Path(out)
    spec = drive.DriveSpec(seed, drives, float(seconds), float(rate_hz), panorama_size, tile_size)
    tasks = drive.list_tasks(root, spec)
    drive.plan_drives(spec)  # before anything is written: not every city has such drives
    claim_folder(
        root,
        {
            "format": "drive",
            "version": VERSION,
            "seed": seed,
            "drives": drives,
            "seconds": spec.seconds,
            "rate_hz": spec.rate_hz,
            "panorama_size": list(panorama_size),
            "tile_size": tile_size,
        },
    )
    drive.write_tables(root, spec)
    result = run_tasks(root, tasks, jobs, progress)
    write_map(root, spec)
    return result
