"""Pooling of one pair's aerial features under the masks of candidates: contributions to scores.

Where every slice has an attention map of its own (cross-view attention), there are two ways, both
plain sums:

- A mask that many slice numbers use (in a panorama, each heading shifts the slices) has its
  cells' features gathered once, for one product with the weights P * M^n of all n.
- A mask that few use is pooled for each of those n alone, straight from the feature map.

On a GPU a kernel does either (`pooling_triton.py`), where no gradients are asked for. Where all
slices share one attention map, each mask is pooled once for all of them.

Dot products need no pooling: d_g^n . sum P z' is a weighted sum of scalars. The descriptor's
length does; a Gram matrix of the cells would give it with fewer operations, but where features
cancel it loses twice the digits.
"""

import logging
from collections.abc import Callable, Iterator
from functools import cache
from importlib.util import find_spec

import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812
from torch.utils.checkpoint import checkpoint

from slicematch.network.aggregation import EPSILON
from slicematch.scoring.plan import PoolingPlan, SharedPlan, plan_pooling, take_rows

log = logging.getLogger(__name__)

# Values in one block: what a CPU's cache holds; what may keep a GPU busy (not measured).
_VALUES_CPU, _VALUES_GPU = 1 << 20, 1 << 24
# For more slices the kernel takes more shared memory than most GPUs have.
_KERNEL_SLICES = 1024
# Values that a pair may keep for the gradients. Where there are more, its blocks are pooled again.
_VALUES_KEPT = 1 << 23


def pool_by_slice(
    plan: PoolingPlan,
    ground: Tensor,
    features: Tensor,
    attention: Tensor,
    values_at_once: int | None = None,
) -> Tensor:
    """Contributions of one pair; differentiable in the last three tensors.

    Parameters
    ----------
    plan : PoolingPlan
        Of the candidates' masks.
    ground : float [N, C]
        d_g^n.
    features : float [L * L, C]
        z_a.
    attention : float [L * L, N]
        M_a^n.
    values_at_once : int, optional
        Values in one block, which bounds the memory, of plain torch operations; by default as
        many as suit the device, or a kernel that has no blocks.

    Returns
    -------
    contributions : float [number, 2]
        d_g^n . d_a, and 1 where d_a is not zero; ordered as `PoolingPlan.slot` says.
    """
    dots = attention * (features @ ground.T)  # z'_a^n . d_g^n of each cell
    if values_at_once is None:
        if not dots.requires_grad and _has_kernel(features, dots.shape[1]):
            from slicematch.scoring.pooling_triton import pool_fused

            return pool_fused(plan, features, attention, dots)
        values_at_once = _VALUES_CPU if features.device.type == "cpu" else _VALUES_GPU
    vectors = values_at_once // features.shape[1]
    blocks = _pool_blocks(plan, features, attention, dots, vectors)
    if dots.requires_grad:
        return torch.cat(list(blocks))
    # Small results kept between large blocks would leave holes in memory that none fits in.
    contributions = features.new_empty(plan.contributions, 2)
    first = 0
    for block in blocks:
        contributions[first : first + len(block)] = block
        first += len(block)
    return contributions


def pool_shared(
    plan: SharedPlan,
    ground: Tensor,
    features: Tensor,
    attention: Tensor,
    values_at_once: int | None = None,
) -> Tensor:
    """Contributions of one pair whose slices share one attention map; as `pool_by_slice`.

    Parameters
    ----------
    plan : SharedPlan
        Of the candidates' masks.
    ground : float [N, C]
        d_g^n.
    features : float [L * L, C]
        z_a.
    attention : float [L * L, 1]
        M_a.
    values_at_once : int, optional
        Values in one block, which bounds the memory; by default as many as suit a cache.

    Returns
    -------
    contributions : float [R * N, 2]
        d_g^n . d_a, and 1 where d_a is not zero; ordered as `SharedPlan.slot` says.
    """
    attended = features * attention  # z'_a
    starts, cells, fractions = plan.masks
    fractions = fractions.to(attended.dtype)
    step = max(1, (values_at_once or _VALUES_CPU) // attended.shape[1])
    masks = len(starts) - 1
    again = (attended.requires_grad or ground.requires_grad) and (
        masks * attended.shape[1] > _VALUES_KEPT
    )
    call = _call_again if again else _call
    blocks = []
    for first in range(0, masks, step):
        bounds = starts[first : first + step + 1]
        low, high = int(bounds[0]), int(bounds[-1])
        part = (bounds[:-1] - bounds[0], cells[low:high], fractions[low:high])
        blocks.append(call(_pool_once, *part, attended, ground))
    return torch.cat(blocks)


def _pool_once(
    starts: Tensor, cells: Tensor, fractions: Tensor, attended: Tensor, ground: Tensor
) -> Tensor:
    """Contributions of CSR rows [R] with every slice number: [R * N, 2]."""
    sums = _weighted_sums(attended, cells, starts, fractions)  # [R, C]
    lengths = torch.linalg.vector_norm(sums, dim=-1, keepdim=True)
    return _contributions(sums @ ground.T, lengths)


def _has_kernel(features: Tensor, slices: int) -> bool:
    """Whether the Triton kernel takes these: float32, on a GPU of NVIDIA's that has TF32."""
    return (
        features.is_cuda
        and features.dtype == torch.float32
        and features.numel() < 2**31
        and slices <= _KERNEL_SLICES
        and torch.version.hip is None
        and torch.cuda.get_device_capability(features.device) >= (8, 0)
        and _builds(features.device)
    )


@cache
def _builds(device: torch.device) -> bool:
    """Whether Triton is here, and builds the kernel; pools two masks of one cell to see.

    One is used by a single slice number of 16, the other by all the others: both ways to pool.
    """
    if find_spec("triton") is None:
        return False
    cell = torch.ones(2, device=device)
    index = (torch.arange(16, device=device) > 0).long()[None]
    starts = torch.arange(3, dtype=torch.int32, device=device)
    plan = plan_pooling(index, (starts, torch.zeros_like(starts[1:]), cell))
    ones = torch.ones(1, 16, device=device)
    try:
        from slicematch.scoring.pooling_triton import pool_fused

        pool_fused(plan, ones, ones, ones)
    except torch.OutOfMemoryError:
        raise
    except Exception as error:  # whatever Triton, a C compiler or the assembler may raise
        log.warning(
            "scoring on %s does without its kernel, and takes longer: Triton cannot build it (%s); "
            "it needs a C compiler with Python's headers, and has to know the GPU",
            device,
            " ".join(str(error).split()),
        )
        return False
    return True


def _pool_blocks(
    plan: PoolingPlan,
    features: Tensor,
    attention: Tensor,
    dots: Tensor,
    vectors: int,
) -> Iterator[Tensor]:
    """The contributions of `pool_by_slice`, in blocks of so many vectors of C channels."""
    many = dots.requires_grad and plan.vectors * features.shape[1] > _VALUES_KEPT
    call = _call_again if many else _call
    for whole in plan.gathered:
        for cells, fractions in _cut(whole, vectors, dots.shape[1]):
            yield call(_pool_gathered, cells, fractions, features, attention, dots)
    step = max(1, vectors)
    for n, (numbers, sums) in enumerate(plan.single):
        if not len(numbers):
            continue
        attended = features * attention[:, n, None]  # z'_a^n
        dots_n = dots[:, n, None].contiguous()
        for first in range(0, len(numbers), step):
            last = min(first + step, len(numbers))
            rows = take_rows(plan.masks, numbers[first:last], int(sums[last] - sums[first]))
            yield call(_pool_single, *rows, attended, dots_n)


def _cut(
    whole: tuple[Tensor, Tensor], vectors: int, slices: int
) -> Iterator[tuple[Tensor, Tensor]]:
    """Cut masks [R, m] so that neither their m features nor N descriptors exceed the vectors."""
    masks = max(1, vectors // max(whole[0].shape[1], slices))
    return zip(*(part.split(masks) for part in whole), strict=True)


def _pool_gathered(
    cells: Tensor, fractions: Tensor, features: Tensor, attention: Tensor, dots: Tensor
) -> Tensor:
    """Contributions of masks [R, m] with every slice number: [R * N, 2]."""
    fractions = fractions.to(features.dtype)
    flat = cells.flatten()
    weights = fractions[..., None] * attention.index_select(0, flat).view(*cells.shape, -1)
    gathered = features.index_select(0, flat).view(*cells.shape, -1)
    lengths = torch.linalg.vector_norm(weights.mT @ gathered, dim=-1)  # [R, N]
    return _contributions(_weighted_sums(dots, cells, None, fractions), lengths)


def _pool_single(
    starts: Tensor, cells: Tensor, fractions: Tensor, attended: Tensor, dots: Tensor
) -> Tensor:
    """Contributions of CSR rows [R] with one slice number: [R, 2]."""
    fractions = fractions.to(attended.dtype)
    descriptors = _weighted_sums(attended, cells, starts[:-1], fractions)  # [R, C]
    lengths = torch.linalg.vector_norm(descriptors, dim=-1, keepdim=True)
    return _contributions(_weighted_sums(dots, cells, starts[:-1], fractions), lengths)


def _weighted_sums(table: Tensor, rows: Tensor, starts: Tensor | None, weights: Tensor) -> Tensor:
    """Weighted sums of the table's rows: rows as [R, m], or flat with their R starts."""
    return F.embedding_bag(rows, table, starts, mode="sum", per_sample_weights=weights)


def _contributions(dots: Tensor, lengths: Tensor) -> Tensor:
    present = lengths.detach() > 0
    units = dots * (lengths.square() + EPSILON).rsqrt() * present
    return torch.stack([units, present.expand_as(units)], dim=-1).flatten(0, -2)


def _call(pool: Callable[..., Tensor], *arguments: Tensor) -> Tensor:
    return pool(*arguments)


def _call_again(pool: Callable[..., Tensor], *arguments: Tensor) -> Tensor:
    """Call `pool`, and again for the gradients, so that nothing large is kept between."""
    return checkpoint(pool, *arguments, use_reentrant=False, preserve_rng_state=False)
