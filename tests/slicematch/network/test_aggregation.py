"""Equations 2 to 4 against plain loops that read like the paper, and their gradients."""

import numpy as np
import pytest
import torch
from slicematch.network.aggregation import (
    AerialAttention,
    GroundAggregator,
    aerial_descriptors,
    unit,
)

from slicemask import Frustum, slice_masks

torch.manual_seed(0)


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def norm(x):
    return x / np.sqrt(np.sum(x**2) + 1e-8)


def conv1x1_twice(attention, x):
    """Both 1x1 convolutions at one cell: x is the cell's vector of channels."""
    first, second = attention.first, attention.second
    hidden = first.weight.detach().numpy()[:, :, 0, 0] @ x + first.bias.detach().numpy()
    hidden = np.maximum(hidden, 0)
    return second.weight.detach().numpy()[0, :, 0, 0] @ hidden + second.bias.detach().numpy()[0]


def loops_ground(aggregator, z, slices):
    """Eq. 2 and the ground descriptors of one image, z [C, H, W] with N dividing W."""
    channels, height, width = z.shape
    attended = np.zeros_like(z)
    for i in range(height):
        for j in range(width):
            mask = sigmoid(conv1x1_twice(aggregator.attention, z[:, i, j]))
            attended[:, i, j] = mask * z[:, i, j]
    descriptors = []
    for n in range(slices):
        total = np.zeros(channels)
        for i in range(height):
            for j in range(n * width // slices, (n + 1) * width // slices):
                total += attended[:, i, j]
        descriptors.append(norm(total / (height * width / slices)))
    return np.array(descriptors)


def loops_attention(module, z, ground):
    """Eq. 3 of one pair: z [C, L, L], ground [N, C]."""
    _, size, _ = z.shape
    attention = np.zeros((len(ground), size, size))
    for n in range(len(ground)):
        for i in range(size):
            for j in range(size):
                similarity = norm(z[:, i, j]) @ norm(ground[n])
                seen = np.append(z[:, i, j], similarity) if module.cross_view else z[:, i, j]
                attention[n, i, j] = sigmoid(conv1x1_twice(module.attention, seen))
    return attention


def loops_descriptors(z, attention, masks):
    """Eq. 4 of one pair: masks [K, N, L, L]."""
    channels, size, _ = z.shape
    poses, slices = masks.shape[:2]
    descriptors = np.zeros((poses, slices, channels))
    for k in range(poses):
        for n in range(slices):
            total, area = np.zeros(channels), 0.0
            for i in range(size):
                for j in range(size):
                    total += masks[k, n, i, j] * attention[n, i, j] * z[:, i, j]
                    area += masks[k, n, i, j]
            descriptors[k, n] = norm(total / area) if area > 0 else 0.0
    return descriptors


@pytest.fixture
def pair():
    """Random features in float64: ground [2, C, H, W], aerial [2, C, L, L]."""
    generator = torch.Generator().manual_seed(1)
    ground = torch.randn(2, 6, 3, 12, generator=generator, dtype=torch.float64)
    aerial = torch.randn(2, 6, 5, 5, generator=generator, dtype=torch.float64)
    return ground, aerial


@pytest.mark.parametrize("slices", [1, 3, 4, 12])
def test_ground_descriptors_read_like_equation_2(pair, slices):
    aggregator = GroundAggregator(6, slices).double()
    found = aggregator(pair[0]).detach().numpy()
    assert found.shape == (2, slices, 6)
    for b in range(2):
        expected = loops_ground(aggregator, pair[0][b].numpy(), slices)
        np.testing.assert_allclose(found[b], expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("slices", [5, 7, 16])
def test_any_number_of_slices_interpolates_along_the_width(slices):
    # A ramp along the width stays a ramp, so the slices' means stay in order.
    aggregator = GroundAggregator(2, slices).double()
    torch.nn.init.zeros_(aggregator.attention.second.weight)  # the same mask in every cell
    ramp = torch.ones(1, 2, 3, 12, dtype=torch.float64)
    ramp[:, 1] = torch.arange(12, dtype=torch.float64)
    found = aggregator(ramp)[0].detach()
    slope = (found[:, 1] / found[:, 0]).numpy()  # each slice's mean place in the ramp
    assert len(slope) == slices
    assert (np.diff(slope) > 0).all()
    centres = (np.arange(slices) + 0.5) * 12 / slices - 0.5
    # Interpolation holds the end values beyond the outermost cells' centres.
    np.testing.assert_allclose(slope[1:-1], centres[1:-1], atol=0.1)


@pytest.mark.parametrize("cross_view", [True, False])
def test_attention_reads_like_equation_3(pair, cross_view):
    module = AerialAttention(6, cross_view).double()
    ground = unit(torch.randn(2, 4, 6, dtype=torch.float64))
    found = module(pair[1], ground).detach().numpy()
    assert found.shape == (2, 4 if cross_view else 1, 5, 5)  # one map is shared by all
    for b in range(2):
        expected = loops_attention(module, pair[1][b].numpy(), ground[b].numpy())
        shown = np.broadcast_to(found[b], expected.shape)
        np.testing.assert_allclose(shown, expected, rtol=0, atol=1e-12)
    assert cross_view == bool(np.ptp(found, axis=1).max() > 1e-6)


@pytest.mark.parametrize("cross_view", [True, False])
def test_mixed_precision_ends_at_the_encoders(pair, cross_view):
    ground, aerial = (features.float() for features in pair)
    aggregator, attention = GroundAggregator(6, 5), AerialAttention(6, cross_view)
    descriptors = aggregator(ground)
    expected = descriptors, attention(aerial, descriptors)
    with torch.autocast("cpu", torch.bfloat16):
        descriptors = aggregator(ground)
        found = descriptors, attention(aerial, descriptors)
    for one, other in zip(found, expected, strict=True):
        assert one.dtype == torch.float32
        assert torch.equal(one, other)


def test_aerial_descriptors_read_like_equation_4(pair):
    frustum = Frustum(hfov_deg=90, slices=4)
    # The second camera stands in the south-east corner and looks away from the tile.
    poses = [[0.3, 0.6, 20.0], [1.0, 1.0, 135.0], [0.5, 0.5, 301.0]]
    masks = slice_masks(poses, frustum, 5)
    attention = torch.rand(2, 4, 5, 5, dtype=torch.float64)
    stacked = torch.from_numpy(masks).expand(2, -1, -1, -1, -1)
    found = aerial_descriptors(pair[1], attention, stacked).numpy()
    for b in range(2):
        expected = loops_descriptors(pair[1][b].numpy(), attention[b].numpy(), masks)
        np.testing.assert_allclose(found[b], expected, rtol=0, atol=1e-12)
    assert (found[:, 1] == 0).all()


def test_gradients_of_the_aggregation(pair):
    slices = 4
    ground_aggregator = GroundAggregator(6, slices).double()
    attention_module = AerialAttention(6).double()
    masks = torch.rand(2, 3, slices, 5, 5, dtype=torch.float64)

    def path(ground_features, aerial_features, masks):
        ground = ground_aggregator(ground_features)
        attention = attention_module(aerial_features, ground)
        return aerial_descriptors(aerial_features, attention, masks)

    inputs = tuple(x.clone().requires_grad_() for x in (*pair, masks))
    assert torch.autograd.gradcheck(path, inputs, fast_mode=True)


def test_empty_slices_are_zero_in_values_and_gradients(pair):
    features = pair[1].clone().requires_grad_()
    attention = torch.rand(2, 4, 5, 5, dtype=torch.float64, requires_grad=True)
    masks = torch.rand(2, 3, 4, 5, 5, dtype=torch.float64)
    masks[:, 1, 2] = 0.0
    masks.requires_grad_()
    descriptors = aerial_descriptors(features, attention, masks)
    assert (descriptors[:, 1, 2] == 0).all()
    descriptors[:, 1, 2].sum().backward(retain_graph=True)
    assert all((x.grad == 0).all() for x in (features, attention, masks))
    descriptors.sum().backward()
    assert all(torch.isfinite(x.grad).all() for x in (features, attention, masks))
    assert features.grad.abs().max() > 0


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32, torch.float64])
def test_unit_vectors_have_finite_gradients_down_to_the_shortest_vectors(dtype):
    # From vectors far longer than any feature to the denormals of each type, and zero.
    info = torch.finfo(dtype)
    longest = min(np.log2(info.max), 60.0)
    exponents = np.arange(np.log2(info.smallest_normal) - 10, longest, 1.0)
    lengths = torch.tensor([0.0, *2.0**exponents]).to(dtype)
    directions = torch.tensor([[0.6, -0.8, 0.0], [1.0, 0.0, 0.0], [0.5, 0.5, 0.5]]).to(dtype)
    vectors = (lengths[:, None, None] * directions).requires_grad_()
    units = unit(vectors)
    assert units.dtype == dtype
    (gradient,) = torch.autograd.grad(units, vectors, torch.randn(units.shape).to(dtype))
    for found in (units, gradient):
        assert torch.isfinite(found).all()
    assert (units[0] == 0).all()
    assert (gradient[0] == 0).all()


def test_unit_vectors_are_unit_vectors():
    vectors = torch.tensor([[0.0, 0.0], [3.0, 4.0]], requires_grad=True)
    units = unit(vectors)
    units[:, 0].sum().backward()
    torch.testing.assert_close(units.detach(), torch.tensor([[0.0, 0.0], [0.6, 0.8]]))
    torch.testing.assert_close(vectors.grad, torch.tensor([[0.0, 0.0], [0.128, -0.096]]))


@pytest.mark.parametrize("area", [1e-3, 1e-10, 1e-25])
def test_a_sliver_has_the_descriptor_of_its_mean(area):
    """However little of a cell a mask covers; trainings with such masks ended in NaN."""
    random = torch.Generator().manual_seed(0)
    features = torch.randn(1, 6, 2, 2, generator=random).requires_grad_()
    masks = torch.zeros(1, 1, 1, 2, 2)
    masks[..., 0, 1] = area
    # Attention near nothing would be lost to the epsilon of the mean.
    attention = (0.5 + torch.rand(1, 1, 2, 2, generator=random)).requires_grad_()
    descriptors = aerial_descriptors(features, attention, masks)
    if area > 1e-12:  # what is smaller counts as less and less
        torch.testing.assert_close(descriptors[0, 0, 0], unit(features[0, :, 0, 1]))
    gradients = torch.autograd.grad(descriptors.sum(), (features, attention))
    assert all(torch.isfinite(gradient).all() for gradient in gradients)
