"""Generate a city as photographs of one's own, with a map and tables."""

import os
from pathlib import Path

from slicemask.errors import SynthError
from slicemask.synth.formats import table
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


def generate_table(
    out: str | os.PathLike[str],
    *,
    panoramas: int = 400,
    seed: int = 0,
    panorama_size: tuple[int, int] = (2048, 1024),
    image_size: tuple[int, int] = (640, 480),
    tile_size: int = 640,
    jobs: int | None = None,
    progress: Progress | None = None,
) -> SynthResult:
    """Generate a city as photographs, a map and tables of the truth.

    ``map.tif`` is a GeoTIFF of the whole city in UTM; ``photos.csv`` lists the panoramas and
    ``front.csv`` the images of a pinhole camera at the same places, with their true places and
    headings; ``cameras.yaml`` holds the cameras. EXIF data of the photographs give a position with
    errors of 5 m to the east and to the north (standard deviations) and a compass with 5 degrees.

    Goes on, and depends on its arguments, as `generate_vigor` does.

    Parameters
    ----------
    out : path
        Folder of the data set: new, empty, or holding the same data set from an earlier call.
    panoramas : int
        Places, half of them for training.
    seed : int
        The city is that of `generate_vigor` with the same seed and number, its panoramas too.
    panorama_size : (columns, rows)
        Twice as wide as high.
    image_size : (columns, rows)
        Of the pinhole images, whose focal length and principal point scale with the columns: 500
        pixels of 640, and 40 right of the centre.
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
    check_at_least("panoramas", panoramas, 1)
    check_at_least("seed", seed, 0)
    check_at_least("tile_size", tile_size, 16)
    check_panorama_size(panorama_size)
    if min(image_size) < 16:
        raise SynthError(f"image_size is {image_size[0]}x{image_size[1]}; it must be 16 or more")
    jobs = thread_count(jobs)
    root = Path(out)
    spec = table.TableSpec(seed, panoramas, panorama_size, image_size, tile_size)
    tasks = table.list_tasks(root, spec)  # planned before anything is written
    claim_folder(
        root,
        {
            "format": "table",
            "version": VERSION,
            "seed": seed,
            "panoramas": panoramas,
            "panorama_size": list(panorama_size),
            "image_size": list(image_size),
            "tile_size": tile_size,
        },
    )
    table.write_tables(root, spec)
    result = run_tasks(root, tasks, jobs, progress)
    write_map(root, spec)
    return result
