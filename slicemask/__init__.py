"""slicemask: exact slice masks for cross-view localization.

`slice_masks` gives the share of each aerial feature cell that each slice of a camera's field of
view covers; `build_bank` stores the masks of thousands of poses, `open_bank` reads them back.
"""

import lazy_loader

# What is public stands in __init__.pyi, and is imported when it is first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
