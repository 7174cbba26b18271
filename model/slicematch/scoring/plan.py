"""How the masks of candidates are pooled: the part of the work that knows no image.

A *contribution* is what one mask and one slice number add to a score: two scalars, the dot product
of the unit slice descriptor d_a with d_g^n, and whether there is a descriptor at all. It is
computed once, however many poses have that mask as slice n.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

Masks = tuple[Tensor, Tensor, Tensor]  # CSR: row starts, flat cells, fractions

# Rows worked on at once: on the way they take several times their own memory.
_ROWS = 1 << 13
# Numbers of masks that are looked up at once.
_NUMBERS = 1 << 18
# Masks gathered in one product are padded to a common multiple of so many cells.
_PADDED = 8


def as_means(masks: Masks) -> Masks:
    """CSR rows whose fractions sum to 1, on the CPU, so that pooling gives the mean of eq. 4.

    A mask may cover no more than a millionth of a cell. Its sum of features would then be too
    short for float32 to square; its mean is as long as any other.
    """
    starts, cells, fractions = masks
    ends, values = starts.numpy(), fractions.numpy()
    means = np.empty_like(values)
    for first in range(0, len(ends) - 1, _ROWS):
        some = ends[first : first + _ROWS + 1]
        part = values[some[0] : some[-1]]
        padded = np.append(part, part.dtype.type(0))  # empty rows at the end begin there
        areas = np.add.reduceat(padded, some[:-1] - some[0], dtype=np.float64)
        np.divide(
            part,
            np.repeat(areas, np.diff(some)),
            out=means[some[0] : some[-1]],
            casting="same_kind",
        )
    return starts, cells, torch.from_numpy(means)


@dataclass(frozen=True)
class PoolingPlan:
    """What to pool where every slice has an attention map of its own; made by `plan_pooling`.

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
        Which contribution is that of slice n of pose k. Contributions stand in order: those of
        the gathered masks, N each, then those of single masks by slice number.
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
    def contributions(self) -> int:
        """How many contributions there are."""
        return len(self.many) * self.slot.shape[1] + sum(len(rows) for rows, _ in self.single)

    @property
    def vectors(self) -> int:
        """How many vectors of C channels pooling goes through: gathered cells and descriptors."""
        return sum(width * count for width, count in self.widths) + self.contributions


def plan_pooling(index: Tensor, masks: Masks) -> PoolingPlan:
    """Choose how each mask is pooled where every slice has an attention map of its own.

    Parameters
    ----------
    index : int [K, N]
        The mask that is slice n of pose k.
    masks : CSR rows
        The M distinct masks, as `as_means` gives them.
    """
    starts = masks[0]
    slices = index.shape[1]
    lengths = starts[1:] - starts[:-1]
    used = torch.zeros(slices, len(lengths), dtype=torch.bool, device=index.device)
    for n in range(slices):
        used[n].index_fill_(0, index[:, n].long(), True)
    # Gathering once and multiplying for all N breaks even at about this many uses (measured on a
    # CPU with C = 512).
    many = (5 * used.sum(dim=0) > 2 * slices + 16) & (lengths > 0)

    padded = -(-lengths // _PADDED) * _PADDED
    numbers = torch.nonzero(many)[:, 0]
    numbers = numbers[torch.argsort(padded[numbers], stable=True)]
    runs = torch.unique_consecutive(padded[numbers], return_counts=True)
    widths = list(zip(*(run.tolist() for run in runs), strict=True))

    alone = [torch.nonzero(used[n] & ~many)[:, 0] for n in range(slices)]
    single = [(rows, running_sums(lengths[rows]).numpy(force=True)) for rows in alone]
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


def take_rows(masks: Masks, chosen: Tensor, nonzeros: int) -> Masks:
    """The chosen rows [R] of a CSR matrix, which have so many nonzeros."""
    starts, cells, fractions = masks
    lengths = starts[chosen + 1] - starts[chosen]
    new_starts = running_sums(lengths)
    shift = starts[chosen] - new_starts[:-1]
    shift = torch.repeat_interleave(shift, lengths, output_size=nonzeros)
    taken = torch.arange(len(shift), dtype=starts.dtype, device=shift.device) + shift
    return new_starts, cells[taken], fractions[taken]


def _take_many(masks: Masks, chosen: Tensor) -> Masks:
    """`take_rows` of many rows, a block after the other."""
    starts, cells, fractions = masks
    new_starts = running_sums(starts[chosen + 1] - starts[chosen])
    nonzeros = int(new_starts[-1])
    taken, shares = cells.new_empty(nonzeros), fractions.new_empty(nonzeros)
    for first in range(0, len(chosen), _ROWS):
        some = chosen[first : first + _ROWS]
        begin, end = int(new_starts[first]), int(new_starts[first + len(some)])
        _, taken[begin:end], shares[begin:end] = take_rows(masks, some, end - begin)
    return new_starts, taken, shares


def running_sums(lengths: Tensor) -> Tensor:
    """Sum of the lengths [R] before each, and of all: [R + 1]."""
    return F.pad(torch.cumsum(lengths, 0, dtype=lengths.dtype), (1, 0))


@dataclass(frozen=True)
class SharedPlan:
    """What to pool where all slices share one attention map; made by `plan_shared`.

    A mask then has one descriptor, whichever slice number it serves.

    Attributes
    ----------
    masks : CSR rows
        The R masks in use.
    slot : int [K, N]
        Which contribution is that of slice n of pose k; those of a mask are N in turn.
    """

    masks: Masks
    slot: Tensor


def plan_shared(index: Tensor, masks: Masks) -> SharedPlan:
    """Choose the masks to pool, for `SharedPlan`; arguments as for `plan_pooling`."""
    slices, device = index.shape[1], index.device
    lengths = masks[0][1:] - masks[0][:-1]
    # Without a sort of all K * N numbers, which would take most of the memory, and in blocks.
    blocks = index.split(max(1, _NUMBERS // slices))
    chosen = torch.zeros(len(lengths), dtype=torch.bool, device=device)
    for block in blocks:
        chosen.index_fill_(0, block.flatten().long(), True)
    used = torch.nonzero(chosen)[:, 0]
    dtype = torch.int32 if len(used) * slices < 2**31 else torch.int64
    first = (torch.cumsum(chosen, 0) - 1).to(dtype) * slices
    numbers = torch.arange(slices, dtype=dtype, device=device)
    slot = torch.empty_like(index, dtype=dtype)
    for block, slots in zip(blocks, slot.split(len(blocks[0])), strict=True):
        torch.add(first[block], numbers, out=slots)
    if len(used) < len(lengths):
        masks = _take_many(masks, used)
    # Else they are those of the candidates: a copy for a million poses would take 2 GB on its way.
    return SharedPlan(masks, slot)
