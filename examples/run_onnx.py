"""Answers of an exported run, with onnxruntime and NumPy alone.

    slicemask export generated-city --out exported
    python examples/run_onnx.py exported [pair.npz]

A pair holds two images of the sizes in export.json, as `ground` and `aerial`: uint8
[1, height, width, 3], red, green, blue. By default it is the example that export left there.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import onnxruntime

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("folder", type=Path, help="what slicemask export wrote")
parser.add_argument("pair", nargs="?", help="two images as .npz")
arguments = parser.parse_args()
folder = arguments.folder
for path in (folder / "ground.onnx", Path(arguments.pair or folder / "example.npz")):
    if not path.is_file():
        parser.error(f"{path}: no such file; name what slicemask export wrote")
pair = np.load(arguments.pair or folder / "example.npz")
candidates = dict(np.load(folder / "candidates.npz"))
poses = candidates.pop("poses")  # u, v, heading_deg; what is left are their masks, unless baked in

options = onnxruntime.SessionOptions()
options.intra_op_num_threads, options.log_severity_level = 1, 3
ground, aerial, scores = (
    onnxruntime.InferenceSession(folder / f"{part}.onnx", options, ["CPUExecutionProvider"])
    for part in ("ground", "aerial", "scores")
)


def answer() -> np.ndarray:
    """Scores of all candidates. To leave some out, leave out their rows of index and poses."""
    (descriptors,) = ground.run(None, {"images": pair["ground"]})
    (features,) = aerial.run(None, {"images": pair["aerial"]})
    inputs = {"ground": descriptors[0], "features": features[0], **candidates}
    return scores.run(None, inputs)[0]


answer()
start = time.process_time()
found = answer()
seconds = time.process_time() - start
u, v, heading_deg = poses[found.argmax()]
print(f"u {u:.4f}, v {v:.4f}, heading {heading_deg:.2f} deg, score {found.max():.4f}")
print(f"{len(poses):,} candidates, {seconds:.3f} s of one thread")
if "scores" in pair:
    print(f"at most {np.abs(found - pair['scores']).max():.1g} off PyTorch's scores")
