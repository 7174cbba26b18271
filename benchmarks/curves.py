"""The picture of time and bytes against the number of poses."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

PICTURE = Path(__file__).parent.parent / "docs" / "images" / "growth.svg"
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
        # Plain numbers need none of the fonts that powers of ten do.
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.10g}"))
            axis.set_minor_formatter(NullFormatter())
        axes.grid(True, which="both", alpha=0.25)
        axes.legend()
    line.set_xticks([0, 100_000, 200_000])
    figure.suptitle("16 slices of 360 degrees, 32 x 32 cells, 2 cores")
    PICTURE.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(PICTURE)
