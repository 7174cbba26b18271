"""
The floor of a grid
===================

An answer that is one of the candidates cannot be nearer to the truth than the nearest candidate.
For true places spread evenly over a tile of 72 m: the error that is left, whatever the model.
"""

import numpy as np
from matplotlib.figure import Figure
from slicematch.evaluation.metrics import oracle_error

from slicemask import PoseGrid

random = np.random.default_rng(0)
truths = random.uniform((0, 0, 0), (1, 1, 360), (4000, 3))
figure = Figure(figsize=(7, 3.4), layout="constrained")
axes = figure.subplots()
for size, colour in ((7, "#b0b7bf"), (21, "#2f6fb0"), (64, "#12a37a"), (128, "#e6007e")):
    oracle = oracle_error(PoseGrid(size, size, 1).poses(), truths, 72.0)
    label = f"{size}x{size}: {oracle.place_m.mean():.2f} m in the mean"
    axes.hist(
        oracle.place_m, bins=np.arange(0, 7.6, 0.08), histtype="step", color=colour, label=label
    )
axes.set(xlabel="distance to the nearest candidate, m", ylabel="true places", yscale="log")
axes.legend(frameon=False)
