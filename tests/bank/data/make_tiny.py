"""How tiny_v1.h5 and tiny_v2.h5 were made: ``python tests/bank/data/make_tiny.py``, once each.

Files of a version stay as the first release of that version wrote them; a new version gets a
file of its own.
"""

from pathlib import Path

from slicemask import Frustum, build_bank

POSES = [[0.5, 0.5, 0.0], [0.5, 0.5, 90.0], [0.0, 0.0, 0.0], [0.0, 0.0, 135.0]]

if __name__ == "__main__":
    for version, bands in ((1, ()), (2, (0.5,))):
        out = Path(__file__).with_name(f"tiny_v{version}.h5")
        if not out.exists():
            frustum = Frustum(hfov_deg=90, slices=2, projection="pinhole", bands=bands)
            if version == 1:
                frustum = Frustum(hfov_deg=180, slices=2)
            build_bank(POSES, frustum, cells=2, out=out)
