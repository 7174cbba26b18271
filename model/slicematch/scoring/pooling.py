"""Pooling of one pair's aerial features under the masks of candidates, by slice number.

For each mask and slice number n that candidates combine, a *share* is wanted: the dot product of
the unit slice descriptor d_a with d_g^n, and whether there is a descriptor at all. It is computed
once, however many poses have that mask as slice n. There are two ways to pool, both plain sums:

- A mask that many slice numbers use (in a panorama, each heading shifts the slices) has its
  cells' features gathered once, for one product with the weights P * M^n of all n.
- A mask that few use is pooled for each of those n alone, straight from the feature map.

On a GPU a kernel does either (`pooling_triton.py`), where no gradients are asked for.

Dot products need no pooling: d_g^n . sum P z' is a weighted sum of scalars. The descriptor's
length does; a Gram matrix of the cells would give it with fewer operations, but where features
cancel it loses twice the digits.
"""

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.util import find_spec

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812
from torch.utils.checkpoint import checkpoint

log = logging.getLogger(__name__)

Masks = tuple[Tensor, Tensor, Tensor]  # CSR: row starts, flat cells, fractions

# Masks gathered in one product are padded to a common multiple of so many cells.
_PADDED = 8
# Values in one block: what a CPU's cache holds; what may keep a GPU busy (not measured).
_VALUES_CPU, _VALUES_GPU = 1 << 20, 1 << 24
# For more slices the kernel takes more shared memory than most GPUs have.
_KERNEL_SLICES = 1024
# Values that a pair may keep for the gradients. Where there are more, its blocks are pooled again.
_VALUES_KEPT = 1 << 23


@dataclass(frozen=True)
class PoolingPlan:
    """The part of the work that depends on the candidates alone; made by `plan_pooling`.

    Attributes
    ----------
    masks : CSR rows
        The M distinct masks.
    many : int64 [R]
        The masks pooled for all slice numbers at once, by their count of cells.
    widths : list of (int, int)
        To how many cells they are padded, and how many in turn are padded to as many.
    single : list of (int64 [R_n], NumPy integers [R_n + 1])
        For each slice number, the masks pooled for it alone, and how many nonzeros come before
        each of them, and in all: in NumPy, so that to cut blocks asks a GPU for nothing.
    slot : int [K, N]
        Which share is that of slice n of pose k. Shares stand in order: those of the gathered
        masks, N each, then those of single masks by slice number.
    """

    masks: Masks
    many: Tensor
    widths: list[tuple[int, int]]
    single: list[tuple[Tensor, np.ndarray]]
    slot: Tensor

    @cached_property
    def gathered(self) -> list[tuple[Tensor, Tensor]]:
        """Padded cells and fractions of `many`, integer and float32 [R, m], for each width."""
        starts, cells, fractions = self.masks
        parts = []
        counts = [count for _, count in self.widths]
        for (width, _), rows in zip(self.widths, self.many.split(counts), strict=True):
            first = starts[rows, None]
            steps = torch.arange(width, dtype=starts.dtype, device=starts.device)
            inside = steps < starts[rows + 1, None] - first
            at = torch.where(inside, first + steps, 0)
            parts.append((cells[at] * inside, fractions[at] * inside))
        return parts

    @property
    def shares(self) -> int:
        """How many shares there are."""
        return len(self.many) * self.slot.shape[1] + sum(len(rows) for rows, _ in self.single)

    @property
    def vectors(self) -> int:
        """How many vectors of C channels pooling goes through: gathered cells and descriptors."""
        return sum(width * count for width, count in self.widths) + self.shares


def plan_pooling(index: Tensor, masks: Masks) -> PoolingPlan:
    """Choose how each mask is pooled.

    Parameters
    ----------
    index : int64 [K, N]
        The mask that is slice n of pose k.
    masks : CSR rows
        The M distinct masks.
    """
    starts = masks[0]
    slices = index.shape[1]
    lengths = starts[1:] - starts[:-1]
    used = torch.zeros(slices, len(lengths), dtype=torch.bool, device=index.device)
    for n in range(slices):
        used[n].index_fill_(0, index[:, n], True)
    # Gathering once and multiplying for all N breaks even at about this many uses (measured on a
    # CPU with C = 512).
    many = (5 * used.sum(dim=0) > 2 * slices + 16) & (lengths > 0)

    padded = -(-lengths // _PADDED) * _PADDED
    numbers = torch.nonzero(many)[:, 0]
    numbers = numbers[torch.argsort(padded[numbers], stable=True)]
    runs = torch.unique_consecutive(padded[numbers], return_counts=True)
    widths = list(zip(*(run.tolist() for run in runs), strict=True))

    alone = [torch.nonzero(used[n] & ~many)[:, 0] for n in range(slices)]
    single = [(rows, _sums(lengths[rows]).numpy(force=True)) for rows in alone]
    total = len(numbers) * slices + sum(map(len, alone))
    slot = torch.empty_like(index, dtype=torch.int32 if total < 2**31 else torch.int64)
    place = torch.empty_like(lengths, dtype=slot.dtype)
    first = len(numbers) * slices
    for n, rows in enumerate(alone):
        place[numbers] = torch.arange(
            n, len(numbers) * slices + n, slices, dtype=slot.dtype, device=slot.device
        )
        place[rows] = torch.arange(first, first + len(rows), dtype=slot.dtype, device=slot.device)
        slot[:, n] = place[index[:, n]]
        first += len(rows)
    return PoolingPlan(masks, numbers, widths, single, slot)


def pool_shares(
    plan: PoolingPlan,
    ground: Tensor,
    features: Tensor,
    attention: Tensor,
    values_at_once: int | None = None,
) -> Tensor:
    """Shares of one pair; differentiable in the last three tensors.

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
    shares : float [shares, 2]
        d_g^n . d_a, and 1 where d_a is not zero; ordered as `PoolingPlan.slot` says.
    """
    dots = attention * (features @ ground.T)  # z'_a^n . d_g^n of each cell
    if values_at_once is None:
        if not dots.requires_grad and _has_kernel(features, dots.shape[1]):
            from slicematch.scoring.pooling_triton import pool_shares_fused

            return pool_shares_fused(plan, features, attention, dots)
        values_at_once = _VALUES_CPU if features.device.type == "cpu" else _VALUES_GPU
    vectors = values_at_once // features.shape[1]
    blocks = _pool_blocks(plan, features, attention, dots, vectors)
    if dots.requires_grad:
        return torch.cat(list(blocks))
    # Small results kept between large blocks would leave holes in memory that none fits in.
    shares = features.new_empty(plan.shares, 2)
    first = 0
    for block in blocks:
        shares[first : first + len(block)] = block
        first += len(block)
    return shares


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
        from slicematch.scoring.pooling_triton import pool_shares_fused

        pool_shares_fused(plan, ones, ones, ones)
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
    """The shares of `pool_shares`, in blocks of so many vectors of C channels."""
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
            rows = _take_rows(plan.masks, numbers[first:last], int(sums[last] - sums[first]))
            yield call(_pool_single, *rows, attended, dots_n)


def _take_rows(masks: Masks, chosen: Tensor, nonzeros: int) -> Masks:
    """The chosen rows [R] of a CSR matrix, which have so many nonzeros."""
    starts, cells, fractions = masks
    lengths = starts[chosen + 1] - starts[chosen]
    new_starts = _sums(lengths)
    shift = starts[chosen] - new_starts[:-1]
    shift = torch.repeat_interleave(shift, lengths, output_size=nonzeros)
    taken = torch.arange(len(shift), dtype=starts.dtype, device=shift.device) + shift
    return new_starts, cells[taken], fractions[taken]


def _sums(lengths: Tensor) -> Tensor:
    """Sum of the lengths [R] before each, and of all: [R + 1]."""
    return F.pad(torch.cumsum(lengths, 0, dtype=lengths.dtype), (1, 0))


def _cut(
    whole: tuple[Tensor, Tensor], vectors: int, slices: int
) -> Iterator[tuple[Tensor, Tensor]]:
    """Cut masks [R, m] so that neither their m features nor N descriptors exceed the vectors."""
    masks = max(1, vectors // max(whole[0].shape[1], slices))
    return zip(*(part.split(masks) for part in whole), strict=True)


def _pool_gathered(
    cells: Tensor, fractions: Tensor, features: Tensor, attention: Tensor, dots: Tensor
) -> Tensor:
    """Shares of masks [R, m] with every slice number: [R * N, 2]."""
    fractions = fractions.to(features.dtype)
    flat = cells.flatten()
    weights = fractions[..., None] * attention.index_select(0, flat).view(*cells.shape, -1)
    gathered = features.index_select(0, flat).view(*cells.shape, -1)
    lengths = torch.linalg.vector_norm(weights.mT @ gathered, dim=-1)  # [R, N]
    return _shares(_weighted_sums(dots, cells, None, fractions), lengths)


def _pool_single(
    starts: Tensor, cells: Tensor, fractions: Tensor, attended: Tensor, dots: Tensor
) -> Tensor:
    """Shares of CSR rows [R] with one slice number: [R, 2]."""
    fractions = fractions.to(attended.dtype)
    descriptors = _weighted_sums(attended, cells, starts[:-1], fractions)  # [R, C]
    lengths = torch.linalg.vector_norm(descriptors, dim=-1, keepdim=True)
    return _shares(_weighted_sums(dots, cells, starts[:-1], fractions), lengths)


def _weighted_sums(table: Tensor, rows: Tensor, starts: Tensor | None, weights: Tensor) -> Tensor:
    """Weighted sums of the table's rows: rows as [R, m], or flat with their R starts."""
    return F.embedding_bag(rows, table, starts, mode="sum", per_sample_weights=weights)


def _shares(dots: Tensor, lengths: Tensor) -> Tensor:
    some = lengths.detach() > 0
    return torch.stack([dots / torch.where(some, lengths, 1.0) * some, some], dim=-1).flatten(0, -2)


def _call(pool: Callable[..., Tensor], *arguments: Tensor) -> Tensor:
    return pool(*arguments)


def _call_again(pool: Callable[..., Tensor], *arguments: Tensor) -> Tensor:
    """Call `pool`, and again for the gradients, so that nothing large is kept between."""
    return checkpoint(pool, *arguments, use_reentrant=False, preserve_rng_state=False)
