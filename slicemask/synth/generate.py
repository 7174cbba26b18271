"""Generate data sets: what is asked for, checked, rendered on all cores, and gone on with."""

import json
import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any, Protocol

from slicemask.errors import SynthError
from slicemask.files import check_folder
from slicemask.interrupts import CancelCheck, Cancelled, run_cancellable
from slicemask.synth.formats import kitti, vigor
from slicemask.synth.formats.files import write_text
from slicemask.synth.vary.switches import check_switches
from slicemask.threads import thread_count

# Raised with every change that alters a picture or a label.
VERSION = 1
RECORD = "synth.json"
MOST_LABEL_NOISE_M = 20.0  # more would move cameras off their tiles
# How often it is looked whether to stop.
_POLL_S = 0.1
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class SynthResult:
    """What a call has done.

    Parameters
    ----------
    path : Path
        Root of the data set.
    images : int
        Number of images of the data set.
    rendered : int
        Number of those that were rendered now; the others existed already.
    """

    path: Path
    images: int
    rendered: int


class _Task(Protocol):
    @property
    def images(self) -> int: ...

    def run(self) -> int: ...


# What a process is given at once: a task, or many that share scenes.
_Work = _Task | vigor.PlaceTask


def generate_vigor(
    out: str | os.PathLike[str],
    *,
    cities: int = 1,
    panoramas: int = 400,
    seed: int = 0,
    panorama_size: tuple[int, int] = (2048, 1024),
    tile_size: int = 640,
    places: int = 1,
    vary: Sequence[str] = (),
    plain_places: int = 0,
    label_noise_m: float = 0.0,
    jobs: int | None = None,
    progress: Progress | None = None,
) -> SynthResult:
    """Generate cities in VIGOR's on-disk format.

    Complete images are kept, so that a call that was cut short goes on when it is repeated. The
    result depends on nothing but the arguments; `jobs` changes no byte.

    Parameters
    ----------
    out : path
        Root of the data set: new, empty, or holding the same data set from an earlier call.
    cities : int
        1 to 4, in the order NewYork, SanFrancisco, Seattle, Chicago: with two, one lies on either
        side of VIGOR's cross-area split.
    panoramas : int
        Panoramas a city, half of them for training in the same-area split.
    seed : int
        The layout of all cities follows from it.
    panorama_size : (columns, rows)
        Twice as wide as high.
    tile_size : int
        Pixels a side. Tiles cover the same ground at any size; labels stay on the 640-pixel scale.
    places : int
        Layouts of each city, which share its panoramas: with more than one, a city is many small
        ones, far apart, under one name.
    vary : sequence of str
        Switches of domain randomisation, keys of `slicemask.synth.vary.switches.SWITCHES`, or
        "all". None leaves all cities as they always were.
    plain_places : int
        So many of the places, drawn at random, are left as they always were: a model should know
        the plain city too.
    label_noise_m : float
        Deviation of the errors of the labels, metres east and north, as GPS has them. Pictures stay
        the same.
    jobs : int, optional
        Processes; all processors by default.
    progress : callable, optional
        Called with the number of images done and their total.

    Raises
    ------
    SynthError
        If an argument is out of its range, or `out` holds something else or cannot be written.
    SpecError
        If `jobs` is less than 1.
    """
    if not 1 <= cities <= len(vigor.CITIES):
        raise SynthError(f"cities is {cities}; VIGOR has 1 to {len(vigor.CITIES)}")
    check_at_least("panoramas", panoramas, 1)
    check_at_least("seed", seed, 0)
    check_at_least("tile_size", tile_size, 16)
    if not 1 <= places <= panoramas:
        raise SynthError(
            f"places is {places}; it must be 1 to the number of panoramas a city, {panoramas}"
        )
    if not 0.0 <= label_noise_m <= MOST_LABEL_NOISE_M:
        raise SynthError(
            f"label_noise_m is {label_noise_m}; it must be 0 to {MOST_LABEL_NOISE_M:g} metres"
        )
    switches = check_switches(vary)
    if not 0 <= plain_places < places and plain_places:
        raise SynthError(
            f"plain_places is {plain_places}; it must be 0 to less than the number of places, "
            f"{places}"
        )
    if plain_places and not switches:
        raise SynthError(f"plain_places is {plain_places}; without vary all places are plain")
    check_panorama_size(panorama_size)
    jobs = thread_count(jobs)
    root = Path(out)
    whole = vigor.VigorSpec(
        seed, 0, panoramas, panorama_size, tile_size, None, switches, label_noise_m
    )
    specs = [
        vigor.city_specs(replace(whole, city=city), places, plain_places) for city in range(cities)
    ]
    # Planned before anything is written: not every plan can be.
    tasks: list[_Work] = [
        task for city in specs for spec in city for task in vigor.list_tasks(root, spec)
    ]
    record: dict[str, Any] = {
        "format": "vigor",
        "version": VERSION,
        "seed": seed,
        "cities": cities,
        "panoramas": panoramas,
        "panorama_size": list(panorama_size),
        "tile_size": tile_size,
    }
    if places > 1:
        record["places"] = places
    if label_noise_m:
        record["label_noise_m"] = label_noise_m
    if switches:
        record["vary"] = list(switches)
    if plain_places:
        record["plain_places"] = plain_places
    claim_folder(root, record)
    for city in specs:
        vigor.write_labels(root, city)
    return run_tasks(root, tasks, jobs, progress)


def generate_kitti(
    out: str | os.PathLike[str],
    *,
    frames: int = 200,
    seed: int = 0,
    image_size: tuple[int, int] = (kitti.COLUMNS, kitti.ROWS),
    tile_size: int = 1280,
    jobs: int | None = None,
    progress: Progress | None = None,
) -> SynthResult:
    """Generate drives in KITTI's on-disk format, with tiles and splits as cut by LM.

    Goes on, and depends on its arguments, as `generate_vigor` does.

    Parameters
    ----------
    out : path
        Root of the data set: new, empty, or holding the same data set from an earlier call.
    frames : int
        Frames in all, at least 3: 64 per cent for training, 12 for the first test in the same
        city, the rest for the second test in another.
    seed : int
        The layout of both cities follows from it.
    image_size : (columns, rows)
        Of ground images; the focal length scales with the columns.
    tile_size : int
        Pixels a side, at 0.19583 m whatever the number, at least 512.
    jobs, progress
        As for `generate_vigor`.

    Raises
    ------
    SynthError
        If an argument is out of its range, or `out` holds something else or cannot be written.
    SpecError
        If `jobs` is less than 1.
    """
    check_at_least("frames", frames, 3)
    check_at_least("seed", seed, 0)
    check_at_least("tile_size", tile_size, 512)
    columns, rows = image_size
    if rows < 16 or abs(columns / rows * kitti.ROWS / kitti.COLUMNS - 1) > 0.02:
        raise SynthError(
            f"image_size is {columns}x{rows}; it must have the proportions of 1242x375"
        )
    jobs = thread_count(jobs)
    root = Path(out)
    claim_folder(
        root,
        {
            "format": "kitti",
            "version": VERSION,
            "seed": seed,
            "frames": frames,
            "image_size": [columns, rows],
            "tile_size": tile_size,
        },
    )
    tasks: list[_Work] = []
    for area, counts in enumerate(kitti.count_frames(frames)):
        spec = kitti.KittiSpec(seed, area, counts, (columns, rows), tile_size)
        tasks += kitti.list_tasks(root, spec)
        kitti.write_records(root, spec)
    return run_tasks(root, tasks, jobs, progress)


def check_at_least(name: str, value: int, least: int) -> None:
    """Refuse a number that is too small."""
    if value < least:
        raise SynthError(f"{name} is {value}; it must be at least {least}")


def check_panorama_size(size: tuple[int, int]) -> None:
    """Refuse a size (columns, rows) that no panorama has."""
    columns, rows = size
    if rows < 16 or columns != 2 * rows:
        raise SynthError(
            f"panorama_size is {columns}x{rows}; it must be twice as wide as high, as 1024x512 is"
        )


def claim_folder(root: Path, record: dict[str, Any]) -> None:
    """Make the root this data set's, or refuse one that holds something else."""
    path = check_folder(root, SynthError) / RECORD
    try:
        root.mkdir(parents=True, exist_ok=True)
        # In this order: another call may be making the same data set, its record first.
        empty = all(file.name.startswith(f".{RECORD}.") for file in root.iterdir())
        found = json.loads(path.read_text(encoding="utf-8")) if path.exists() else None
    except (OSError, ValueError) as error:
        raise SynthError(
            f"{root}: cannot be used as the data set's folder ({error}); choose another"
        ) from error
    if found == record:
        return
    if found is not None:
        raise SynthError(
            f"{root}: holds another generated data set ({json.dumps(found)}); choose another "
            f"folder for {json.dumps(record)}"
        )
    if not empty:
        raise SynthError(
            f"{root}: is not empty and holds no {RECORD}, so it may be somebody's data; choose a "
            "new folder"
        )
    write_text(path, json.dumps(record, indent=2) + "\n")


def run_tasks(
    root: Path, tasks: Sequence[_Work], jobs: int, progress: Progress | None
) -> SynthResult:
    """Run tasks on processes of their own, and count their images.

    Raises
    ------
    SynthError
        If a process was ended from outside.
    """
    jobs = min(jobs, len(tasks))
    total = sum(task.images for task in tasks)
    done = rendered = 0

    def count(task: _Work, new: int) -> None:
        nonlocal done, rendered
        done += task.images
        rendered += new
        if progress is not None:
            progress(done, total)

    def render(check: CancelCheck) -> None:
        if progress is not None:
            progress(0, total)
        if jobs == 1:
            for task in tasks:
                count(task, _run(task, check))
            return
        # Spawned, because forking a process that has threads, as one with torch has, can lock up.
        context = multiprocessing.get_context("spawn")
        stopping = context.Event()
        pool = ProcessPoolExecutor(jobs, context, _share_stopping, (stopping,))
        # Its processes inherit this: an interrupt is for this one to act on, and they end with it.
        if hasattr(signal, "pthread_sigmask"):
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            running = {pool.submit(_run_task, task): task for task in tasks}
            waiting = set(running)
            while waiting:
                ended, waiting = wait(waiting, timeout=_POLL_S, return_when=FIRST_COMPLETED)
                check()
                for future in ended:
                    count(running[future], future.result())
        except BrokenProcessPool as error:
            raise SynthError(
                f"{root}: a process that rendered was ended from outside, for want of memory "
                f"perhaps, with {done} of {total} images done; run it again with fewer jobs than "
                f"{jobs}, and it goes on"
            ) from error
        finally:
            stopping.set()
            pool.shutdown(cancel_futures=True)

    run_cancellable(render)
    return SynthResult(root, total, rendered)


def _run(task: _Work, check: CancelCheck) -> int:
    """Run a task, which may be one of many images: work may stop between them."""
    written = 0
    for part in task.tasks if isinstance(task, vigor.PlaceTask) else (task,):
        check()
        written += part.run()
    return written


# In a process that renders: set once its work is wanted no longer.
_stopping: Event | None = None


def _share_stopping(stopping: Event) -> None:
    global _stopping
    _stopping = stopping


def _run_task(task: _Work) -> int:
    def check() -> None:
        if _stopping is not None and _stopping.is_set():
            raise Cancelled

    return _run(task, check)
