"""slicemask: exact slice masks for cross-view localization.

`slice_masks` gives the share of each aerial feature cell that each slice of a camera's field of
view covers; `build_bank` stores the masks of thousands of poses, `open_bank` reads them back.
"""

__version__ = "0.1.0"

from slicemask.bank.build import BuildResult, build_bank
from slicemask.bank.read import Bank, open_bank
from slicemask.bank.spec import BankSpec
from slicemask.errors import (
    BankError,
    BankExistsError,
    BankFormatError,
    PlotError,
    PoseError,
    SlicemaskError,
    SpecError,
)
from slicemask.geometry.frustum import Frustum
from slicemask.geometry.masks import slice_masks
from slicemask.geometry.poses import PoseGrid, read_poses

__all__ = [
    "Bank",
    "BankError",
    "BankExistsError",
    "BankFormatError",
    "BankSpec",
    "BuildResult",
    "Frustum",
    "PlotError",
    "PoseError",
    "PoseGrid",
    "SlicemaskError",
    "SpecError",
    "build_bank",
    "open_bank",
    "read_poses",
    "slice_masks",
]
