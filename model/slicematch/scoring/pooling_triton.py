"""Contributions to scores, each mask's by one program of a GPU (Triton).

A mask's features go from the feature map to the multiprocessor's registers, are multiplied there
with the weights of the slice numbers, and leave as two scalars a slice number: nothing is gathered
or pooled in the GPU's memory. Products are split into three of TF32, which keeps float32's digits
on tensor cores.

Triton comes with PyTorch's CUDA builds for Linux; where it is missing, importing this module fails.
"""

import torch
import triton
import triton.language as tl
from torch import Tensor

from slicematch.network.aggregation import EPSILON
from slicematch.scoring.plan import Masks, PoolingPlan

# Cells and channels of which a program holds the features at a time, and sums that it holds: what
# leaves registers for a second and a third program beside it, by the compiler's count for an H100.
_CELLS, _CHANNELS, _SUMS = 16, 256, 4096
_WARPS, _STAGES = 4, 4
# The least rows and columns that a product on tensor cores takes.
_LEAST = 16


def pool_fused(plan: PoolingPlan, features: Tensor, attention: Tensor, dots: Tensor) -> Tensor:
    """Shares of one pair, float32 [contributions, 2], as `pool_by_slice` gives them.

    Parameters
    ----------
    plan : PoolingPlan
        Of the candidates' masks.
    features : float32 [L * L, C]
        z_a; fewer than 2^31 values.
    attention : float32 [L * L, N]
        M_a^n.
    dots : float32 [L * L, N]
        z'_a^n . d_g^n of each cell.
    """
    # The kernel knows of no strides.
    features, attention, dots = (x.contiguous() for x in (features, attention, dots))
    contributions = features.new_empty(plan.contributions, 2)
    slices = dots.shape[1]
    _launch(plan.many, plan.masks, features, attention, dots, contributions, slices)
    first = len(plan.many) * slices
    for n, (rows, _) in enumerate(plan.single):
        _launch(rows, plan.masks, features, attention[:, n:], dots[:, n:], contributions[first:], 1)
        first += len(rows)
    return contributions


def _launch(
    rows: Tensor,
    masks: Masks,
    features: Tensor,
    attention: Tensor,
    dots: Tensor,
    contributions: Tensor,
    slices: int,
) -> None:
    """Fill the first contributions: of each row of the masks with so many slice numbers."""
    if not len(rows):
        return
    channels = features.shape[1]
    held_slices = 1 if slices == 1 else max(_LEAST, triton.next_power_of_2(slices))
    held_channels = min(_CHANNELS, _SUMS // held_slices, triton.next_power_of_2(channels))
    with torch.cuda.device_of(features):  # Triton launches on the current one
        _pool[(len(rows),)](
            rows,
            *masks,
            features,
            attention,
            dots,
            contributions,
            slices,
            dots.stride(0),
            channels,
            EPSILON,
            SLICES=held_slices,
            CHANNELS=max(_LEAST, held_channels),
            CELLS=_CELLS,
            num_warps=_WARPS,
            num_stages=_STAGES,
        )


@triton.jit
def _pool(  # type: ignore[no-untyped-def]
    rows,
    starts,
    cells,
    fractions,
    features,
    attention,
    dots,
    contributions,
    slices,
    stride,
    channels,
    epsilon,
    SLICES: tl.constexpr,  # noqa: N803
    CHANNELS: tl.constexpr,  # noqa: N803
    CELLS: tl.constexpr,  # noqa: N803
):
    program = tl.program_id(0).to(tl.int64)
    row = tl.load(rows + program)
    first = tl.load(starts + row)
    last = tl.load(starts + row + 1)
    n = tl.arange(0, SLICES)

    products = tl.zeros([SLICES], dtype=tl.float32)
    for start in range(first, last, CELLS):
        at = start + tl.arange(0, CELLS)
        cell = tl.load(cells + at, mask=at < last, other=0)
        fraction = tl.load(fractions + at, mask=at < last, other=0.0)
        dot = tl.load(dots + cell[:, None] * stride + n, mask=n[None, :] < slices, other=0.0)
        products += tl.sum(fraction[:, None] * dot, axis=0)

    squares = tl.zeros([SLICES], dtype=tl.float32)
    for channel in range(0, channels, CHANNELS):
        c = channel + tl.arange(0, CHANNELS)
        pooled = tl.zeros([SLICES, CHANNELS], dtype=tl.float32)
        for start in range(first, last, CELLS):
            at = start + tl.arange(0, CELLS)
            cell = tl.load(cells + at, mask=at < last, other=0)
            fraction = tl.load(fractions + at, mask=at < last, other=0.0)
            attended = attention + cell[None, :] * stride + n[:, None]
            weights = fraction * tl.load(attended, mask=n[:, None] < slices, other=0.0)
            inside = (at[:, None] < last) & (c < channels)
            values = tl.load(features + cell[:, None] * channels + c, mask=inside, other=0.0)
            if SLICES == 1:
                pooled += tl.sum(tl.trans(weights) * values, axis=0)[None, :]
            else:
                pooled = tl.dot(weights, values, pooled, input_precision="tf32x3")
        squares += tl.sum(pooled * pooled, axis=1)

    some = squares > 0
    contribution = tl.where(some, products / tl.sqrt(squares + epsilon), 0.0)
    to = contributions + (program * slices + n) * 2
    tl.store(to, contribution, mask=n < slices)
    tl.store(to + 1, some.to(tl.float32), mask=n < slices)
