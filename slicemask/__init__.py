"""slicemask: exact slice masks for cross-view localization.

`slice_masks` gives the share of each aerial feature cell that each slice of a camera's field of
view covers; `build_bank` stores the masks of thousands of poses, `open_bank` reads them back.
"""

from slicemask.geometry.frustum import Frustum
from slicemask.geometry.masks import slice_masks
from slicemask.geometry.poses import PoseGrid, read_poses

__version__ = "0.1.0"
__all__ = ["Frustum", "PoseGrid", "read_poses", "slice_masks"]
