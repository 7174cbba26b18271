"""The picture of time and bytes against the number of poses."""

from pathlib import Path

from matplotlib.figure import Figure

PICTURE = Path(__file__).parent.parent / "docs" / "images" / "growth.svg"
_COLOURS = {"shapely": "#c2571a", "rays": "#1f6f8b"}


def draw(rows: dict[str, list[tuple[int, int, float, float]]]) -> None:
    """Draw (poses, distinct masks, seconds, megabytes) of each engine's builds."""
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    time, size = figure.subplots(1, 2)
    for engine, points in rows.items():
        poses, _, seconds, megabytes = zip(*points, strict=True)
        time.loglog(poses, seconds, "o-", color=_COLOURS[engine], label=engine)
        size.loglog(poses, megabytes, "o-", color=_COLOURS[engine], label=engine)
    time.set(title="Whole build command", xlabel="poses K", ylabel="seconds")
    size.set(title="Bank on disk", xlabel="poses K", ylabel="megabytes")
    for axes in (time, size):
        axes.grid(True, which="both", alpha=0.25)
        axes.legend(title="engine")
    figure.suptitle("16 slices of 360 degrees, 32 x 32 cells")
    PICTURE.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(PICTURE)
