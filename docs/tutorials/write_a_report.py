"""
Write a report of figures
=========================

An evaluation leaves everything that a paper's table and figures need: ``result.json`` with the
settings and every sample, and ``samples.csv``, a row a sample. This page turns them into a table
with standard errors and three figures. It reads the results of
:doc:`/auto_tutorials/train_and_evaluate`, and works on those of any run.
"""

# %%
# What is there
# -------------

import json
from pathlib import Path

import numpy as np

(folder,) = Path("runs/tutorial/evaluation").iterdir()
result = json.loads((folder / "result.json").read_text())
samples = {name: np.array([row[name] for row in result["per_sample"]]) for name in (
    "error_place_m", "error_lateral_m", "error_longitudinal_m", "error_heading_deg",
    "probability", "within_reach", "true_u", "true_v", "tile_metres",
)}  # fmt: skip
print({name: result[name] for name in ("data", "split", "part", "grid", "refine", "checkpoint")})
print(f"{result['samples']} samples, {len(result['unreadable'])} unreadable")

# %%
# A table with standard errors
# ----------------------------
#
# A median of 80 samples is uncertain, and a table should say by how much: resample the samples
# many times and take the spread (bootstrap). Two methods on the *same* samples are compared
# better by the differences of each sample's errors, which vary less.

random = np.random.default_rng(0)
draws = random.integers(len(samples["error_place_m"]), size=(2000, len(samples["error_place_m"])))


def with_error(values, figure):
    """A figure of the samples with its standard error."""
    return f"{figure(values):.2f} ± {figure(values[draws], axis=1).std():.2f}"


centre = np.hypot(samples["true_u"] - 0.5, samples["true_v"] - 0.5) * samples["tile_metres"]
print("| | mean | median |")
print("| --- | --- | --- |")
for name, values in (
    ("place, m", samples["error_place_m"]),
    ("lateral, m", samples["error_lateral_m"]),
    ("longitudinal, m", samples["error_longitudinal_m"]),
    ("heading, degrees", samples["error_heading_deg"]),
    ("guessing the tile's centre, m", centre),
):
    print(f"| {name} | {with_error(values, np.mean)} | {with_error(values, np.median)} |")

# %%
# How many answers are how good
# -----------------------------
#
# Curves say more than any recall: the share of samples below each error. The oracle's mean, the
# best that the candidates allow, is a line to compare with.

from matplotlib.figure import Figure

MAGENTA, BLUE, GREY = "#e6007e", "#2f6fb0", "#8a94a0"
share = np.arange(1, result["samples"] + 1) / result["samples"]
curves = Figure(figsize=(7.5, 3.2), layout="constrained")
place, heading = curves.subplots(1, 2)
for name, label, colour, style in (
    ("error_place_m", "place", MAGENTA, "-"),
    ("error_lateral_m", "lateral", BLUE, "--"),
    ("error_longitudinal_m", "longitudinal", BLUE, ":"),
):
    place.step(np.sort(samples[name]), share, style, color=colour, label=label, where="post")
place.axvline(result["oracle"]["place_mean_m"], color=GREY, linewidth=1, label="oracle, mean")
place.set(xlabel="error, m", ylabel="share of samples below", xlim=(0, 20), ylim=(0, 1))
place.legend(loc="lower right", frameon=False)
heading.step(np.sort(samples["error_heading_deg"]), share, color=MAGENTA, where="post")
for quarter in (90, 180):
    heading.axvline(quarter, color=GREY, linewidth=1, linestyle=":")
heading.set(xlabel="heading error, degrees", xlim=(0, 182), ylim=(0, 1), xticks=range(0, 181, 45))

# %%
# Steps near 90 and 180 degrees are crossings and straight streets that look alike from two or four
# sides.
#
# What the probabilities are worth
# --------------------------------
#
# Answers in bins of their probability, and how many of each bin were within reach: on the diagonal,
# a probability means what it says.

edges = np.linspace(0, 1, 6)
bins = np.clip(np.digitize(samples["probability"], edges) - 1, 0, 4)
reliability = Figure(figsize=(3.6, 3.4), layout="constrained")
axes = reliability.subplots()
axes.plot([0, 1], [0, 1], color=GREY, linewidth=1)
for number in range(5):
    inside = bins == number
    if inside.any():
        x, y = samples["probability"][inside].mean(), samples["within_reach"][inside].mean()
        axes.scatter(x, y, s=8 * inside.sum(), color=MAGENTA, alpha=0.8)
        axes.annotate(f"{inside.sum()}", (x, y), textcoords="offset points", xytext=(7, -10))
axes.set(xlabel="probability", ylabel="share within reach", xlim=(0, 1.05), ylim=(-0.05, 1.05))

# %%
# Where the errors are
# --------------------
#
# Errors along and across the street, and the answers' probability as colour: what is wrong by a lot
# is mostly unsure of itself.

scatter = Figure(figsize=(5.4, 4), layout="constrained")
axes = scatter.subplots()
points = axes.scatter(
    samples["error_lateral_m"] + 0.05,
    samples["error_longitudinal_m"] + 0.05,
    c=samples["probability"],
    cmap="viridis",
    vmin=0,
    vmax=1,
    s=22,
)
axes.set(xscale="log", yscale="log", xlabel="lateral error, m", ylabel="longitudinal error, m")
scatter.colorbar(points, label="probability")

# %%
# For the paper
# -------------
#
# Vector graphics are one call away, and the settings that belong under the table are in the same
# file as its figures.

curves.savefig(folder / "curves.pdf")
print(json.dumps({k: v for k, v in result.items() if not isinstance(v, list | dict)}, indent=1))
