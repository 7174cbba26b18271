"""
Bands of range
==============

Slices may be cut by distance from the camera, in shares of the tile's side. The bands of a slice
sum to the slice. With a pinhole camera, bands are cut by depth instead, and meet at straight
lines.
"""

from slicemask import Frustum, slice_masks
from slicemask.plot import draw_pose

pose = (0.45, 0.6, 0.0)
frustum = Frustum(hfov_deg=360, slices=8, bands=(0.08, 0.17, 0.33))
masks = slice_masks([pose], frustum, cells=32)[0]  # [N, B, L, L]
figure = draw_pose(masks, pose, frustum)

# %%
# The same ranges as depths of a camera image:

camera = Frustum(hfov_deg=80, slices=8, projection="pinhole", bands=(0.08, 0.17, 0.33))
depth = draw_pose(slice_masks([(0.45, 0.8, 20.0)], camera, cells=32)[0], (0.45, 0.8, 20.0), camera)
