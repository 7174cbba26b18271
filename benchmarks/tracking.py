"""``python -m benchmarks.tracking``: a tracker against single frames, on drives of an unseen city.

Drives come from `slicemask synth --format drive`; a city of another seed than those that a run was
trained on is one it has never seen. Each drive is tracked from a fix that is 20 m off, as two in
three are, and an unknown heading; every few frames the same image is answered by itself, in the
whole of a tile whose centre is within an eighth of its side of the truth, which single answers
do not know otherwise. Then each drive is tracked again and the belief is moved by 30 m at 20 s, the
odometry going on: how soon it is back. Times are the processor's seconds of one thread.
"""

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
from slicematch import Localizer
from slicematch.data.maps import AerialMap
from slicematch.localization.geodesy import offset_m, offset_position
from slicematch.localization.on_map import PlaceOnGlobe
from slicematch.tracking.drive import Frame, open_drive
from slicematch.tracking.errors import SETTLED_S, STREET_M
from slicematch.tracking.tracker import Tracker

RESULTS = Path(__file__).parent / "results" / "tracking.json"
FIX_M, JUMP_M, JUMP_AT_S, BACK_WITHIN_S, BACK_M = 20.0, 30.0, 20.0, 10.0, 5.0


@click.command()
@click.option("--run", default="generated-city", show_default=True)
@click.option("--root", required=True, help="What synth --format drive made.")
@click.option("--drives", default=20, show_default=True, help="Of them, the first ones.")
@click.option("--single-every", default=4, show_default=True, help="Frames answered by themselves.")
@click.option("--cache", help="The folder of banks.")
@click.option("--out", default=str(RESULTS), show_default=True)
def main(run: str, root: str, drives: int, single_every: int, cache: str, out: str) -> None:
    """Print the table, and keep it as JSON; it is written anew after each drive."""
    torch.set_num_threads(1)
    localizer = Localizer.load(run, cache=cache, grid="21x21x64")
    aerial_map = AerialMap.open(Path(root) / "map.tif")
    rng = np.random.default_rng(0)
    tracked: list[dict[str, Any]] = []
    singles: list[float] = []
    back: list[float] = []
    for path in sorted(Path(root).glob("drive_*.csv"))[:drives]:
        frames = list(open_drive(path, localizer.config))
        start = PlaceOnGlobe(*_near(frames[0], rng), FIX_M)
        tracked += follow(localizer, aerial_map, frames, start, cache)
        singles += [
            single(localizer, aerial_map, frame, rng)
            for frame in frames[:: max(1, single_every)]
            if frame.time_s >= SETTLED_S
        ]
        back.append(recovery(localizer, aerial_map, frames, start, cache, rng))
        rate_hz = (len(frames) - 1) / (frames[-1].time_s - frames[0].time_s)
        content = summary(tracked, singles, back) | {"run": run, "rate_hz": round(rate_hz, 2)}
        click.echo(f"{path.name}: {json.dumps(content)}")
        Path(out).write_text(json.dumps(content, indent=1) + "\n")


def follow(
    localizer: Localizer,
    aerial_map: AerialMap,
    frames: list[Frame],
    start: PlaceOnGlobe,
    cache: str | None,
) -> list[dict[str, Any]]:
    """Errors and processor's seconds of each frame of a drive."""
    rows = []
    with Tracker(localizer, aerial_map, start, cache=cache) as tracker:
        before = frames[0]
        for frame in frames:
            begin_s = time.process_time()
            found = tracker.step(frame.image, frame.odometry, frame.time_s - before.time_s)
            seconds = time.process_time() - begin_s
            before = frame
            place = tracker.tiles.metres(*frame.truth[:2])
            mode = found.modes[0]
            rows.append(
                {
                    "time_s": frame.time_s,
                    "error_m": math.dist(place, (mode.east_m, mode.north_m)),
                    "error_deg": abs((found.heading_deg - frame.truth[2] + 180) % 360 - 180),
                    "inside": found.holds(*place),
                    "seconds": seconds,
                }
            )
    return rows


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
    return math.dist(found, offset_m(centre, frame.truth[:2]))


def recovery(
    localizer: Localizer,
    aerial_map: AerialMap,
    frames: list[Frame],
    start: PlaceOnGlobe,
    cache: str | None,
    rng: np.random.Generator,
) -> float:
    """Seconds until a tracker is back that was moved by `JUMP_M`; infinity if it is not in time."""
    jumped = False
    with Tracker(localizer, aerial_map, start, cache=cache) as tracker:
        before = frames[0]
        for frame in frames:
            dt_s = frame.time_s - before.time_s
            found = tracker.step(frame.image, frame.odometry, dt_s)
            before = frame
            mode = found.modes[0]
            off_m = math.dist(tracker.tiles.metres(*frame.truth[:2]), (mode.east_m, mode.north_m))
            if jumped and off_m < BACK_M:
                return frame.time_s - JUMP_AT_S
            if jumped and frame.time_s > JUMP_AT_S + BACK_WITHIN_S:
                return math.inf
            if not jumped and frame.time_s >= JUMP_AT_S:
                angle = rng.uniform(0.0, 2.0 * math.pi)
                move = JUMP_M * np.array([math.sin(angle), math.cos(angle), 0.0, 0.0, 0.0])
                tracker.hypotheses = [
                    replace(one, states=one.states + move) for one in tracker.hypotheses
                ]
                jumped = True
    return math.inf


def summary(
    tracked: list[dict[str, Any]], singles: list[float], back: list[float]
) -> dict[str, Any]:
    """The figures."""
    settled = [row for row in tracked if row["time_s"] >= SETTLED_S]
    errors = np.array([row["error_m"] for row in settled])
    seconds = np.array([row["seconds"] for row in tracked])
    return {
        "drives": len(back),
        "frames": len(settled),
        "tracker_median_m": round(float(np.median(errors)), 3),
        "tracker_95_m": round(float(np.percentile(errors, 95)), 3),
        "tracker_median_deg": round(float(np.median([row["error_deg"] for row in settled])), 3),
        "single_median_m": round(float(np.median(singles)), 3),
        "single_95_m": round(float(np.percentile(singles, 95)), 3),
        "single_wrong_street": round(float(np.mean(np.array(singles) > STREET_M)), 4),
        "wrong_street": round(float(np.mean(errors > STREET_M)), 4),
        "inside_95_ellipse": round(float(np.mean([row["inside"] for row in settled])), 4),
        "recovered_in_10_s": round(float(np.mean(np.isfinite(back))), 3),
        "frame_ms_median": round(1e3 * float(np.median(seconds)), 1),
        "frame_ms_99": round(1e3 * float(np.percentile(seconds, 99)), 1),
        "peak_memory_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
    }


def _near(frame: Frame, rng: np.random.Generator) -> tuple[float, float]:
    """A fix of the start: two in three are within `FIX_M`."""
    return offset_position(frame.truth[:2], *(rng.normal(0.0, FIX_M / 1.5, 2)))


if __name__ == "__main__":
    main()
