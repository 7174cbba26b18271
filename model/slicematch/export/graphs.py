"""The parts of a trained model as graphs of plain tensors: ground, aerial, scores.

Shapes: S images, C channels, N slices, B bands of range (1 where there are none), L x L aerial
cells, K poses.
"""

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor, nn
from torch._higher_order_ops.scan import scan
from torch.nn import functional as F  # noqa: N812

from slicematch.export.masks import TABLES
from slicematch.network.aggregation import unit
from slicematch.network.slicematch import SliceMatch
from slicematch.normalisation import Triple
from slicematch.scoring.scores import cosine


class _Pixels(nn.Module):
    """Pixels as they are in files, normalised: uint8 [S, height, width, 3] to [S, 3, ...]."""

    mean: Tensor
    std: Tensor

    def __init__(self, mean: Triple, std: Triple) -> None:
        super().__init__()
        for name, values in (("mean", mean), ("std", std)):
            self.register_buffer(name, torch.tensor(values)[:, None, None], persistent=False)

    def forward(self, pixels: Tensor) -> Tensor:
        return (pixels.permute(0, 3, 1, 2).float() / 255 - self.mean) / self.std


class GroundGraph(nn.Module):
    """Ground images to descriptors."""

    def __init__(self, model: SliceMatch, mean: Triple, std: Triple) -> None:
        super().__init__()
        self.pixels = _Pixels(mean, std)
        self.encoder, self.aggregator = model.ground_encoder, model.ground_aggregator

    def forward(self, pixels: Tensor) -> Tensor:
        """Images uint8 [S, height, width, 3] to d_g^{n,b} [S, N * B, C]."""
        return self.aggregator(self.encoder(self.pixels(pixels)))


class AerialGraph(nn.Module):
    """Aerial images to feature maps."""

    def __init__(self, model: SliceMatch, mean: Triple, std: Triple) -> None:
        super().__init__()
        self.pixels, self.encoder = _Pixels(mean, std), model.aerial_encoder

    def forward(self, pixels: Tensor) -> Tensor:
        """Images uint8 [S, A, A, 3] to z_a [S, C, L, L]."""
        return self.encoder(self.pixels(pixels))


class ScoreGraph(nn.Module):
    """Descriptors, features and masks to scores of candidates, one pair at a time.

    Equal to `slicematch.scoring.scores.score_candidates`. Masks come as
    `slicematch.export.masks.MaskTables` has them, and are gone through block by block, so that
    memory does not grow with poses x cells x channels.
    """

    def __init__(self, model: SliceMatch) -> None:
        super().__init__()
        self.attention = model.aerial_attention

    def forward(
        self,
        ground: Tensor,
        features: Tensor,
        index: Tensor,
        cells: Sequence[Tensor],
        weights: Sequence[Tensor],
    ) -> Tensor:
        """Scores.

        Parameters
        ----------
        ground : float [N * B, C]
            d_g^{n,b}.
        features : float [C, L, L]
            z_a.
        index : int32 [K, N, B]
        cells : list of int32 [G_t, R_t, m_t]
        weights : list of float [G_t, R_t, m_t]

        Returns
        -------
        scores : float [K]
        """
        slices, bands = index.shape[1:]
        maps = self.attention(features[None], ground[None])[0].flatten(1)  # [N * B or 1, L * L]
        columns = features.flatten(1).T  # [L * L, C]
        dots, present = [], []
        for b in range(bands):
            mine = maps[b::bands] if len(maps) > 1 else maps
            tables = range(b * TABLES, (b + 1) * TABLES)
            found = torch.cat(
                [_pool(columns, mine.T, ground[b::bands], cells[t], weights[t]) for t in tables]
            )  # [masks, N, 2]
            flat = index[:, :, b].long() * slices + torch.arange(slices)
            taken = F.embedding(flat, found.flatten(0, 1))  # [K, N, 2]
            dots.append(taken[..., 0].sum(dim=1))
            present.append(taken[..., 1].sum(dim=1))
        return cosine(
            torch.stack(dots).sum(dim=0), torch.stack(present).sum(dim=0), ground.flatten()
        )


class BakedScoreGraph(nn.Module):
    """A `ScoreGraph` that holds its candidates' masks.

    Parameters
    ----------
    graph : ScoreGraph
        The graph.
    masks : mapping
        The arrays of `slicematch.export.masks.MaskTables`, by their names there.
    """

    def __init__(self, graph: ScoreGraph, masks: Mapping[str, Tensor]) -> None:
        super().__init__()
        self.scores, self.tables = graph, len(masks) // 2
        for name, tensor in masks.items():
            self.register_buffer(name, tensor)

    def forward(self, ground: Tensor, features: Tensor) -> Tensor:
        """Scores [K]; arguments as `ScoreGraph.forward` takes them."""
        cells, weights = (
            [self.get_buffer(f"{name}{t}") for t in range(self.tables)]
            for name in ("cells", "weights")
        )
        return self.scores(ground, features, self.get_buffer("index"), cells, weights)


def _pool(columns: Tensor, maps: Tensor, ground: Tensor, cells: Tensor, weights: Tensor) -> Tensor:
    """Contributions of masks in blocks, with every slice number: [G * R, N, 2].

    ``columns`` [L * L, C], ``maps`` [L * L, N or 1], ``ground`` [N, C].
    """
    shared = maps.shape[1] == 1
    if shared:
        columns = columns * maps

    def pool_block(carry: Tensor, block: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
        at, share = block[0].long(), block[1].unsqueeze(1)  # [R, m], [R, 1, m]
        gathered = F.embedding(at, columns)  # [R, m, C]
        if not shared:
            share = share * F.embedding(at, maps).transpose(1, 2)  # [R, N, m]
        descriptors = unit(share @ gathered)  # d_a, [R, N or 1, C]
        present = (descriptors != 0).any(dim=-1)
        dots = descriptors[:, 0] @ ground.T if shared else (descriptors * ground).sum(dim=-1)
        return carry + 0, torch.stack([dots, present.to(dots.dtype).expand_as(dots)], dim=-1)

    _, found = scan(pool_block, columns.new_zeros(1), (cells, weights))
    return found.flatten(0, 1)
