"""
Slices of a pinhole camera
==========================

A camera image is cut into slices of equal *width*, which are not equal azimuth ranges: with a wide
field of view, the outer slices are narrower. Here in two halves, an equirectangular crop and a
pinhole image of 120 degrees each.
"""

import numpy as np
from matplotlib.figure import Figure

from slicemask import Frustum, slice_masks
from slicemask.plot import draw_slices

pose = (0.5, 0.75, 0.0)
figure = Figure(figsize=(9, 4.6), facecolor="white")
for axes, projection in zip(figure.subplots(1, 2), ("equirectangular", "pinhole"), strict=True):
    frustum = Frustum(hfov_deg=120, slices=8, projection=projection)
    masks = slice_masks([pose], frustum, cells=32)[0]
    draw_slices(axes, masks, pose, frustum)
    widths = ", ".join(f"{width:.1f}" for width in np.diff(frustum.edge_offsets_deg())[:4])
    axes.set_title(f"{projection}: {widths}° …", fontsize=10)
