"""Pictures of slices. Matplotlib is loaded when a picture is drawn, not on import."""

from slicemask.images import read_aerial
from slicemask.plot.figure import arrow_tip, draw_pose, draw_slices, edge_ends, slice_colours
from slicemask.plot.files import animate_heading, check_figure_target, save_figure

__all__ = [
    "animate_heading",
    "arrow_tip",
    "check_figure_target",
    "draw_pose",
    "draw_slices",
    "edge_ends",
    "read_aerial",
    "save_figure",
    "slice_colours",
]
