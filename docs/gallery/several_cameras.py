"""
Axes of your own
================

``draw_slices`` draws on any Matplotlib axes, so that a picture can hold what a paper needs: here
four cameras that drive along a street and turn.
"""

from matplotlib.figure import Figure

from slicemask import Frustum, slice_masks
from slicemask.plot import draw_slices

frustum = Frustum(hfov_deg=90, slices=6, projection="pinhole")
poses = [(0.3, 0.85, 0.0), (0.3, 0.6, 10.0), (0.35, 0.4, 50.0), (0.6, 0.3, 90.0)]
figure = Figure(figsize=(10, 3), facecolor="white")
for axes, pose in zip(figure.subplots(1, 4), poses, strict=True):
    draw_slices(axes, slice_masks([pose], frustum, cells=24)[0], pose, frustum)
    axes.set_title("({:.2f}, {:.2f}), {:.0f}°".format(*pose), fontsize=9)
