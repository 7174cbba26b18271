"""How tiny_v1.h5 to tiny_v3.h5 were made: ``python tests/bank/data/make_tiny.py``, once each.

Files of a version stay as the first release of that version wrote them; a new version gets a
file of its own.
"""

from pathlib import Path

from slicemask import Frustum, build_bank

POSES = [[0.5, 0.5, 0.0], [0.5, 0.5, 90.0], [0.0, 0.0, 0.0], [0.0, 0.0, 135.0]]
FRUSTA = {
    1: Frustum(hfov_deg=180, slices=2),
    2: Frustum(hfov_deg=90, slices=2, projection="pinhole", bands=(0.5,)),
    3: Frustum.from_intrinsics(fx=100, cx=0, width=100, slices=1, bands=(0.25,)),
}

if __name__ == "__main__":
    for version, frustum in FRUSTA.items():
        out = Path(__file__).with_name(f"tiny_v{version}.h5")
        if not out.exists():
            build_bank(POSES, frustum, cells=2, out=out)
