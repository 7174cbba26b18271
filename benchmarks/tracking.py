"""``python -m benchmarks.tracking``: a tracker against single frames, on drives of an unseen city.

Drives come from `slicemask synth --format drive`; a city of another seed than those that a run was
trained on is one it has never seen. Each drive is tracked from a fix that is 20 m off, as two in
three are, and an unknown heading: by images and odometry alone, and with the fixes of its table
along the way. Every few frames the same image is answered by itself, in the whole of a tile whose
centre is within an eighth of its side of the truth, which single answers do not know otherwise. At
20 s a copy of the tracker has its belief moved by 30 m: how soon it is back. Times are the
processor's seconds of one thread.

What a drive came to is kept in a file of its own, so that a repeated command goes on where it
stopped.
"""

import copy
import json
import math
import resource
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from slicematch import Localizer
from slicematch.data.maps import AerialMap
from slicematch.localization.geodesy import offset_m, offset_position
from slicematch.localization.on_map import PlaceOnGlobe
from slicematch.tracking.drive import Frame, open_drive
from slicematch.tracking.errors import SETTLED_S, STREET_M
from slicematch.tracking.tracker import Tracker

from slicemask.errors import OutputError
from slicemask.files import atomic_write

RESULTS = Path(__file__).parent / "results" / "tracking.json"
FIX_M, JUMP_M, JUMP_AT_S, BACK_WITHIN_S, BACK_M = 20.0, 30.0, 20.0, 10.0, 5.0


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--run", default="generated-city", show_default=True)
@click.option("--root", required=True, help="What synth --format drive made.")
@click.option("--drives", default=20, show_default=True, help="Of them, the first ones.")
@click.option("--single-every", default=4, show_default=True, help="Frames answered by themselves.")
@click.option("--cache", help="The folder of banks.")
@click.option("--work", default="runs/tracking", show_default=True, help="What each came to.")
@click.option("--out", default=str(RESULTS), show_default=True)
def main(
    run: str, root: str, drives: int, single_every: int, cache: str | None, work: str, out: str
) -> None:
    """Print the table, and keep it as JSON; it is written anew after each drive."""
    torch.set_num_threads(1)
    localizer = Localizer.load(run, cache=cache, grid="21x21x64", alone=True)
    aerial_map = AerialMap.open(Path(root) / "map.tif")
    asked = {"run": run, "root": str(Path(root).resolve()), "single_every": single_every}
    found = []
    for number, path in enumerate(sorted(Path(root).glob("drive_*.csv"))[:drives]):
        kept = Path(work) / f"{path.stem}.json"
        if not kept.exists() or json.loads(kept.read_text())["asked"] != asked:
            frames = list(open_drive(path, localizer.config))
            measured = measure(localizer, aerial_map, frames, cache, single_every, number)
            kept.parent.mkdir(parents=True, exist_ok=True)
            with atomic_write(kept, OutputError) as part:
                part.write_text(json.dumps({"asked": asked} | measured) + "\n")
        found.append(json.loads(kept.read_text()))
        content = summary(found)
        click.echo(f"{path.name}: {json.dumps(summary(found[-1:]))}", err=True)
        Path(out).write_text(json.dumps({"run": run} | content, indent=1) + "\n")
    Console(width=100).print(table(content))


def measure(
    localizer: Localizer,
    aerial_map: AerialMap,
    frames: list[Frame],
    cache: str | None,
    single_every: int,
    seed: int,
) -> dict[str, Any]:
    """What a drive comes to: lists with an entry for each frame after the first seconds."""
    rng = np.random.default_rng(seed)
    # Two in three are within `FIX_M`.
    fix = offset_position(frames[0].truth[:2], *rng.normal(0.0, FIX_M / 1.5, 2))
    start = PlaceOnGlobe(*fix, FIX_M)
    angle = rng.uniform(0.0, 2.0 * math.pi)
    content: dict[str, Any] = {
        "rate_hz": round((len(frames) - 1) / (frames[-1].time_s - frames[0].time_s), 2)
    }
    for name, fixes in (("images", False), ("fixes", True)):
        with Tracker(localizer, aerial_map, start, cache=cache) as tracker:
            content[name] = follow(tracker, frames, fixes, angle)
    content["single_m"] = [
        single(localizer, aerial_map, frame, rng)
        for frame in frames[:: max(1, single_every)]
        if frame.time_s >= SETTLED_S
    ]
    content["memory_mb"] = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    return content


def follow(tracker: Tracker, frames: list[Frame], fixes: bool, jump_angle: float) -> dict[str, Any]:
    """Errors and processor's seconds of each frame of a drive, and how soon a jump is undone."""
    rows: dict[str, list[Any]] = {"m": [], "deg": [], "inside": [], "seconds": []}
    back_s: float | None = None
    jumped = False
    for number, frame in enumerate(frames):
        begin_s = time.process_time()
        found = _step(tracker, frames, number, fixes)
        rows["seconds"].append(round(time.process_time() - begin_s, 4))
        if frame.time_s >= SETTLED_S:
            rows["m"].append(round(_off_m(tracker, frame), 3))
            turned = abs((found.heading_deg - frame.truth[2] + 180) % 360 - 180)
            rows["deg"].append(round(turned, 3))
            rows["inside"].append(bool(found.holds(*tracker.tiles.metres(*frame.truth[:2]))))
        if not jumped and frame.time_s >= JUMP_AT_S:
            jumped = True
            back_s = back_after_s(tracker, frames, number, fixes, jump_angle)
    return {**rows, "back_s": back_s}


def back_after_s(
    tracker: Tracker, frames: list[Frame], number: int, fixes: bool, angle: float
) -> float | None:
    """Seconds until a belief is back that is moved by `JUMP_M`; None if it is not in time."""
    moved = copy.copy(tracker)
    moved.rng = copy.deepcopy(tracker.rng)
    moved.elsewhere = copy.copy(tracker.elsewhere)
    moved.elsewhere.rng = moved.rng
    # Nor does it know of the truth what no hypothesis does.
    tile = tracker.tiles.at(*tracker.hypotheses[0].mean()[:2])
    count = len(tracker.scorer.coarse_grid.poses())
    moved.elsewhere.keep(tile, np.full(count, 1.0 / count))
    way = JUMP_M * np.array([math.sin(angle), math.cos(angle), 0.0, 0.0, 0.0])
    moved.hypotheses = [replace(one, states=one.states + way) for one in tracker.hypotheses]
    for later in range(number + 1, len(frames)):
        gone_s = frames[later].time_s - frames[number].time_s
        if gone_s > BACK_WITHIN_S:
            return None
        _step(moved, frames, later, fixes)
        if _off_m(moved, frames[later]) < BACK_M:
            return round(gone_s, 3)
    return None


def _step(tracker: Tracker, frames: list[Frame], number: int, fixes: bool) -> Any:
    frame, before = frames[number], frames[max(0, number - 1)]
    fix = frame.fix if fixes else None
    dt_s = frame.time_s - before.time_s
    return tracker.step(frame.image, frame.odometry, dt_s, frame.note, fix)


def _off_m(tracker: Tracker, frame: Frame) -> float:
    best = tracker.hypotheses[0].mean()
    return math.dist(tracker.tiles.metres(*frame.truth[:2]), best[:2])


def single(
    localizer: Localizer, aerial_map: AerialMap, frame: Frame, rng: np.random.Generator
) -> float:
    """Error of a frame answered by itself, metres."""
    config = localizer.config
    off_m = rng.uniform(-config.tile_side_m / 8, config.tile_side_m / 8, 2)
    centre = offset_position(frame.truth[:2], *off_m)
    tile = aerial_map.cut(*centre, config.tile_side_m, config.aerial_size)
    answer = localizer.localize(
        frame.image, localizer.encode_aerial(tile.image), heading_prior=(0.0, 180.0)
    )
    found = answer.offset_m(tile.metres_per_pixel)
    return round(math.dist(found, offset_m(centre, frame.truth[:2])), 3)


def summary(drives: list[dict[str, Any]]) -> dict[str, Any]:
    """The figures of some drives together."""

    def every(name: str, key: str) -> np.ndarray:
        return np.concatenate([np.asarray(drive[name][key], dtype=float) for drive in drives])

    singles = np.concatenate([drive["single_m"] for drive in drives])
    content: dict[str, Any] = {
        "drives": len(drives),
        "rate_hz": drives[0]["rate_hz"],
        "single": _errors(singles),
        "peak_memory_mb": max(drive["memory_mb"] for drive in drives),
    }
    for name in ("images", "fixes"):
        wrong = [float(np.mean(np.array(drive[name]["m"]) > STREET_M)) for drive in drives]
        seconds = every(name, "seconds")
        content[name] = {
            **_errors(every(name, "m")),
            "wrong_street_se": _standard_error(wrong),
            "median_deg": round(float(np.median(every(name, "deg"))), 3),
            "inside_95_ellipse": round(float(every(name, "inside").mean()), 4),
            "back_in_10_s": sum(drive[name]["back_s"] is not None for drive in drives),
            "frame_ms_median": round(1e3 * float(np.median(seconds)), 1),
            "frame_ms_99": round(1e3 * float(np.percentile(seconds, 99)), 1),
        }
    return content


def _errors(metres: np.ndarray) -> dict[str, float]:
    return {
        "frames": len(metres),
        "median_m": round(float(np.median(metres)), 3),
        "95_m": round(float(np.percentile(metres, 95)), 3),
        "wrong_street": round(float(np.mean(metres > STREET_M)), 4),
    }


def _standard_error(values: list[float]) -> float | None:
    if len(values) < 2:
        return None
    return round(float(np.std(values, ddof=1) / math.sqrt(len(values))), 4)


def table(content: dict[str, Any]) -> Table:
    """The summary, for people."""
    rows = Table("", "images and odometry", "and fixes", "single frames")
    sides = content["images"], content["fixes"], content["single"]
    for title, key, form in (
        ("place, median", "median_m", "{:.2f} m"),
        ("place, 95 %", "95_m", "{:.1f} m"),
        ("heading, median", "median_deg", "{:.2f} deg"),
        ("wrong street", "wrong_street", "{:.1%}"),
        ("truths in the ellipse of 95 %", "inside_95_ellipse", "{:.0%}"),
        (f"back in 10 s, of {content['drives']}", "back_in_10_s", "{}"),
        ("a frame, median", "frame_ms_median", "{:.0f} ms"),
        ("a frame, 99 %", "frame_ms_99", "{:.0f} ms"),
    ):
        rows.add_row(title, *(form.format(side[key]) if key in side else "" for side in sides))
    return rows


if __name__ == "__main__":
    main()
