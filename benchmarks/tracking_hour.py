"""``python -m benchmarks.tracking_hour``: an hour of driving in one process, and its memory.

One tracker goes through all drives of a folder, several times over: a belief that is lost where one
drive ends and the next begins, and tiles that come and go. Prints a line of JSON every thousand
frames: seconds driven, memory now and at its peak, and the processor's time a frame.
"""

import json
import resource
import time
from pathlib import Path

import click
import torch
from slicematch import Localizer
from slicematch.data.maps import AerialMap
from slicematch.localization.on_map import PlaceOnGlobe
from slicematch.tracking.drive import open_drive
from slicematch.tracking.tracker import Tracker

EVERY = 1000


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--run", default="generated-city", show_default=True)
@click.option("--root", required=True, help="What synth --format drive made.")
@click.option("--times", default=3, show_default=True, help="How often through its drives.")
@click.option("--cache", help="The folder of banks.")
def main(run: str, root: str, times: int, cache: str | None) -> None:
    """Drive, and print what it takes."""
    torch.set_num_threads(1)
    localizer = Localizer.load(run, cache=cache, alone=True)
    drives = [
        list(open_drive(path, localizer.config)) for path in sorted(Path(root).glob("drive_*.csv"))
    ]
    aerial_map = AerialMap.open(Path(root) / "map.tif")
    start = PlaceOnGlobe(*drives[0][0].truth[:2], 20.0)
    begin_s, count = time.process_time(), 0
    with Tracker(localizer, aerial_map, start, cache=cache) as tracker:
        for frames in drives * times:
            step_s = frames[1].time_s - frames[0].time_s
            before_s = frames[0].time_s - step_s
            for frame in frames:
                dt_s, before_s = frame.time_s - before_s, frame.time_s
                tracker.step(frame.image, frame.odometry, dt_s, frame.note, frame.fix)
                count += 1
                if count % EVERY == 0:
                    a_frame_s = (time.process_time() - begin_s) / count
                    print(json.dumps(_memory() | {
                        "driven_s": round(tracker.time_s),
                        "frame_ms": round(1e3 * a_frame_s, 1),
                    }), flush=True)  # fmt: skip


def _memory() -> dict[str, int]:
    """Of this process, MB: now and at its peak."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    peak_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {"now_mb": pages * resource.getpagesize() // 2**20, "peak_mb": peak_kb // 2**10}


if __name__ == "__main__":
    main()
