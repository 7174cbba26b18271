"""Pictures of slices. Matplotlib is loaded when a picture is drawn, not on import."""

from slicemask.images import read_aerial
from slicemask.plot.colours import slice_colours
from slicemask.plot.figure import draw_pose, draw_slices
from slicemask.plot.files import animate_heading, check_figure_target, save_figure
from slicemask.plot.outlines import arrow_tip, edge_ends

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
