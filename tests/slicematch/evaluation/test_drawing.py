"""Pictures of estimates."""

import io

import numpy as np
import pytest
from PIL import Image
from PIL.ImageColor import getrgb
from slicematch.evaluation.drawing import _ESTIMATE, draw_estimate

from slicemask import Frustum, PoseGrid


def picture(pose):
    grey = np.full((64, 64, 3), 128, dtype=np.uint8)
    figure = draw_estimate(grey, np.zeros((5, 5)), PoseGrid(5, 5, 4), pose, Frustum(360, 4))
    file = io.BytesIO()
    figure.savefig(file, format="png")
    return np.asarray(Image.open(file).convert("RGB")).astype(int)


def pixels_of_the_camera(pose):
    return int((np.abs(picture(pose) - getrgb(_ESTIMATE)).max(axis=2) < 8).sum())


@pytest.mark.parametrize("pose", [(0.97, 0.5, 90.0), (0.5, 0.03, 0.0), (0.02, 0.98, 225.0)])
def test_a_camera_that_looks_out_of_the_tile_has_its_arrow(pose):
    u, v, heading_deg = pose
    out, into = pixels_of_the_camera(pose), pixels_of_the_camera((u, v, heading_deg + 180.0))
    assert 0.55 * into < out < into
