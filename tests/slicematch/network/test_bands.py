"""Ground descriptors of bands of range, against geometry and plain loops."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from slicematch.errors import ConfigError
from slicematch.network.bands import BandedGroundAggregator, RangeBands
from slicematch.network.slicematch import SliceMatch

PANORAMA = RangeBands(
    ranges_m=(4.0, 12.0, 30.0),
    camera_height_m=2.0,
    elevations_deg=(-90.0, 90.0),
    projection="equirectangular",
)


def ranges_seen(bands, rows, samples=2000):
    """The bands that finely sampled elevations of each row see: fractions [B, H], by counting."""
    found = np.zeros((bands.bands, rows))
    low, high = (math.radians(angle) for angle in bands.elevations_deg)
    for row in range(rows):
        heights = 1 - (row + (np.arange(samples) + 0.5) / samples) / rows
        if bands.projection == "pinhole":
            slopes = math.tan(low) + (math.tan(high) - math.tan(low)) * heights
        else:
            slopes = np.tan(low + (high - low) * heights)
        ground = np.where(slopes < 0, bands.camera_height_m / np.maximum(-slopes, 1e-12), np.inf)
        numbers = np.searchsorted(bands.ranges_m, ground, side="right")
        found[:, row] = np.bincount(numbers, minlength=bands.bands) / samples
    return found


@pytest.mark.parametrize(
    "bands",
    [
        PANORAMA,
        replace(PANORAMA, elevations_deg=(-45.0, 45.0)),
        replace(PANORAMA, elevations_deg=(-45.0, 10.0), projection="pinhole"),
        replace(PANORAMA, elevations_deg=(5.0, 30.0)),  # no ground in sight
        replace(PANORAMA, ranges_m=()),
    ],
)
@pytest.mark.parametrize("rows", [1, 7, 20])
def test_rows_see_the_ground_in_range(bands, rows):
    fractions = bands.fractions(rows).numpy()
    np.testing.assert_allclose(fractions, ranges_seen(bands, rows), atol=1e-3)
    np.testing.assert_allclose(fractions.sum(axis=0), 1.0, rtol=0, atol=1e-12)


def test_a_camera_twice_as_high_sees_as_much_twice_as_far():
    twice = replace(PANORAMA, camera_height_m=4.0, ranges_m=(8.0, 24.0, 60.0))
    torch.testing.assert_close(twice.fractions(20), PANORAMA.fractions(20))


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def loops(module, z, slices, bands):
    """The descriptors of one image, z [C, H, W] with N dividing W: [N * B, C]."""
    _, height, width = z.shape
    first, second = module.attention.first, module.attention.second
    weights = [x.detach().numpy() for x in (first.weight, first.bias, second.weight, second.bias)]

    def logits(seen):
        hidden = np.maximum(weights[0][:, :, 0, 0] @ seen + weights[1], 0)
        return weights[2][:, :, 0, 0] @ hidden + weights[3]

    maps = np.zeros((bands.bands, height, width))
    fractions = ranges_seen(bands, height) if bands.rows == "geometry" else None
    low, high = bands.elevations_deg
    for i in range(height):
        elevation = math.radians(low + (high - low) * (height - i - 0.5) / height)
        waves = [f(k * elevation) for f in (math.sin, math.cos) for k in (1, 2, 4, 8)]
        for j in range(width):
            if bands.rows == "geometry":
                maps[:, i, j] = sigmoid(logits(z[:, i, j])[0]) * module.fractions[:, i].numpy()
                assert np.abs(module.fractions[:, i].numpy() - fractions[:, i]).max() < 1e-3
            else:
                prior = module.row_prior[:, i].detach().numpy()
                maps[:, i, j] = sigmoid(logits(np.append(z[:, i, j], waves)) + prior)
    found = []
    for n in range(slices):
        columns = slice(n * width // slices, (n + 1) * width // slices)
        for b in range(bands.bands):
            mean = (maps[b, :, columns] * z[:, :, columns]).mean(axis=(1, 2))
            if bands.value_maps:
                mean = module.values[b].detach().numpy() @ mean
            d = mean / np.sqrt((mean**2).sum() + 1e-8)
            if bands.weights:
                direction = module.weight_directions[b].detach().numpy()
                d = d * np.exp(direction @ d + module.weight_offsets[b].item())
            found.append(d)
    return np.array(found)


@pytest.mark.parametrize("rows", ["geometry", "learned"])
@pytest.mark.parametrize("extras", [True, False], ids=["values and weights", "neither"])
def test_descriptors_read_like_their_definition(rows, extras):
    torch.manual_seed(0)
    bands = replace(PANORAMA, rows=rows, value_maps=extras, weights=extras)
    module = BandedGroundAggregator(6, 4, 10, bands).double()
    with torch.no_grad():
        for parameter in module.parameters():  # away from the identity and the weight of 1
            parameter.add_(0.1 * torch.randn_like(parameter))
    z = torch.randn(2, 6, 10, 8, dtype=torch.float64)
    found = module(z).detach().numpy()
    assert found.shape == (2, 16, 6)
    for b in range(2):
        expected = loops(module, z[b].numpy(), 4, bands)
        np.testing.assert_allclose(found[b], expected, rtol=0, atol=1e-6)


def test_at_first_value_maps_and_weights_change_nothing():
    torch.manual_seed(0)
    whole = BandedGroundAggregator(6, 4, 10, PANORAMA)
    plain = BandedGroundAggregator(6, 4, 10, replace(PANORAMA, value_maps=False, weights=False))
    plain.load_state_dict(whole.state_dict(), strict=False)
    z = torch.randn(2, 6, 10, 7)  # 4 slices do not divide 7 columns
    torch.testing.assert_close(whole(z), plain(z))
    torch.testing.assert_close(whole(z).norm(dim=-1), torch.ones(2, 16), atol=1e-3, rtol=0)


@pytest.mark.parametrize("rows", ["geometry", "learned"])
def test_gradients(rows):
    module = BandedGroundAggregator(3, 2, 4, replace(PANORAMA, rows=rows)).double()
    z = torch.randn(1, 3, 4, 4, dtype=torch.float64, requires_grad=True)
    parameters = tuple(module.parameters())
    assert torch.autograd.gradcheck(lambda z, *_: module(z), (z, *parameters), fast_mode=True)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"ranges_m": (4.0, 4.0)}, "increasing distances"),
        ({"ranges_m": (-1.0,)}, "increasing distances"),
        ({"ranges_m": (float("nan"),)}, "increasing distances"),
        ({"camera_height_m": 0.0}, "camera_height_m is 0.0"),
        ({"elevations_deg": (10.0, -10.0)}, "elevations are"),
        ({"elevations_deg": (-100.0, 10.0)}, "elevations are"),
        ({"rows": "guessed"}, "band_rows is 'guessed'"),
    ],
)
def test_bands_that_are_invalid(changes, said):
    with pytest.raises(ConfigError, match=said):
        replace(PANORAMA, **changes)


@pytest.mark.parametrize("cross_view", [True, False])
def test_a_network_with_bands(cross_view):
    model = SliceMatch(
        "test_resnet", "none", (64, 128), 64, slices=4, cross_view_attention=cross_view,
        bands=PANORAMA,
    )  # fmt: skip
    ground = model.encode_ground(torch.randn(2, 3, 64, 128))
    assert ground.shape == (2, 16, model.channels)
    attention = model.attend(model.encode_aerial(torch.randn(2, 3, 64, 64)), ground)
    assert attention.shape == (2, 16 if cross_view else 1, 4, 4)
