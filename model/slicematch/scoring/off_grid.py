"""Scores of any poses for one pair of images, on or off a grid of candidates."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from slicemask import Frustum, slice_masks
from slicematch.network.aggregation import LEAST_AREA, unit
from slicematch.scoring.scores import cosine


@dataclass(frozen=True)
class PairScorer:
    """The score of any poses for one pair of images, differentiable in the poses.

    Equal to `slicematch.scoring.scores.score_masks`. The poses of a call should lie near each
    other: a slice is then pooled over the few cells that any of them needs.

    Shapes: C channels, N slices, B bands of range (1 where there are none), L x L aerial cells.

    Parameters
    ----------
    ground : float [N * B, C]
        d_g^{n,b}, slice by slice.
    features : float [C, L, L]
        z_a.
    attention : float [N * B, L, L] or [1, L, L]
        M_a^{n,b}, or the map that all slices and bands share.
    frustum : Frustum
        Of the ground image, with its bands.
    """

    ground: Tensor
    features: Tensor
    attention: Tensor
    frustum: Frustum

    def __post_init__(self) -> None:
        # Tensors made in inference mode take no part in gradients; copies made outside it do.
        with torch.inference_mode(False):
            for name in ("ground", "features", "attention"):
                tensor = getattr(self, name)
                if tensor.is_inference():
                    object.__setattr__(self, name, tensor.clone())

    def __call__(self, poses: Tensor) -> Tensor:
        """Score poses.

        Parameters
        ----------
        poses : float64 [K, 3]
            u, v in [0, 1] of the aerial frame and heading_deg.

        Returns
        -------
        scores : float [K]
            In [-1, 1]; 0 for a pose whose slices all miss the tile.
        """
        return self.contributions(poses).sum(dim=(1, 2))

    def contributions(self, poses: Tensor) -> Tensor:
        """What each band of each slice adds to the scores of poses.

        Parameters
        ----------
        poses : float64 [K, 3]
            u, v in [0, 1] of the aerial frame and heading_deg.

        Returns
        -------
        contributions : float [K, N, B]
            d_g^{n,b} . d_a^{k,n,b} over the lengths of the global descriptors: they sum to the
            score. 0 where a part of a slice misses the tile.
        """
        device, cells = self.features.device, self.features.shape[-1]
        with torch.autocast(device.type, enabled=False):
            ground = self.ground.float()
            masks = slice_masks(poses.to(device), self.frustum, cells, engine="rays")
            masks = masks.flatten(1, -3).flatten(2).float()  # [K, N * B, L * L]
            columns = self.features.flatten(1).T  # [L * L, C]
            attention = self.attention.flatten(1).expand(len(ground), -1)
            dots, present = [], ground.new_zeros(len(poses))
            for part, seen in enumerate((masks.detach() > 0).any(dim=0)):
                some = seen.nonzero()[:, 0]
                taken = masks[:, part, some]
                sums = (taken * attention[part, some].float()) @ columns[some].float()
                areas = taken.sum(dim=1, keepdim=True).clamp_min(LEAST_AREA)
                descriptors = unit(sums / areas)  # d_a^{k,n,b}, [K, C]
                dots.append(descriptors @ ground[part])
                present = present + (descriptors.detach() != 0).any(dim=1)
            parts = cosine(torch.stack(dots), present, ground.flatten()).T  # [K, N * B]
            return parts.unflatten(1, (self.frustum.slices, self.frustum.band_count))


@dataclass(frozen=True)
class JointScorer:
    """The weighted sum of the scores of several networks for one pair of images.

    Parameters
    ----------
    scorers : sequence of PairScorer [M]
        One a network. Their slices and bands may differ, the field of view not.
    weights : sequence of float [M]
        Of their scores.
    """

    scorers: Sequence[PairScorer]
    weights: Sequence[float]

    @property
    def frustum(self) -> Frustum:
        """Of the ground image, with the slices and bands that contributions are given for."""
        return self.scorers[0].frustum

    def __call__(self, poses: Tensor) -> Tensor:
        """Score poses [K, 3], as a `PairScorer` does: float [K]."""
        return sum(
            (weight * scorer(poses) for weight, scorer in self._weighted()),
            start=torch.zeros((), device=self.scorers[0].features.device),
        )

    def contributions(self, poses: Tensor) -> Tensor:
        """What each band of each slice of the first network adds to the scores of poses.

        Parameters
        ----------
        poses : float64 [K, 3]
            u, v in [0, 1] of the aerial frame and heading_deg.

        Returns
        -------
        contributions : float [K, N, B]
            They sum to the score. What another network's slice adds is spread evenly over the
            part of the image that it takes up, and over all bands.
        """
        slices, bands = self.frustum.slices, self.frustum.band_count
        total = torch.zeros((), device=self.scorers[0].features.device)
        for number, (weight, scorer) in enumerate(self._weighted()):
            parts = scorer.contributions(poses)
            if number > 0:
                overlap = _overlap(parts.shape[1], slices).to(parts)
                parts = (parts.sum(dim=2) @ overlap)[..., None].expand(-1, -1, bands) / bands
            total = total + weight * parts
        return total

    def _weighted(self) -> Sequence[tuple[float, PairScorer]]:
        return list(zip(self.weights, self.scorers, strict=True))


def _overlap(taken: int, given: int) -> Tensor:
    """The share of each of some equal parts of a whole that lies in each of others, [., .]."""
    edges, others = torch.arange(taken + 1) / taken, torch.arange(given + 1) / given
    high = torch.minimum(edges[1:, None], others[1:])
    return (high - torch.maximum(edges[:-1, None], others[:-1])).clamp_min(0) * taken
