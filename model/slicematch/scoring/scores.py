"""Scores of candidate poses, with memory that does not grow with poses x slices x channels.

Only the cosine of the global descriptors is wanted,

    c_k = sum_nb d_g^{n,b} . d_a^{k,n,b}  /  ( |d_g| |d_a^k| ),

and the aerial descriptors d_a^{k,n,b} are unit vectors or, where a mask is empty, zero. So a mask's
contribution to c_k is two scalars: its dot product with d_g^{n,b}, and whether it is present at
all. They depend on the mask, its slice number and its band alone, and a bank holds each distinct
mask once: `pooling.py` computes them for all that are used, and here they are summed for each pose.

Shapes: S pairs, C channels, N slices, B bands of range (1 where there are none), K poses, L x L
aerial cells. Descriptors and attention maps come as [S, N * B, ...], slice by slice.
"""

from functools import partial

import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from slicematch.errors import ConfigError
from slicematch.network.aggregation import EPSILON, aerial_descriptors
from slicematch.scoring.candidates import Candidates
from slicematch.scoring.pooling import pool_by_slice, pool_shared


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
    ground : float [S, N * B, C]
        d_g^{n,b}.
    features : float [S, C, L, L]
        z_a.
    attention : float [S, N * B, L, L] or [S, 1, L, L]
        M_a^{n,b}, or the map that all slices and bands share.
    candidates : Candidates
        K poses, the same for the whole batch, on the tensors' device.
    values_at_once : int, optional
        Values that are pooled in one block of plain torch operations, which bounds the memory; by
        default as many as suit the device, or, on a GPU and without gradients, a kernel that has
        no blocks.

    Returns
    -------
    scores : float [S, K]
        In [-1, 1]; 0 for a candidate whose slices all miss the tile.

    Raises
    ------
    ConfigError
        If the candidates have other slices, bands or cells than the tensors.
    """
    slices, bands = candidates.index.shape[1:]
    if slices * bands != ground.shape[1] or candidates.cells != features.shape[-1]:
        masks = f"{slices} slices" + (f" of {bands} bands" if bands > 1 else "")
        raise ConfigError(
            f"the bank has {masks} and {candidates.cells} cells a side, the model "
            f"{ground.shape[1]} descriptors and {features.shape[-1]} cells; build the bank for "
            "this model"
        )
    with torch.autocast(features.device.type, enabled=False):
        dtype = torch.promote_types(features.dtype, torch.float32)
        ground = ground.to(dtype).unflatten(1, (slices, bands))
        features = features.to(dtype).flatten(2).mT.contiguous()  # [S, L * L, C]
        attention = attention.to(dtype).flatten(2)
        shared = attention.shape[1] == 1 and slices * bands > 1
        if not shared:
            attention = attention.unflatten(1, (slices, bands))
        dots = features.new_zeros(len(features), len(candidates.poses))
        present = dots
        for b in range(bands):
            if shared:
                shared_plan = candidates.shared_plans[b]
                slot, maps = shared_plan.slot, attention.mT.contiguous()
                pool = partial(pool_shared, shared_plan)
            else:
                plan = candidates.plans[b]
                slot, maps = plan.slot, attention[:, :, b].mT.contiguous()
                pool = partial(pool_by_slice, plan)
            sums = torch.stack(
                [
                    F.embedding_bag(slot, pool(*pair, values_at_once), mode="sum")
                    for pair in zip(ground[:, :, b], features, maps, strict=True)
                ]
            )  # [S, K, 2]
            dots, present = dots + sums[..., 0], present + sums[..., 1]
        return cosine(dots, present, ground.flatten(1))


def score_masks(ground: Tensor, features: Tensor, attention: Tensor, masks: Tensor) -> Tensor:
    """Scores of a few poses by their dense masks, each pair its own; as in `score_candidates`.

    Parameters
    ----------
    ground : float [S, N * B, C]
    features : float [S, C, L, L]
    attention : float [S, N * B, L, L] or [S, 1, L, L]
    masks : float [S, K, N, L, L] or [S, K, N, B, L, L]
        As `slicemask.slice_masks` gives them; gradients flow through them.

    Returns
    -------
    scores : float [S, K]
    """
    with torch.autocast(features.device.type, enabled=False):
        dtype = torch.promote_types(features.dtype, torch.float32)
        aerial = aerial_descriptors(
            features.to(dtype), attention.to(dtype), masks.to(dtype).flatten(2, -3)
        )  # [S, K, N * B, C]
        ground = ground.to(dtype)
        present = (aerial.detach() != 0).any(dim=-1).sum(dim=-1)
        return cosine(torch.einsum("snc,sknc->sk", ground, aerial), present, ground.flatten(1))


def cosine(dots: Tensor, present: Tensor, ground: Tensor) -> Tensor:
    """Cosines of global descriptors from the sums over their parts.

    Parameters
    ----------
    dots : float [..., K]
        sum_nb d_g^{n,b} . d_a^{k,n,b}.
    present : float or int [..., K]
        How many of the d_a^{k,n,b} are not zero: the square of the length of all together.
    ground : float [..., N * B * C]
        d_g.

    Returns
    -------
    scores : float [..., K]
        0 where nothing is present.
    """
    square = present * (ground.square().sum(dim=-1, keepdim=True) + EPSILON)
    return dots * torch.where(present > 0, square, 1.0).rsqrt()


def heat_map(scores: Tensor) -> Tensor:
    """Best score at each place: the maximum over headings, [..., rows, columns]."""
    return scores.amax(dim=-1)
