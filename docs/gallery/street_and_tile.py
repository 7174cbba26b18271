"""
A generated street from both views
==================================

One pair of a generated city: the panorama in its slices, and the same slices on the aerial tile,
from the camera's true pose. What is in slice n of one is in slice n of the other.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from slicemask import Frustum, slice_masks
from slicemask.plot import draw_slices, slice_colours
from slicemask.synth import generate_vigor

city = generate_vigor(
    "data/street", panoramas=2, seed=8, panorama_size=(1024, 512), tile_size=640, jobs=1
)
labels = city.path / "splits__corrected" / "NewYork" / "pano_label_balanced__corrected.txt"
panorama, tile, d0, d1, *_ = labels.read_text().splitlines()[0].split(" ")
# Offsets are in pixels of 640; north is at the centre column.
pose = (0.5 - float(d1) / 640, 0.5 + float(d0) / 640, 0.0)

frustum = Frustum(hfov_deg=360, slices=16)
figure = Figure(figsize=(11.5, 4.4), facecolor="white", layout="constrained")
street, above = figure.subplots(1, 2, width_ratios=(1.7, 1))
street.imshow(Image.open(Path(city.path, "NewYork", "panorama", panorama)), extent=(0, 16, 0, 8))
for n, colour in enumerate(slice_colours(16)):
    street.fill((n, n + 1, n + 1, n), (0, 0, 8, 8), color=colour, alpha=0.18, linewidth=0)
    street.text(n + 0.5, 8.15, str(n), ha="center", color=0.7 * colour, fontweight="bold")
street.vlines(np.arange(17), 0, 8, color="white", linewidth=0.8)
street.set_axis_off()
masks = slice_masks([pose], frustum, cells=32)[0]
draw_slices(above, masks, pose, frustum, Image.open(Path(city.path, "NewYork", "satellite", tile)))
