"""
Slices of a panorama
====================

A panorama sees all around, so its slices are equal azimuth ranges. Slice 0 begins opposite the
heading, and slices run clockwise. The small squares are the masks: of each cell, the share that the
slice covers.
"""

from slicemask import Frustum, slice_masks
from slicemask.plot import draw_pose

pose = (0.62, 0.58, 30.0)  # u, v, heading_deg
frustum = Frustum(hfov_deg=360, slices=16)
masks = slice_masks([pose], frustum, cells=32)[0]  # [N, L, L]
figure = draw_pose(masks, pose, frustum)
