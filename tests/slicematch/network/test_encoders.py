"""Encoders from timm: stages, weights, and what is said when they cannot be had."""

import os
import subprocess
import sys

import pytest
import torch
from safetensors.torch import load_file, save_file
from slicematch.errors import ConfigError, WeightsError
from slicematch.network.encoders import Encoder, encoder_normalisation
from slicematch.network.slicematch import SliceMatch

import timm  # isort: skip  after the model's modules


@pytest.mark.parametrize(
    ("name", "channels"),
    [
        ("vgg16", 512),
        ("resnet50", 1024),
        ("test_convnext", 48),
        ("test_vit", 64),  # built for one image size
        ("swin_tiny_patch4_window7_224", 384),  # gives [B, H, W, C]
    ],
)
def test_encoders_give_a_map_of_stride_16(name, channels):
    encoder = Encoder(name, (64, 128), stride=16, weights="none").eval()
    assert (encoder.channels, encoder.feature_size) == (channels, (4, 8))
    with torch.no_grad():
        assert encoder(torch.zeros(2, 3, 64, 128)).shape == (2, channels, 4, 8)


def test_vgg16_ends_before_its_last_pooling():
    encoder = Encoder("vgg16", (32, 32), weights="none")
    kinds = [type(layer).__name__ for layer in encoder.backbone.children()]
    assert kinds.count("MaxPool2d") == 4
    assert kinds[-1] == "ReLU"
    assert kinds.count("Conv2d") == 13


@pytest.mark.parametrize("stride", [4, 8, 32])
def test_any_stride_of_the_encoder(stride):
    encoder = Encoder("test_resnet", (64, 128), stride=stride, weights="none")
    assert encoder.feature_size == (64 // stride, 128 // stride)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"name": "vgg61"}, "'vgg61' is no timm model"),
        ({"name": "hf-hub:someone/something"}, "'hf-hub:someone/something' is no timm model"),
        ({"name": "resnet10t", "stride": 6}, "no stage of stride 6; it has 2, 4, 8, 16, 32"),
        ({"name": "test_vit", "image_size": (20, 20)}, "20x20 pixels"),
        ({"name": "maxvit_tiny_rw_224", "image_size": (16, 16)}, "16x16 pixels"),
        ({"name": "hrnet_w18_small", "image_size": (20, 20)}, "try sides that are multiples of 32"),
    ],
)
def test_encoders_that_cannot_be(settings, said):
    with pytest.raises(ConfigError, match=said):
        Encoder(**{"image_size": (64, 64), "weights": "none", **settings})


@pytest.mark.parametrize(
    ("name", "smallest_batch"),
    [("vgg16", 1), ("vgg16_bn", 2), ("resnet50", 2), ("densenet121", 2), ("test_vit", 1)],
)
def test_images_of_one_cell(name, smallest_batch):
    encoder = Encoder(name, (16, 16), stride=16, weights="none")
    assert encoder.feature_size == (1, 1)
    assert encoder.stages.smallest_batch == smallest_batch
    with torch.no_grad():
        assert encoder.eval()(torch.zeros(1, 3, 16, 16)).shape[2:] == (1, 1)
        assert encoder.train()(torch.zeros(smallest_batch, 3, 16, 16)).shape[2:] == (1, 1)
    if smallest_batch > 1:
        with pytest.raises(ValueError, match="more than 1 value per channel"):
            encoder(torch.zeros(1, 3, 16, 16))


@pytest.mark.parametrize(
    ("name", "mean"),
    [
        ("vgg16", (0.485, 0.456, 0.406)),
        ("resnet50.tv_in1k", (0.485, 0.456, 0.406)),
        ("tf_efficientnet_lite0", (0.5, 0.5, 0.5)),
        ("vit_base_patch16_clip_224", (0.48145466, 0.4578275, 0.40821073)),
    ],
)
def test_each_encoder_has_its_own_mean(name, mean):
    assert encoder_normalisation(name)[0] == mean
    known = timm.data.resolve_data_config(timm.get_pretrained_cfg(name).to_dict())
    assert encoder_normalisation(name) == (known["mean"], known["std"])


def test_random_weights_come_from_nowhere():
    assert Encoder("test_resnet", (32, 32), weights="none").weights_source is None


@pytest.mark.parametrize(
    ("name", "source"),
    [
        ("test_resnet", "test_resnet.r160_in1k"),
        ("resnet50", "resnet50.a1_in1k"),
        ("resnet50.tv_in1k", "resnet50.tv_in1k"),
    ],
)
def test_pretrained_weights_are_named_with_their_tag(monkeypatch, tmp_path, name, source):
    """A cached file stands in for the model hub's."""
    file = tmp_path / "model.safetensors"
    save_file(timm.create_model(name).state_dict(), file)
    monkeypatch.setattr(
        "timm.models._builder.load_state_dict_from_hf", lambda *_, **__: load_file(file)
    )
    monkeypatch.setattr("slicematch.network.encoders.is_hub_within_reach", lambda _: True)
    assert Encoder(name, (32, 32)).weights_source == source


@pytest.mark.parametrize("suffix", [".safetensors", ".pth"])
def test_weights_from_a_file(tmp_path, suffix):
    source = timm.create_model("test_resnet", pretrained=False)
    path = tmp_path / f"weights{suffix}"
    if suffix == ".pth":
        torch.save(source.state_dict(), path)
    else:
        save_file(source.state_dict(), path)
    encoder = Encoder("test_resnet", (64, 64), weights=path)
    torch.testing.assert_close(encoder.backbone.conv1[0].weight, source.conv1[0].weight)
    with torch.no_grad():
        images = torch.randn(1, 3, 64, 64)
        stages = source.eval().forward_intermediates(images, intermediates_only=True)
        torch.testing.assert_close(encoder.eval()(images), stages[3])


def test_weights_of_another_encoder(tmp_path):
    path = tmp_path / "weights.safetensors"
    save_file(timm.create_model("test_convnext").state_dict(), path)
    with pytest.raises(WeightsError, match=r"does not fit encoder 'test_resnet'"):
        Encoder("test_resnet", (64, 64), weights=path)


@pytest.mark.parametrize("content", [b"", b"not weights", b"\x80\x04\x95"])
@pytest.mark.parametrize("name", ["weights.pth", "weights.safetensors"])
def test_files_that_are_no_weights(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(WeightsError, match=name):
        Encoder("test_resnet", (64, 64), weights=path)


def test_a_missing_file(tmp_path):
    with pytest.raises(WeightsError, match=r"nowhere.pth: there is no such file"):
        Encoder("test_resnet", (64, 64), weights=tmp_path / "nowhere.pth")


def test_weights_are_read_without_running_what_they_hold(tmp_path):
    class Trap:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "sprung"),)

    torch.save({"conv1.weight": Trap()}, tmp_path / "weights.pth")
    with pytest.raises(WeightsError, match=r"weights.pth"):
        Encoder("test_resnet", (64, 64), weights=tmp_path / "weights.pth")
    assert not (tmp_path / "sprung").exists()


def test_without_a_model_hub_it_says_what_to_do(tmp_path):
    code = (
        "from slicematch.network.encoders import Encoder\n"
        "from slicematch.errors import WeightsError\n"
        "try:\n"
        "    Encoder('vgg16', (32, 32))\n"
        "except WeightsError as error:\n"
        "    print(error)\n"
    )
    offline = {**os.environ, "HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=offline, capture_output=True, text=True, check=True
    )
    assert "are not available from the model hub" in done.stdout
    assert "'none'" in done.stdout
    assert len(done.stdout.splitlines()) == 1


def test_a_pyramid_brings_deep_stages_to_a_shallow_one():
    encoder = Encoder("test_resnet", (64, 128), stride=8, weights="none", pyramid=24).eval()
    assert (encoder.channels, encoder.feature_size) == (24, (8, 16))
    images = torch.randn(1, 3, 64, 128, requires_grad=True)
    features = encoder(images)
    assert features.shape == (1, 24, 8, 16)
    features[0, :, 0, 0].sum().backward()
    # One stage of stride 8 sees a few cells; those of stride 32 and more see the whole image.
    assert (images.grad[..., 32:, 64:] != 0).any()


@pytest.mark.parametrize("name", ["swin_tiny_patch4_window7_224", "vgg16"])
def test_a_pyramid_over_other_backbones(name):
    encoder = Encoder(name, (64, 64), stride=16, weights="none", pyramid=8).eval()
    with torch.no_grad():
        assert encoder(torch.randn(1, 3, 64, 64)).shape == (1, 8, 4, 4)


def test_ground_and_aerial_weights_are_not_shared():
    model = SliceMatch("test_resnet", "none", (64, 128), 64, slices=4)
    ground = {id(p) for p in model.ground_encoder.parameters()}
    assert ground.isdisjoint({id(p) for p in model.aerial_encoder.parameters()})


@pytest.mark.parametrize("name", ["tf_efficientnet_lite0", "mobilenetv3_small_050"])
def test_blocks_that_no_feature_needs_are_cut(name):
    """Cut or not, features are the same, and all that is left takes part."""
    torch.manual_seed(0)
    encoder = Encoder(name, (64, 64), stride=8, weights="none").eval()
    torch.manual_seed(0)
    whole = timm.create_model(name, features_only=True).eval()
    assert len(encoder.backbone.blocks) < len(whole.blocks)
    images = torch.randn(1, 3, 64, 64)
    stage = whole.feature_info.reduction().index(8)
    state = {key: whole.state_dict()[key] for key in encoder.backbone.state_dict()}
    encoder.backbone.load_state_dict(state)
    torch.testing.assert_close(encoder(images), whole(images)[stage])
    encoder.train()(images.repeat(2, 1, 1, 1)).sum().backward()
    assert all(parameter.grad is not None for parameter in encoder.parameters())
