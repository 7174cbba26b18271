"""
Your photographs on your map
============================

A folder of photographs and an orthophoto: where was each taken, and which way did it look? This
page asks the run that comes with slicemask, and checks its answers. A generated city stands in for
your own folder, since its truth is known; with yours, begin at the second step.

It needs ``slicemask[model,maps,synth]``, and takes a minute on a laptop's processor.
"""

# %%
# Photographs and a map
# ---------------------
#
# Panoramas whose EXIF data hold a position that is metres off and a compass that is degrees off, as
# a phone writes them, and one GeoTIFF of the city. As a command it is ``slicemask synth --format
# table --panoramas 24 --seed 5 --panorama-size 512x256 --tile-size 320 --out data/photographs``.

from slicemask.synth import generate_table

generate_table(
    "data/photographs", panoramas=24, seed=5, panorama_size=(512, 256), image_size=(160, 120),
    tile_size=320, jobs=1,
)  # fmt: skip

# %%
# Where they were taken
# ---------------------
#
# One call, or one command: ``slicemask locate generated-city data/photographs/panoramas --map
# data/photographs/map.tif --out answers.gpkg --picture answers.png``. Each photograph is sought
# around what its EXIF data say; the answers are a GeoPackage that QGIS opens, and a table of pandas
# here.

from slicematch import locate

located = locate(
    "generated-city", ["data/photographs/panoramas"], "data/photographs/map.tif",
    "data/photographs/answers.gpkg", overwrite=True, device="cpu",
)  # fmt: skip
print(located)
print(located.answers[["lat", "lon", "heading_deg", "probability", "ellipse_major_m"]].head())

# %%
# On the map
# ----------
#
# Arrows are headings, ellipses hold 95 % of the probability around each answer.

from slicematch.data.maps import AerialMap
from slicematch.localization.map_picture import draw_answers

figure = draw_answers(AerialMap.open("data/photographs/map.tif"), located.answers)

# %%
# How good they are
# -----------------
#
# Of your own photographs you will know the truth for a few at best; here it is in a table. The
# errors of the answers, beside those of the positions and compasses that they started from:

import numpy as np
import pandas as pd
from pyproj import Geod

answers = located.answers.set_index("ground")
truth = pd.read_csv("data/photographs/photos.csv")
truth = truth.set_index("data/photographs/" + truth["ground"]).loc[answers.index]
wgs84 = Geod(ellps="WGS84")


def place_errors(lat, lon):
    return wgs84.inv(lon, lat, truth["lon"], truth["lat"])[2]


def heading_errors(heading_deg):
    return np.abs((np.asarray(heading_deg) - truth["heading_deg"] + 180) % 360 - 180)


errors = pd.DataFrame(
    {
        "place, m": [
            np.median(place_errors(answers["prior_lat"], answers["prior_lon"])),
            np.median(place_errors(answers["lat"], answers["lon"])),
        ],
        "heading, deg": [
            np.median(heading_errors(answers["prior_heading_deg"])),
            np.median(heading_errors(answers["heading_deg"])),
        ],
    },
    index=["EXIF, median error", "located, median error"],
)
print(errors.round(2))

# %%
# What next
# ---------
#
# - :doc:`/maps`: priors, maps that GDAL reads, what all columns mean, many machines.
# - :doc:`/own-data`: a table of your photographs, cameras other than panoramas, and training on
#   them, from this run or from scratch.
# - :doc:`/drives`: photographs that follow each other.
