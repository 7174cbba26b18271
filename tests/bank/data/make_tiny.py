"""How tiny_v1.h5 was made: ``python tests/bank/data/make_tiny.py`` wrote it, once for version 1.

Files of a version stay as the first release of that version wrote them; a new version gets a
file of its own.
"""

from pathlib import Path

from slicemask import Frustum, build_bank

POSES = [[0.5, 0.5, 0.0], [0.5, 0.5, 90.0], [0.0, 0.0, 0.0], [0.0, 0.0, 135.0]]

if __name__ == "__main__":
    out = Path(__file__).with_name("tiny_v1.h5")
    build_bank(POSES, Frustum(hfov_deg=180, slices=2), cells=2, out=out, force=True)
