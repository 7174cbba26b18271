"""
Train on a generated city and read the evaluation
=================================================

VIGOR and KITTI are available only on request, so this page makes its own data: a small city,
rendered from the street and from above with exact poses. A small network is trained on half of it,
and asked to find the cameras of the other half. It takes two minutes on a laptop's processor, and
the same calls train VGG16 on VIGOR (:doc:`/training`).

It needs ``slicemask[model,synth]``.
"""

# %%
# A city
# ------
#
# Every byte follows from the seed. As a command it is ``slicemask synth --format vigor --panoramas
# 160 --seed 3 --panorama-size 512x256 --tile-size 256 --out data/tutorial``.

from slicemask.synth import generate_vigor

city = generate_vigor(
    "data/tutorial", panoramas=160, seed=3, panorama_size=(512, 256), tile_size=256, jobs=1
)
print(f"{city.images} images in {city.path}")

# %%
# The settings
# ------------
#
# The defaults are the paper's: VGG16, large images, a constant learning rate of 1e-5. These are for
# two minutes on a processor: a network of 0.4 million weights that starts from random ones. Slices
# are cut into bands of range at 6, 12 and 24 m, and sky and bonnet are left out of the panorama;
# both are ours, not the paper's, and the largest single gain (:doc:`/results`). Every setting is
# also an option of ``slicemask train`` and a line of YAML.

from slicematch import TrainConfig

config = TrainConfig(
    data="vigor",
    root="data/tutorial",
    data_settings={"cities": ["NewYork"]},
    encoder="test_resnet",
    weights="none",
    stride=8,
    ground_size=(128, 256),
    aerial_size=256,
    bands=(6, 12, 24),
    elevations=(-45, 45),
    cross_view_attention=False,
    augment=True,
    batch_size=8,
    epochs=12,
    learning_rate=2e-3,
    schedule="one-cycle",
    test_grid="14x14x32",
    heat_map_every=0,
    workers=0,
    accelerator="cpu",
)

# %%
# Training
# --------
#
# One call, which leaves a *run folder*: settings, weights, a log. Stopped at any time, it goes on
# with ``resume=True`` after the last finished epoch.

import shutil
from pathlib import Path

from slicematch import train

run = Path("runs/tutorial")
shutil.rmtree(run, ignore_errors=True)  # from an earlier build of this page
train(config, run, progress=False)
print(*sorted(path.name for path in run.iterdir()))

# %%
# Of each epoch, ``metrics.jsonl`` holds the loss and the errors on the validation part: a tenth of
# the training file, here 8 pairs, so the curve is rough.

import json

from matplotlib.figure import Figure

epochs = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
curve = Figure(figsize=(7, 3), layout="constrained")
left, right = curve.subplots(1, 2)
left.plot([epoch["train/loss"] for epoch in epochs], color="#e6007e")
left.set(xlabel="epoch", ylabel="loss", title="Training")
right.plot([epoch["validation/place_mean_m"] for epoch in epochs], color="#e6007e")
right.set(xlabel="epoch", ylabel="mean distance, m", title="Validation", ylim=0)

# %%
# Evaluation
# ----------
#
# The test part holds 80 other panoramas of the same city, each with its tile. Their headings are
# drawn from the run's seed and written down with the results. The learning rate has gone down to
# almost nothing in the last epoch, so its weights are evaluated, not those of the best of 8 pairs.

from slicematch import evaluate

evaluation, folder = evaluate(run, checkpoint="last", workers=0, overwrite=True)
print(evaluation.report())

# %%
# How to read it:
#
# - **Mean and median differ a lot.** Most answers are within a few metres; some are on another
#   street, or turned by a half or a quarter, and these make the mean. Report both.
# - **The oracle** is the error that would remain if the nearest candidate were always chosen. An
#   answer on the grid cannot be better than that. This one may be, because it is refined
#   (``refine="mean"``, the default); figures of the paper are to be compared with
#   ``refine="none"``.
# - **Lateral and longitudinal** are across and along the true heading: not north and east.
# - **Recalls** count errors strictly below the threshold.
# - **Calibration** says what the probabilities are worth: of answers that promise 70 %, 70 %
#   should be within reach (a tenth of the tile's side and 30 degrees). Training fitted their
#   temperature to the best checkpoint, hence the remark; ``slicemask calibrate RUN --checkpoint
#   last`` fits it to this one.
#
# These are errors in the city that it was trained in. What an unseen city costs is on
# :doc:`/results`.
#
# The folder also holds pictures of the best, the median and the worst case: the heat map of scores
# over the tile, the estimate in magenta, the truth in green, and below the panorama in its slices,
# whose centre column looks where the arrow points.

from PIL import Image

median = Image.open(folder / "median.png")
worst = Image.open(folder / "worst.png")

# %%
# One image
# ---------
#
# A :class:`~slicematch.Localizer` answers for single images; a tile is encoded once, for any number
# of them.

from slicematch import Localizer

localizer = Localizer.load(run, checkpoint="last", device="cpu")
labels = Path("data/tutorial/splits__corrected/NewYork/same_area_balanced_test__corrected.txt")
panorama, satellite, *_ = labels.read_text().splitlines()[0].split(" ")
tile = localizer.encode_aerial(f"data/tutorial/NewYork/satellite/{satellite}")
estimate = localizer.localize(f"data/tutorial/NewYork/panorama/{panorama}", tile)
print(estimate)

# %%
# Panoramas are stored with north at their centre column, so the true heading of this one is 0. With
# a compass in the camera, say so: only candidates within 20 degrees of north are scored.

print(localizer.localize(f"data/tutorial/NewYork/panorama/{panorama}", tile, heading_prior=(0, 20)))
