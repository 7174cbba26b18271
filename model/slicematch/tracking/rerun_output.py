"""A track for the Rerun viewer: its map, the camera with its belief, and images, over time."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from slicemask.errors import OutputError
from slicemask.files import atomic_write, check_target
from slicemask.images import Picture
from slicematch.data.errors import PlaceError
from slicematch.data.maps import AerialMap
from slicematch.localization.geodesy import offset_m, offset_position
from slicematch.localization.probabilities import ellipse, ellipse_outline
from slicematch.tracking.outputs import Track
from slicematch.tracking.track_estimate import TrackMode

Floats = NDArray[np.float64]
Truths = Sequence[tuple[float, float, float] | None]

_PIXELS, _MARGIN_M = 1400, 30.0
_TRACK, _TRUTH, _BELIEF = (255, 63, 208), (57, 211, 83), (255, 255, 255)
_ARROW_M = 8.0
_TIMELINE = "time"


def check_rerun_target(path: str | Path) -> Path:
    """Return the path of a recording to be written, or raise OutputError if it cannot be."""
    path = check_target(path, (".rrd",), OutputError)
    try:
        import rerun  # noqa: F401
    except ImportError as error:
        raise OutputError(
            f"{path}: needs Rerun, which cannot be imported ({error}); install: "
            "pip install 'slicemask[rerun]', or leave out --rerun"
        ) from error
    return path


def save_rerun(
    aerial_map: AerialMap,
    track: Track,
    images: Sequence[Picture | None],
    truths: Truths,
    path: Path,
) -> None:
    """Write a track as a recording of Rerun's.

    ``/map`` is a picture of the map, north up, and what lies on it is in its pixels: ``track``,
    ``modes`` (those that are notable, as arrows along their headings, the likelier the more
    opaque), ``ellipses`` (95 % of each), ``truth``. ``/image`` is what the camera saw, ``/belief``
    holds the answer's probability and its ellipse's semi-axes in metres. The timeline ``time``
    counts seconds of the drive.

    Parameters
    ----------
    aerial_map : AerialMap
    track : Track
    images : sequence of path, image or None
        As many.
    truths : sequence of (lat, lon, heading_deg) or None
        As many.
    path : path

    Raises
    ------
    OutputError
        If the file cannot be written; nothing is left behind.
    """
    import rerun as rr

    places = np.array([(one.modes[0].east_m, one.modes[0].north_m) for one in track.estimates])
    ground = _Ground.around(aerial_map, track, places)
    with atomic_write(path, OutputError) as partial:
        # Its name would be random, and the same drive another file.
        recording = rr.RecordingStream("slicemask", recording_id="track", send_properties=False)
        recording.save(partial)
        if ground.image is not None:
            recording.log("map", rr.Image(ground.image).compress(), static=True)
        line = rr.LineStrips2D([ground.pixels(places)], colors=[(*_TRACK, 140)], radii=1.0)
        recording.log("map/track", line, static=True)
        frames = zip(track.times_s, track.estimates, images, truths, strict=True)
        for time_s, one, image, truth in frames:
            recording.set_time(_TIMELINE, duration=time_s - track.times_s[0])
            _log_modes(rr, recording, ground, one.notable)
            if truth is not None:
                at = ground.pixels(np.array([offset_m(track.origin, truth[:2])]))
                recording.log("map/truth", rr.Points2D(at, colors=[_TRUTH], radii=4.0))
            seen = rr.Clear(recursive=False) if image is None else _shown(rr, image)
            recording.log("image", seen)
            major_m, minor_m, _ = ellipse(one.covariance[:2, :2])
            recording.log("belief/probability", rr.Scalars(one.probability))
            recording.log("belief/ellipse_m", rr.Scalars([major_m, minor_m]))
            if one.notes:
                recording.log("belief/notes", rr.TextLog("; ".join(one.notes)))
        recording.disconnect()


def _log_modes(rr: Any, recording: Any, ground: "_Ground", modes: Sequence[TrackMode]) -> None:
    at = np.array([(mode.east_m, mode.north_m) for mode in modes])
    angles = np.radians([mode.heading_deg for mode in modes])
    ahead = _ARROW_M * np.column_stack([np.sin(angles), np.cos(angles)])
    opacity = [round(255 * max(0.2, mode.probability)) for mode in modes]
    first = ground.pixels(at)
    arrows = rr.Arrows2D(
        origins=first, vectors=ground.pixels(at + ahead) - first, radii=1.5,
        colors=[(*_TRACK, value) for value in opacity],
    )  # fmt: skip
    rings = [ground.pixels(place + _ring(mode)) for place, mode in zip(at, modes, strict=True)]
    colours = [(*_BELIEF, value) for value in opacity]
    recording.log("map/modes", arrows)
    recording.log("map/ellipses", rr.LineStrips2D(rings, colors=colours, radii=0.8))


def _ring(mode: TrackMode) -> Floats:
    """The ellipse of 95 % about its middle, metres east and north, float64 [n, 2]."""
    return ellipse_outline(*ellipse(mode.covariance[:2, :2]))


def _shown(rr: Any, image: Picture) -> Any:
    if isinstance(image, str | Path):
        return rr.EncodedImage(path=image)
    content = io.BytesIO()
    picture = image if isinstance(image, Image.Image) else Image.fromarray(np.asarray(image))
    picture.convert("RGB").save(content, "JPEG", quality=85)
    return rr.EncodedImage(contents=content.getvalue(), media_type="image/jpeg")


class _Ground:
    """A square picture of the map; metres of the track's frame as its pixels."""

    def __init__(self, image: NDArray[np.uint8] | None, middle: Floats, half_m: float) -> None:
        self.image, self._middle, self._half_m = image, middle, half_m

    @classmethod
    def around(cls, aerial_map: AerialMap, track: Track, places: Floats) -> "_Ground":
        """Of a track; without an image where it lies off the map."""
        low, high = places.min(axis=0), places.max(axis=0)
        middle, half_m = (low + high) / 2, float((high - low).max()) / 2 + _MARGIN_M
        centre = offset_position(track.origin, *middle.tolist())
        try:
            image = aerial_map.cut(*centre, 2 * half_m, _PIXELS, max_padded=0.999).image
        except PlaceError:
            image = None
        return cls(image, middle, half_m)

    def pixels(self, places: Floats) -> Floats:
        """Places [n, 2], metres east and north, as x and y, pixels."""
        scale = _PIXELS / (2 * self._half_m)
        return (places - self._middle) * [scale, -scale] + _PIXELS / 2
