"""The pictures of time and bytes against the number of poses."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

IMAGES = Path(__file__).parent.parent / "docs" / "images"
_COLOURS = {"shapely": "#c2571a", "rays": "#1f6f8b"}


def draw(rows: dict[str, list[tuple[int, int, float, float]]]) -> None:
    """Draw (poses, distinct masks, seconds, megabytes) of each engine's builds."""
    figure = Figure(figsize=(12, 3.8), layout="constrained")
    time, size, line = figure.subplots(1, 3)
    for engine, points in rows.items():
        poses, masks, seconds, megabytes = map(np.array, zip(*points, strict=True))
        colour = _COLOURS[engine]
        time.loglog(poses, seconds, "o-", color=colour, label=engine)
        size.loglog(poses, megabytes, "o-", color=colour, label=engine)
        some = masks <= 262_144
        slope, start = np.polyfit(masks[some], seconds[some], 1)
        line.plot(masks[some], start + slope * masks[some], color=colour, alpha=0.5)
        label = f"{engine}: {start:.2f} s + {slope * 1e6:.0f} us a mask"
        line.plot(masks[some], seconds[some], "o", color=colour, label=label)
    time.set(title="Whole build command", xlabel="poses K", ylabel="seconds")
    size.set(title="Bank on disk", xlabel="poses K", ylabel="megabytes")
    line.set(title="The same, against distinct masks", xlabel="distinct masks M", ylabel="seconds")
    for axes in (time, size, line):
        _style(axes)
        axes.legend()
    line.set_xticks([0, 100_000, 200_000])
    figure.suptitle("16 slices of 360 degrees, 32 x 32 cells, 2 cores")
    figure.savefig(IMAGES / "growth.svg")


def draw_scoring(costs: dict[int, tuple[float, float]]) -> None:
    """Draw (seconds, extra bytes) of scoring, by poses."""
    figure = Figure(figsize=(8, 3.4), layout="constrained")
    time, size = figure.subplots(1, 2)
    poses = np.array(list(costs))
    seconds, extra = np.array(list(costs.values())).T
    time.loglog(poses, seconds, "o-", color=_COLOURS["rays"])
    size.loglog(poses, extra / 1e6, "o-", color=_COLOURS["shapely"])
    time.set(title="Scores of one pair", xlabel="poses K", ylabel="seconds")
    size.set(title="Extra memory at the peak", xlabel="poses K", ylabel="megabytes")
    for axes in (time, size):
        _style(axes)
    figure.savefig(IMAGES / "scoring.svg")


def _style(axes: Axes) -> None:
    # Plain numbers need none of the fonts that powers of ten do.
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.10g}"))
        axis.set_minor_formatter(NullFormatter())
    axes.grid(True, which="both", alpha=0.25)
