"""Scores of candidate poses, with memory that does not grow with poses x slices x channels.

Only the cosine of the global descriptors is wanted,

    c_k = sum_n d_g^n . d_a^{k,n}  /  ( |d_g| |d_a^k| ),

and the slice descriptors d_a^{k,n} are unit vectors or, where a slice is empty, zero. So a
slice's share in c_k is two scalars: its dot product with d_g^n, and whether it is there at all.
They depend on the slice's mask and number alone, and a bank holds each distinct mask once:
`pooling.py` computes them for all that are used, and here they are summed for each pose.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from slicemask import Bank
from slicematch.errors import ConfigError
from slicematch.evaluation.metrics import in_place_prior, turn_deg
from slicematch.network.aggregation import aerial_descriptors, unit
from slicematch.scoring.pooling import PoolingPlan, plan_pooling, pool_shares


@dataclass(frozen=True)
class Candidates:
    """Candidate poses and their slice masks, on one device; made by `from_bank`.

    Attributes
    ----------
    poses : float64 [K, 3]
        u, v, heading_deg; a NumPy array.
    index : int64 [K, N]
        The mask that is slice n of pose k.
    masks : (row starts [M + 1], flat cells [nnz], fractions [nnz])
        The M distinct masks as CSR rows of L * L cells.
    cells : int
        L.
    shape : tuple of int
        Shape of the whole grid, (rows, columns, headings), or (poses,) for a list.
    kept : int64 [K]
        Where these poses stand in the whole grid, flattened.
    """

    poses: np.ndarray
    index: Tensor
    masks: tuple[Tensor, Tensor, Tensor]
    cells: int
    shape: tuple[int, ...]
    kept: Tensor

    @classmethod
    def from_bank(cls, bank: Bank, device: torch.device | str = "cpu") -> "Candidates":
        """All poses of a bank (`slicemask.open_bank`)."""
        csr, poses = bank.csr(), np.asarray(bank.poses)
        grid = bank.spec.grid
        # 32-bit indices: half the memory, and faster products, where the count allows them.
        # A little less than they reach, for loops that step past the end.
        integer = np.int32 if csr.nnz < 2**31 - 2**10 else np.int64
        masks = (csr.indptr.astype(integer), csr.indices.astype(integer), csr.data)
        return cls(
            poses=poses,
            index=torch.from_numpy(np.asarray(bank.index).astype(np.int64)),
            masks=tuple(torch.from_numpy(np.ascontiguousarray(part)) for part in masks),
            cells=bank.spec.cells,
            shape=(len(poses),) if grid is None else grid.shape,
            kept=torch.arange(len(poses)),
        ).to(device)

    def to(self, device: torch.device | str) -> "Candidates":
        """Return the same candidates on another device."""
        return replace(
            self,
            index=self.index.to(device),
            masks=tuple(part.to(device) for part in self.masks),
            kept=self.kept.to(device),
        )

    def within(
        self,
        heading_prior_deg: tuple[float, float] | None = None,
        place_prior: tuple[float, float, float] | None = None,
    ) -> "Candidates":
        """Return the candidates that agree with what is known before.

        Parameters
        ----------
        heading_prior_deg : (centre, half_width), optional
            Only headings within half_width of the centre, counted around the circle. A half
            width of 0 is a known heading ("aligned").
        place_prior : (u, v, radius), optional
            Only places within the radius of (u, v), in the aerial frame (the tile's side is 1).

        Raises
        ------
        ConfigError
            If a prior cannot be, or leaves no candidate.
        """
        keep = np.ones(len(self.poses), dtype=bool)
        # The slack takes in candidates that stand on the prior's edge but for rounding.
        if heading_prior_deg is not None:
            centre, half_width = _numbers("heading prior", heading_prior_deg, 2)
            keep &= np.abs(turn_deg(self.poses[:, 2], centre)) <= half_width + 1e-9
        if place_prior is not None:
            prior = _numbers("place prior", place_prior, 3)
            keep &= in_place_prior(self.poses[:, 0], self.poses[:, 1], prior)
        if not keep.any():
            raise ConfigError(
                f"no candidate pose agrees with heading prior {heading_prior_deg} (centre, half "
                f"width in degrees) and place prior {place_prior} (u, v, radius); widen them, or "
                "choose a grid with candidates there"
            )
        if keep.all():
            return self
        chosen = torch.from_numpy(np.flatnonzero(keep)).to(self.kept.device)
        return replace(
            self, poses=self.poses[keep], index=self.index[chosen], kept=self.kept[chosen]
        )

    def on_grid(self, scores: Tensor) -> Tensor:
        """Scores [B, K] laid on the whole grid: [B, rows, columns, headings].

        Candidates that a prior left out get -inf, so that neither a maximum nor a softmax sees
        them.
        """
        whole = scores.new_full((len(scores), math.prod(self.shape)), -math.inf)
        whole[:, self.kept] = scores
        return whole.view(-1, *self.shape)

    @cached_property
    def pooling(self) -> PoolingPlan:
        """How these candidates' masks are pooled; found at first use and kept."""
        return plan_pooling(self.index, self.masks)


def score_candidates(
    ground: Tensor,
    features: Tensor,
    attention: Tensor,
    candidates: Candidates,
    values_at_once: int | None = None,
) -> Tensor:
    """Cosine c_k of the ground descriptor with every candidate's aerial descriptor.

    Equal to the dense product of eq. 4 and the cosine (SliceMatch, CVPR 2023, section 3), but
    nothing of size K x N x C is ever held, not even for the gradients in the three tensors.
    Computed in float32 at least.

    Parameters
    ----------
    ground : float [B, N, C]
        d_g^n, of unit length or zero.
    features : float [B, C, L, L]
        z_a.
    attention : float [B, N, L, L]
        M_a^n.
    candidates : Candidates
        K poses, the same for the whole batch, on the tensors' device.
    values_at_once : int, optional
        Values that are pooled in one block of plain torch operations, which bounds the memory; by
        default as many as suit the device, or, on a GPU and without gradients, a kernel that has
        no blocks.

    Returns
    -------
    scores : float [B, K]
        In [-1, 1]; 0 for a candidate whose slices all miss the tile.
    """
    slices = ground.shape[1]
    if candidates.index.shape[1] != slices or candidates.cells != features.shape[-1]:
        raise ConfigError(
            f"the bank has {candidates.index.shape[1]} slices and {candidates.cells} cells a "
            f"side, the model {slices} and {features.shape[-1]}; build the bank for this model"
        )
    with torch.autocast(features.device.type, enabled=False):
        dtype = torch.promote_types(features.dtype, torch.float32)
        ground = ground.to(dtype)
        features = features.to(dtype).flatten(2).mT.contiguous()  # [B, L * L, C]
        attention = attention.to(dtype).flatten(2).mT.contiguous()  # [B, L * L, N]
        plan = candidates.pooling
        sums = torch.stack(
            [
                F.embedding_bag(plan.slot, pool_shares(plan, *pair, values_at_once), mode="sum")
                for pair in zip(ground, features, attention, strict=True)
            ]
        )  # [B, K, 2]
        dots, there = sums.unbind(dim=-1)
        lengths = there.sqrt() * ground.square().sum(dim=(1, 2)).sqrt()[:, None]
        return dots / torch.where(lengths > 0, lengths, 1.0)


def score_masks(ground: Tensor, features: Tensor, attention: Tensor, masks: Tensor) -> Tensor:
    """Scores of a few poses by their dense masks, each pair its own; as in `score_candidates`.

    Parameters
    ----------
    ground : float [B, N, C]
    features : float [B, C, L, L]
    attention : float [B, N, L, L]
    masks : float [B, K, N, L, L]
        As `slicemask.slice_masks` gives them; gradients flow through them.

    Returns
    -------
    scores : float [B, K]
    """
    with torch.autocast(features.device.type, enabled=False):
        dtype = torch.promote_types(features.dtype, torch.float32)
        aerial = aerial_descriptors(
            features.to(dtype), attention.to(dtype), masks.to(dtype)
        )  # [B, K, N, C]
        return torch.einsum(
            "bi,bki->bk", unit(ground.to(dtype).flatten(1)), unit(aerial.flatten(2))
        )


def heat_map(scores: Tensor) -> Tensor:
    """Best score at each place: the maximum over headings, [..., rows, columns]."""
    return scores.amax(dim=-1)


def _numbers(name: str, prior: tuple[float, ...], count: int) -> tuple[float, ...]:
    """The prior's numbers, checked: finite, as many as it takes, the last one not negative."""
    values = tuple(float(value) for value in prior)
    if len(values) != count or not all(map(math.isfinite, values)) or values[-1] < 0:
        form = "(centre, half_width)" if count == 2 else "(u, v, radius)"
        raise ConfigError(f"{name} is {prior!r}; it must be {form}, finite, the last at least 0")
    return values
