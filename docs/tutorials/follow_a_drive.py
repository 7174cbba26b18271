"""
Follow a car on a map
=====================

A single image in a city of like streets has several good answers; a car that moves has one. This
page drives through a generated city for fifteen seconds, follows the car with the run that comes
with slicemask, and looks at how far off it was.

It needs ``slicemask[model,maps,synth]``, and takes a minute on a laptop's processor.
"""

# %%
# A drive, and a map
# ------------------
#
# Panoramas twice a second, a wheel's speed and a gyroscope that both drift, a GNSS fix each second,
# and one GeoTIFF of the city. As a command it is ``slicemask synth --format drive --seconds 15
# --rate-hz 2 --seed 5 --tile-size 320 --out data/drive``.

from slicemask.synth import generate_drive

generate_drive("data/drive", seconds=15, rate_hz=2, seed=5, tile_size=320, jobs=1)

# %%
# Track it
# --------
#
# The first fix says where it begins, to some 20 m; the heading is unknown. Later fixes are weak
# evidence (``--no-fixes`` does without). The command is
# ``slicemask track generated-city --drive data/drive/drive_00.csv --map data/drive/map.tif --out
# track.csv --picture track.png``. The drive's table holds the truth, too: nothing is tracked by it,
# and errors are reported against it.

from slicematch.tracking.track import track

tracked = track(
    "generated-city", "data/drive/drive_00.csv", "data/drive/map.tif", "data/drive/track.csv",
    picture="data/drive/track.png", device="cpu",
)  # fmt: skip
print(tracked)

# %%
# The track is magenta, the truth green; an ellipse holds 95 % of the belief, if its place is the
# right one.

import matplotlib.pyplot as plt

figure, axes = plt.subplots(figsize=(7, 7), layout="constrained")
axes.imshow(plt.imread("data/drive/track.png"))
axes.set_axis_off()

# %%
# How the belief grew sure
# ------------------------
#
# At first several places look alike. Each estimate has all of them, the likeliest first (those of
# 2 % and more are ``notable``), and a covariance; what was found of the odometry comes along: by
# how much its speeds are short, and what its gyroscope says when the car goes straight.

for time_s, estimate in list(zip(tracked.track.times_s, tracked.track.estimates, strict=True))[::5]:
    print(
        f"{time_s:5.1f} s: {len(estimate.notable)} places, the likeliest with "
        f"{estimate.probability:.0%}; speeds times {estimate.speed_scale:.3f}, "
        f"yaw rate off by {estimate.yaw_bias_dps:+.2f} degrees/s"
    )

# %%
# Afterwards
# ----------
#
# Who needs a map of what was driven, not a position while driving, lets later frames have a say in
# earlier ones: ``smoothed=True``, or ``--smooth``. Headings gain by it, places not on every drive.

smoothed = track(
    "generated-city", "data/drive/drive_00.csv", "data/drive/map.tif", "data/drive/smooth.tum",
    smoothed=True, device="cpu",
)  # fmt: skip
print("filtered:", tracked.errors)
print("smoothed:", smoothed.errors)

# %%
# ``evo_traj tum data/drive/smooth.tum`` reads this one, and ``slicemask app --track
# data/drive/track.csv --map data/drive/map.tif`` plays the other back on its map, frame by frame.
# :doc:`/drives` has all inputs and outputs: KITTI, ROS bags, MCAP, GeoJSON, and frames that come
# live.
