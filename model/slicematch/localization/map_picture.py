"""A picture of a map with all answers on it, and how sure each is."""

import logging
import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from slicematch.data.errors import PlaceError
from slicematch.data.maps import AerialMap
from slicematch.localization.geodesy import offset_m

log = logging.getLogger(__name__)

_PIXELS, _INCHES = 1400, 8.0
# What is drawn around the answers, in shares of what they span and metres.
_MARGIN, _LEAST_MARGIN_M = 0.08, 25.0
# More pixels of a map without overviews would be read for minutes.
_MOST_READ = 3e8
_ARROW = 0.035  # of the picture's side
_INK, _RING = "#17212b", "#ffffff"
_OUTLINE = [withStroke(linewidth=2.2, foreground="#00000090")]


def draw_answers(aerial_map: AerialMap, answers: Any, title: str = "") -> Figure:
    """Draw the map around the answers: each with its heading, its ellipse, and its probability.

    Parameters
    ----------
    aerial_map : AerialMap
        That they were found on.
    answers : pandas.DataFrame
        Rows of `slicematch.localization.answers.ANSWER_COLUMNS`.
    title : str
        Above the picture; how many there are by default.

    Returns
    -------
    figure : matplotlib.figure.Figure
        Bound to no window; axes in metres east and north of its middle.
    """
    found = answers[answers["error"].isna()]
    figure = Figure(figsize=(_INCHES + 1.3, _INCHES + 0.9), facecolor="white")
    axes = figure.add_axes((0.08, 0.07, 0.80, 0.86))
    axes.set_title(
        title or f"{len(found):,} of {len(answers):,} photographs located", loc="left", color=_INK
    )
    if not len(found):
        axes.set_axis_off()
        return figure
    lat, lon = found["lat"].to_numpy(), found["lon"].to_numpy()
    centre = (float(lat.min() + lat.max()) / 2, float(lon.min() + lon.max()) / 2)
    places = np.array([offset_m(centre, place) for place in zip(lat, lon, strict=True)])
    reach_m = float(np.abs(places).max())
    half_m = reach_m + max(_MARGIN * reach_m, _LEAST_MARGIN_M)
    _draw_map(axes, aerial_map, centre, half_m)
    _draw_ellipses(axes, places, found)
    heading = np.radians(found["heading_deg"].to_numpy())
    likely = found["probability"].to_numpy()
    east, north = places.T
    axes.quiver(
        east, north, np.sin(heading), np.cos(heading), color=_RING, angles="xy", width=0.0035,
        scale=1 / (_ARROW * 2 * half_m), scale_units="xy", headwidth=3.5, headlength=4, zorder=3,
        edgecolor=_INK, linewidth=0.4,
    )  # fmt: skip
    points = axes.scatter(
        east, north, c=likely, s=_dot_area(len(found)), cmap="plasma", vmin=0.0, vmax=1.0,
        edgecolors=_RING, linewidths=0.8, zorder=4,
    )  # fmt: skip
    bar = figure.colorbar(points, cax=figure.add_axes((0.90, 0.20, 0.02, 0.60)))
    bar.set_label("probability of the answer", color=_INK)
    axes.set(xlim=(-half_m, half_m), ylim=(-half_m, half_m), aspect="equal")
    axes.set_xlabel(f"metres east of {centre[0]:.6f}, {centre[1]:.6f}", color=_INK)
    axes.set_ylabel("metres north", color=_INK)
    return figure


def _draw_map(
    axes: Axes, aerial_map: AerialMap, centre: tuple[float, float], half_m: float
) -> None:
    axes.set_facecolor("#d9dde1")
    read = (2 * half_m / aerial_map.metres_per_pixel(*centre)) ** 2
    if read > _MOST_READ and not aerial_map.has_overviews:
        log.warning(
            "%s: has no overviews, so that the picture leaves it out; gdaladdo makes some",
            aerial_map.path,
        )
        return
    try:
        tile = aerial_map.cut(*centre, 2 * half_m, _PIXELS, max_padded=0.999)
    except PlaceError:  # answers around a hole
        return
    axes.imshow(tile.image, extent=(-half_m, half_m, -half_m, half_m), zorder=0)


def _draw_ellipses(axes: Axes, places: NDArray[np.float64], found: Any) -> None:
    """The ellipses that hold 95 % of each answer's probability."""
    major, minor = found["ellipse_major_m"].to_numpy(), found["ellipse_minor_m"].to_numpy()
    axes.add_collection(
        EllipseCollection(
            2 * major, 2 * minor, 90.0 - found["ellipse_azimuth_deg"].to_numpy(), units="xy",
            offsets=places, offset_transform=axes.transData, facecolors="#ffffff30",
            edgecolors=_RING, linewidths=1.0, zorder=2, path_effects=_OUTLINE,
        )
    )  # fmt: skip


def _dot_area(count: int) -> float:
    """Points of many answers are smaller, in square points."""
    return max(4.0, 70.0 / math.sqrt(max(1.0, count / 20)))
