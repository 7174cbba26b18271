"""Images as tensors."""

import numpy as np
import pytest
from PIL import Image
from slicematch.data.images import denormalise, normalise


def test_normalise_takes_imagenet_mean_and_deviation_out():
    image = Image.new("RGB", (2, 1), (0, 128, 255))
    pixels = normalise(image)
    assert tuple(pixels.shape) == (3, 1, 2)
    expected = [(0 - 0.485) / 0.229, (128 / 255 - 0.456) / 0.224, (1 - 0.406) / 0.225]
    assert pixels[:, 0, 1].tolist() == pytest.approx(expected, abs=1e-6)
    assert denormalise(pixels).tolist() == np.asarray(image).tolist()
