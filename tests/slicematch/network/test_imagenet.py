import json
import os
import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import pytest
import timm
import torch
from slicematch.errors import WeightsError
from slicematch.network import imagenet
from slicematch.network.encoders import Encoder
from slicematch.network.imagenet import PACKAGES, packaged_weights

installed = pytest.mark.skipif(
    not all(map(find_spec, PACKAGES.values())), reason="the extra `weights` is not installed"
)


@installed
@pytest.mark.parametrize("name", PACKAGES)
def test_packages_hold_what_the_encoder_of_their_name_was_trained_to(name):
    """Pretrained networks tell noise from nothing; a wrong order of tensors gives the same class
    for all, or numbers out of bounds."""
    state, source = packaged_weights(name)
    assert source.startswith(f"{PACKAGES[name]} ")
    model = timm.create_model(name).eval()
    model.load_state_dict(state)
    random = np.random.default_rng(0)
    images = torch.from_numpy(random.normal(0, 0.5, (4, 3, 128, 128))).float()
    # A smooth ramp between two colours is no object; stripes look like textiles.
    images[1] = torch.linspace(-1, 1, 128).expand(3, 128, 128)
    images[2] = torch.where(torch.arange(128) // 8 % 2 == 0, 1.0, -1.0).expand(3, 128, 128)
    with torch.no_grad():
        logits = model(images)
    assert logits.abs().max() < 30
    assert len(logits.argmax(dim=1).unique()) >= 3


@installed
def test_they_stand_in_where_no_hub_is_within_reach(tmp_path):
    code = (
        "import json, torch\n"
        "from slicematch.network.encoders import Encoder\n"
        "encoder = Encoder('tf_efficientnet_lite0', (64, 64))\n"
        "stem = encoder.backbone.conv_stem.weight.detach().flatten()\n"
        "print(json.dumps([encoder.weights_source, stem[:4].tolist()]))\n"
    )
    offline = {**os.environ, "HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=offline, capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    source, stem = json.loads(done.stdout)
    state, expected = packaged_weights("tf_efficientnet_lite0.in1k")
    assert source == expected
    assert stem == state["conv_stem.weight"].flatten()[:4].tolist()


@installed
def test_a_package_with_other_weights_is_refused(monkeypatch):
    monkeypatch.setitem(PACKAGES, "tf_efficientnet_lite0", PACKAGES["tf_efficientnet_lite1"])
    with pytest.raises(WeightsError, match="does not fit encoder 'tf_efficientnet_lite0'"):
        packaged_weights("tf_efficientnet_lite0")


def test_an_encoder_whose_package_is_missing_says_what_to_install(monkeypatch):
    monkeypatch.setitem(PACKAGES, "test_resnet", "package_that_nobody_has")
    monkeypatch.setattr("slicematch.network.encoders.is_hub_within_reach", lambda _: False)
    with pytest.raises(WeightsError, match=r"pip install 'slicemask\[weights\]'"):
        Encoder("test_resnet", (32, 32))


def test_a_cached_file_needs_no_hub(monkeypatch, tmp_path):
    file = tmp_path / "model.safetensors"
    file.touch()
    monkeypatch.setattr("huggingface_hub.try_to_load_from_cache", lambda *_: str(file))
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    assert imagenet.is_hub_within_reach("resnet50")
