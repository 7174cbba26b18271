"""Tracking a recorded drive on a map, with a trained run."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from slicemask.interrupts import CancelCheck, run_cancellable
from slicematch.data.errors import DatasetError
from slicematch.data.maps import AerialMap
from slicematch.digits import digits
from slicematch.errors import RunError
from slicematch.localization.localizer import Localizer
from slicematch.localization.on_map import PlaceOnGlobe, tile_side
from slicematch.precision import Precision
from slicematch.runs.folder import Checkpoint, RunFolder
from slicematch.runs.shipped import find_run
from slicematch.tracking.drive import Drive, Frame, open_drive
from slicematch.tracking.errors import TrackErrors
from slicematch.tracking.outputs import Track, check_track_target, write_track
from slicematch.tracking.smoothing import Step, smooth, smoothed_estimates
from slicematch.tracking.track_estimate import TrackEstimate
from slicematch.tracking.track_settings import TrackSettings
from slicematch.tracking.tracker import Tracker


@dataclass(frozen=True)
class Tracked:
    """A drive that was tracked.

    Attributes
    ----------
    track : Track
    smoothed : bool
        Whether later frames had a say.
    errors : TrackErrors or None
        Against the truth, where the recording holds it.
    notes : dict of str to int
        What went wrong, a sentence each, and at how many frames.
    files : dict of str to Path
        What was written.
    """

    track: Track
    smoothed: bool
    errors: TrackErrors | None
    notes: dict[str, int] = field(default_factory=dict)
    files: dict[str, Path] = field(default_factory=dict)

    def summary(self) -> dict[str, Any]:
        """How it went, as plain values, for JSON."""
        estimates = self.track.estimates
        spread = [math.hypot(*np.sqrt(np.diag(one.covariance))[:2]) for one in estimates]
        last = estimates[-1]
        content: dict[str, Any] = {
            "frames": len(estimates),
            "seconds": round(self.track.times_s[-1] - self.track.times_s[0], 3),
            "seen": sum(one.seen for one in estimates),
            "sure": sum(one.sure for one in estimates),
            "std_place_median_m": round(float(np.median(spread)), 3),
            "smoothed": self.smoothed,
            "last": {"lat": last.lat, "lon": last.lon, "heading_deg": last.heading_deg},
            "notes": self.notes,
        }
        if self.errors is not None:
            content["errors"] = self.errors.as_dict()
        return content | {name: str(path) for name, path in self.files.items()}

    def __str__(self) -> str:
        return self.report()

    def report(self, most: int = 5) -> str:
        """The summary as a few lines of text."""
        content = self.summary()
        seconds, deviation_m = content["seconds"], content["std_place_median_m"]
        lines = [
            f"{content['frames']:,} frames in {digits(seconds, 4)} s, {content['sure']:,} of them "
            f"sure of the place; standard deviation {digits(deviation_m)} m at the median"
        ]
        if self.errors is not None:
            lines.append(self.errors.report())
        notes = list(self.notes.items())
        lines += [f"{count:,} frames: {note}" for note, count in notes[:most]]
        if len(notes) > most:
            lines.append(f"and {len(notes) - most:,} other notes (column notes of a .csv track)")
        return "\n".join([*lines, *map(str, self.files.values())])


def track(
    run: str | Path,
    drive: str | Path,
    aerial_map: str | Path,
    out: str | Path,
    *,
    near: tuple[float, float] | None = None,
    within_m: float | None = None,
    heading: tuple[float, float] | None = None,
    fixes: bool = True,
    smoothed: bool = False,
    picture: str | Path | None = None,
    animation: str | Path | None = None,
    rerun: str | Path | None = None,
    topics: dict[str, str] | None = None,
    map_crs: str | None = None,
    side_m: float | None = None,
    checkpoint: Checkpoint = "best",
    device: str = "auto",
    precision: Precision = "32-true",
    cache: str | Path | None = None,
    settings: TrackSettings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Tracked:
    """Track a recorded drive on a map, and write the track.

    Parameters
    ----------
    run : path
        A run folder, of a run whose tiles have north up.
    drive : path
        A recording (`slicematch.tracking.drive.open_drive`).
    aerial_map : path
        A georeferenced raster (`slicematch.data.maps.AerialMap.open`).
    out : path
        The track (`slicematch.tracking.outputs.write_track`).
    near : (lat, lon), optional
        Where it begins, about; by default the recording's first fix.
    within_m : float, optional
        How far from there, as about two in three such places are; by default anywhere in the tile,
        and without `fixes` the first one's accuracy, at least 20 m.
    heading : (centre, deviation), optional
        The heading at the start, degrees; by default unknown.
    fixes : bool
        Whether the recording's fixes are used along the way, not only for where it begins.
    smoothed : bool
        Let later frames have a say in earlier ones, once the drive is over.
    picture, animation : path, optional
        The track on its map with ellipses: PNG, SVG or PDF; and frame by frame: GIF.
    rerun : path, optional
        For the Rerun viewer, ``.rrd`` (`slicematch.tracking.rerun_output.save_rerun`).
    topics : dict, optional
        Of a bag: ``image_topic``, ``odometry_topic``, ``imu_topic``, ``fix_topic``.
    map_crs, side_m
        As `slicematch.locate` takes them.
    checkpoint, device, precision, cache
        As `Localizer.load` takes them.
    settings : TrackSettings, optional
    progress : callable, optional
        Called with (frames done, frames in all).

    Returns
    -------
    Tracked

    Raises
    ------
    RunError, ConfigError, BankError, MapError, DatasetError
        If the run, the request, the map or the recording is unusable.
    OutputError, PlotError
        If a file cannot be written where it should go.
    """
    targets = _check_targets(out, picture, animation, rerun)
    config = RunFolder(find_run(run)).load_config()
    tile_side(config, side_m)  # the likeliest slips, before anything is loaded
    opened = AerialMap.open(aerial_map, map_crs)
    recording = open_drive(drive, config, **(topics or {}))
    start = _start(recording, drive, near, within_m, fixes)
    localizer = Localizer.load(
        run,
        grid="2x2x4",
        checkpoint=checkpoint,
        device=device,
        precision=precision,
        cache=cache,
        alone=True,
    )
    tracker = Tracker(localizer, opened, start, heading, side_m, settings, cache)
    with tracker:
        frames, estimates, steps = run_cancellable(
            lambda check: _follow(tracker, recording, fixes, smoothed, progress, check)
        )
        if smoothed:
            drawn = smooth(steps, tracker.settings.noise, tracker.rng)
            least_m = tracker.settings.registration_m
            estimates = smoothed_estimates(estimates, drawn, tracker.tiles, least_m)
    found = Track([frame.time_s for frame in frames], estimates, tracker.tiles.origin)
    notes: dict[str, int] = {}
    for one in estimates:
        for note in one.notes:
            notes[note] = notes.get(note, 0) + 1
    truths = [frame.truth for frame in frames]
    errors = TrackErrors.of(found, truths)
    write_track(found, targets["out"])
    if "picture" in targets or "animation" in targets:
        from slicematch.tracking.pictures import save_animation, save_picture

        if "picture" in targets:
            save_picture(opened, found, truths, targets["picture"])
        if "animation" in targets:
            save_animation(opened, found, truths, targets["animation"])
    if "rerun" in targets:
        from slicematch.tracking.rerun_output import save_rerun

        images = [frame.image for frame in frames]
        save_rerun(opened, found, images, truths, targets["rerun"])
    return Tracked(found, smoothed, errors, notes, targets)


def _check_targets(
    out: str | Path,
    picture: str | Path | None,
    animation: str | Path | None,
    rerun: str | Path | None,
) -> dict[str, Path]:
    targets = {"out": check_track_target(out)}
    if picture is not None:
        from slicemask.plot import check_figure_target

        targets["picture"] = check_figure_target(picture)
    if animation is not None:
        from slicematch.tracking.pictures import check_animation_target

        targets["animation"] = check_animation_target(animation)
    if rerun is not None:
        from slicematch.tracking.rerun_output import check_rerun_target

        targets["rerun"] = check_rerun_target(rerun)
    return targets


def _start(
    recording: Drive,
    path: str | Path,
    near: tuple[float, float] | None,
    within_m: float | None,
    fixes: bool,
) -> PlaceOnGlobe:
    """Where a drive begins."""
    if near is not None:
        return PlaceOnGlobe(*near, within_m)
    found = recording.start(fixes)
    if found is None:
        raise DatasetError(
            f"{path}: holds no fix, so that nobody knows where it begins; say it (--near lat,lon)"
        )
    return found if within_m is None else replace(found, within_m=within_m)


def _follow(
    tracker: Tracker,
    recording: Drive,
    fixes: bool,
    keep: bool,
    progress: Callable[[int, int], None] | None,
    check: CancelCheck,
) -> tuple[list[Frame], list[TrackEstimate], list[Step]]:
    frames: list[Frame] = []
    estimates: list[TrackEstimate] = []
    steps: list[Step] = []
    total = len(recording)
    for frame in recording:
        check()
        dt_s = frame.time_s - frames[-1].time_s if frames else 0.0
        fix = frame.fix if fixes else None
        estimates.append(tracker.step(frame.image, frame.odometry, dt_s, frame.note, fix))
        frames.append(frame)
        if keep:
            moved_s = estimates[-1].time_s - estimates[-2].time_s if len(estimates) > 1 else 0.0
            steps.append(Step.of(tracker.hypotheses, tracker.odometry, moved_s))
        if progress is not None:
            progress(len(frames), total)
    if not frames:
        raise RunError("the recording holds no frame; name another")
    return frames, estimates, steps
