"""Pictures of a track: on its map with ellipses, and frame by frame."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray
from PIL import Image

from slicemask.errors import PlotError
from slicemask.files import atomic_write, check_target
from slicemask.plot import save_figure
from slicematch.data.errors import PlaceError
from slicematch.data.maps import AerialMap
from slicematch.localization.geodesy import offset_m, offset_position
from slicematch.localization.probabilities import ellipse
from slicematch.tracking.outputs import Track

Floats = NDArray[np.float64]
Truths = Sequence[tuple[float, float, float] | None]

_INK, _TRACK, _TRUTH = "#17212b", "#ff3fd0", "#39d353"
_OUTLINE = [withStroke(linewidth=3.0, foreground="#00000080")]
_MARGIN, _LEAST_MARGIN_M = 0.08, 25.0
_PIXELS = 1400
# Of the animation: frames at most, their pixels, and how long each is shown.
_MOST_FRAMES, _FRAME_PIXELS, _FRAME_MS = 120, 420, 100
_ELLIPSES = 60  # in the picture, at most


def save_picture(aerial_map: AerialMap, track: Track, truths: Truths, path: Path) -> None:
    """Draw a track on its map, with the ellipses of 95 % now and then and the truth if known.

    Raises
    ------
    PlotError
        If the file cannot be written.
    """
    figure, axes = _on_map(aerial_map, track, _PIXELS, 8.6)
    places = _places(track)
    if any(truth is not None for truth in truths):
        true = _true_places(track, truths)
        axes.plot(*true.T, color=_TRUTH, lw=4.0, alpha=0.8, label="truth", zorder=2)
    sure = np.array([one.sure for one in track.estimates])
    line = np.where(sure[:, None], places, np.nan)
    axes.plot(*line.T, color=_TRACK, lw=1.6, label="track", zorder=4, path_effects=_OUTLINE)
    axes.scatter(
        places[~sure, 0], places[~sure, 1], s=6, color="#ffd23f", label="in doubt", zorder=3
    )
    every = max(1, len(places) // _ELLIPSES)
    _draw_ellipses(axes, track, range(0, len(places), every))
    axes.scatter(
        places[:1, 0], places[:1, 1], marker="o", s=60, color="white", edgecolor=_INK, zorder=5
    )
    axes.annotate("start", places[0], (7, 7), textcoords="offset points", color="white",
                  path_effects=_OUTLINE, zorder=6)  # fmt: skip
    axes.legend(loc="upper right", framealpha=0.85)
    save_figure(figure, path)


def check_animation_target(path: str | Path) -> Path:
    """Return the path of an animation to be written, or raise PlotError if it is invalid."""
    return check_target(path, (".gif",), PlotError)


def save_animation(aerial_map: AerialMap, track: Track, truths: Truths, path: Path) -> None:
    """Draw a track frame by frame as a GIF: the map around the camera, and modes with ellipses.

    Raises
    ------
    PlotError
        If the file cannot be written.
    """
    chosen = range(0, len(track.estimates), max(1, len(track.estimates) // _MOST_FRAMES))
    inches = _FRAME_PIXELS / 100
    figure, axes = _on_map(aerial_map, track, _PIXELS, inches, bare=True)
    true = _true_places(track, truths)
    places, images = _places(track), []
    for number in chosen:
        artists: list[object] = []
        one = track.estimates[number]
        centre = places[number]
        axes.set(xlim=centre[0] + np.array([-40, 40]), ylim=centre[1] + np.array([-40, 40]))
        artists += axes.plot(*places[: number + 1].T, color=_TRACK, lw=1.5, zorder=3)
        artists += axes.plot(*true[number : number + 1].T, "o", color=_TRUTH, ms=7, zorder=4)
        for mode in one.notable:
            major, minor, azimuth = ellipse(mode.covariance[:2, :2])
            artists.append(
                axes.add_collection(
                    EllipseCollection(
                        [2 * major], [2 * minor], [90.0 - azimuth], units="xy",
                        offsets=[(mode.east_m, mode.north_m)], offset_transform=axes.transData,
                        facecolors="none", edgecolors="white", linewidths=1.5,
                        alpha=max(0.2, mode.probability), zorder=5,
                    )
                )
            )  # fmt: skip
            angle = np.radians(mode.heading_deg)
            artists.append(
                axes.quiver(
                    mode.east_m, mode.north_m, np.sin(angle), np.cos(angle), color=_TRACK,
                    scale=12, width=0.012, alpha=max(0.2, mode.probability), zorder=6,
                )
            )  # fmt: skip
        text = f"{track.times_s[number] - track.times_s[0]:.1f} s"
        artists.append(
            axes.text(0.03, 0.94, text, transform=axes.transAxes, color="white", zorder=7,
                      path_effects=_OUTLINE)
        )  # fmt: skip
        images.append(_pixels(figure))
        for artist in artists:
            artist.remove()  # type: ignore[attr-defined]
    with atomic_write(path, PlotError) as partial:
        images[0].save(
            partial, "GIF", save_all=True, append_images=images[1:], duration=_FRAME_MS, loop=0
        )


def _pixels(figure: Figure) -> Image.Image:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    drawn = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    return drawn.quantize(128)


def _places(track: Track) -> Floats:
    return np.array([(one.modes[0].east_m, one.modes[0].north_m) for one in track.estimates])


def _true_places(track: Track, truths: Truths) -> Floats:
    """Places of the truth in the track's frame; NaN where unknown."""
    nowhere = (np.nan, np.nan)
    return np.array(
        [nowhere if truth is None else offset_m(track.origin, truth[:2]) for truth in truths]
    )


def _on_map(
    aerial_map: AerialMap, track: Track, pixels: int, inches: float, bare: bool = False
) -> tuple[Figure, Axes]:
    """The map that a track lies on; axes in metres east and north of its origin."""
    places = _places(track)
    low, high = places.min(axis=0), places.max(axis=0)
    middle, reach_m = (low + high) / 2, float((high - low).max()) / 2
    half_m = reach_m + max(_MARGIN * reach_m, _LEAST_MARGIN_M) + (40.0 if bare else 0.0)
    figure = Figure(figsize=(inches, inches), facecolor="white", dpi=100)
    axes = figure.add_axes((0, 0, 1, 1) if bare else (0.09, 0.08, 0.88, 0.88))
    axes.set_facecolor("#d9dde1")
    centre = offset_position(track.origin, *middle.tolist())
    try:
        tile = aerial_map.cut(*centre, 2 * half_m, pixels, max_padded=0.999)
    except PlaceError:  # a track that lies off the map
        pass
    else:
        box = (middle[0] - half_m, middle[0] + half_m, middle[1] - half_m, middle[1] + half_m)
        axes.imshow(tile.image, extent=box, zorder=0)
    axes.set(xlim=middle[0] + np.array([-half_m, half_m]), aspect="equal")
    axes.set(ylim=middle[1] + np.array([-half_m, half_m]))
    if bare:
        axes.set_axis_off()
    else:
        axes.set_xlabel(f"metres east of {track.origin[0]:.6f}, {track.origin[1]:.6f}", color=_INK)
        axes.set_ylabel("metres north", color=_INK)
    return figure, axes


def _draw_ellipses(axes: Axes, track: Track, chosen: Sequence[int]) -> None:
    found = [ellipse(track.estimates[k].covariance[:2, :2]) for k in chosen]
    major, minor, azimuth = np.array(found).T
    axes.add_collection(
        EllipseCollection(
            2 * major, 2 * minor, 90.0 - azimuth, units="xy", offsets=_places(track)[list(chosen)],
            offset_transform=axes.transData, facecolors="#ffffff30", edgecolors="white",
            linewidths=1.0, zorder=3,
        )
    )  # fmt: skip
