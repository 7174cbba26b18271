"""A sheet of answers without their photographs: what may be shown of pictures that are not ours."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from slicematch import Estimate

from slicemask.plot import arrow_tip

COLUMNS = 3
ESTIMATE, TRUTH = "#e6007e", "#00b050"


@dataclass(frozen=True)
class SheetAnswer:
    """An answer, and the true pose [3] in the same tile of so many metres a side."""

    name: str
    estimate: Estimate
    truth: np.ndarray
    side_m: float
    caption: str


def save_sheet(path: Path, answers: list[SheetAnswer]) -> None:
    """Draw each answer: probabilities of all places, north up, the estimate and the truth."""
    rows = math.ceil(len(answers) / COLUMNS)
    figure = Figure(figsize=(3.3 * COLUMNS, 3.6 * rows + 0.4), layout="constrained")
    panels = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    for axes, answer in zip(panels, answers, strict=False):
        _draw(axes, answer)
    for axes in panels[len(answers) :]:
        axes.set_axis_off()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def _draw(axes: Axes, answer: SheetAnswer) -> None:
    u0, v0, u1, v1 = answer.estimate.grid.extent
    places = answer.estimate.place_map
    # The square root: what is unlikely stays in sight.
    axes.imshow(np.sqrt(places / places.max()), extent=(u0, u1, v1, v0), cmap="Blues")
    for name, colour, pose in (
        ("truth", TRUTH, answer.truth),
        ("estimate", ESTIMATE, answer.estimate.pose),
    ):
        axes.plot(*pose[:2], "o", color=colour, markersize=6, label=name)
        axes.annotate(
            "",
            arrow_tip(pose, 0.0),
            pose[:2],
            arrowprops={"arrowstyle": "->", "color": colour, "linewidth": 2},
        )
    axes.set(xlim=(0, 1), ylim=(1, 0), xticks=[], yticks=[])
    axes.set_title(f"{answer.name}, {answer.side_m:.0f} m\n{answer.caption}", fontsize=9)
