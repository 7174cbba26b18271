"""Slice descriptors of the ground image and of the poses: SliceMatch, CVPR 2023, eq. 2 to 4.

Shapes: B pairs, C channels, H x W ground cells, L x L aerial cells, N slices, K poses.

Mixed precision ends at the encoders: here, as in `slicematch.scoring.scores`, autocast is off.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812  the name torch's own documents use


class GroundAggregator(nn.Module):
    """Ground feature map to one unit descriptor for each vertical slice (eq. 2).

    Parameters
    ----------
    channels : int
        C.
    slices : int
        N.
    """

    def __init__(self, channels: int, slices: int) -> None:
        super().__init__()
        self.slices = slices
        self.attention = _Attention(channels)

    def forward(self, features: Tensor) -> Tensor:
        """Ground descriptors d_g^n.

        Parameters
        ----------
        features : float [B, C, H, W]
            z_g. Where N does not divide W, its attended map is first interpolated linearly along
            W to the next multiple of N.

        Returns
        -------
        descriptors : float [B, N, C]
            Unit length; zero where a slice's features are all zero.
        """
        height, width = features.shape[-2:]
        cells = -(-width // self.slices)
        with torch.autocast(features.device.type, enabled=False):
            attended = features * self.attention(features)  # z'_g = M_g * z_g
            if cells * self.slices != width:
                size = (height, cells * self.slices)
                attended = F.interpolate(attended, size, mode="bilinear", align_corners=False)
            means = attended.unflatten(-1, (self.slices, cells)).mean(dim=(2, 4))  # [B, C, N]
            return unit(means.transpose(1, 2))


class AerialAttention(nn.Module):
    """What each ground slice looks for in the aerial feature map (eq. 3).

    Parameters
    ----------
    channels : int
        C.
    cross_view : bool
        Whether the attention sees the similarity to the ground slice; without it (the paper's
        ablation) all slices share one attention map.
    """

    def __init__(self, channels: int, cross_view: bool = True) -> None:
        super().__init__()
        self.cross_view = cross_view
        self.attention = _Attention(channels, similarity=cross_view)

    def forward(self, features: Tensor, ground: Tensor) -> Tensor:
        """Attention maps M_a^n.

        Parameters
        ----------
        features : float [B, C, L, L]
            z_a.
        ground : float [B, N, C]
            d_g^n, of unit length.

        Returns
        -------
        attention : float [B, N, L, L]
            In (0, 1).
        """
        with torch.autocast(features.device.type, enabled=False):
            if not self.cross_view:
                return self.attention(features).expand(-1, ground.shape[1], -1, -1)
            directions = unit(features.movedim(1, -1))  # [B, L, L, C]
            # S^n, the cosine (ours)
            similarity = torch.einsum("bijc,bnc->bnij", directions, ground)
            return self.attention(features, similarity)


def aerial_descriptors(features: Tensor, attention: Tensor, masks: Tensor) -> Tensor:
    """Aerial descriptors d_a^{k,n} from dense masks (eq. 4).

    Parameters
    ----------
    features : float [B, C, L, L]
        z_a.
    attention : float [B, N, L, L]
        M_a^n.
    masks : float [B, K, N, L, L]
        P^{k,n}: the share of each cell that slice n of pose k covers.

    Returns
    -------
    descriptors : float [B, K, N, C]
        Unit length. The descriptor of an empty slice is zero, and so is its gradient (ours).
    """
    # The paper's mean, sum P z' / sum P, has the direction of sum P z', and only the direction
    # outlives Norm; leaving the division out also leaves no 0 / 0 behind.
    weights = masks * attention[:, None]
    return unit(torch.einsum("bknij,bcij->bknc", weights, features))


class _Attention(nn.Module):
    """sigmoid(conv1x1(.)): two 1x1 convolutions with a ReLU between, C // 2 wide (ours)."""

    def __init__(self, channels: int, similarity: bool = False) -> None:
        super().__init__()
        width = max(1, channels // 2)
        self.channels = channels
        self.first = nn.Conv2d(channels + similarity, width, 1)
        self.second = nn.Conv2d(width, 1, 1)

    def forward(self, features: Tensor, similarity: Tensor | None = None) -> Tensor:
        """[B, C, H, W] and, where it is used, [B, N, H, W] to [B, N or 1, H, W]."""
        # The first convolution of concat(z, S^n) is the sum of those of z and of S^n: the
        # larger part is the same for all slices and done once.
        weight = self.first.weight
        hidden = F.conv2d(features, weight[:, : self.channels], self.first.bias)[:, None]
        if similarity is not None:
            hidden = hidden + weight[:, self.channels] * similarity[:, :, None]
        hidden = F.relu(hidden)  # [B, N or 1, width, H, W]
        return torch.sigmoid(self.second(hidden.flatten(0, 1))).view(
            hidden.shape[0], hidden.shape[1], *hidden.shape[-2:]
        )


def unit(vectors: Tensor) -> Tensor:
    """Vectors scaled to length 1 along the last axis; a zero vector stays zero.

    Parameters
    ----------
    vectors : float [..., C]

    Returns
    -------
    units : float [..., C]
        The gradient at a zero vector is zero, never NaN or infinite.
    """
    squared = vectors.square().sum(dim=-1, keepdim=True)
    some = squared > 0
    return vectors * torch.where(some, squared, 1.0).rsqrt() * some
