"""Descriptors of the ground image and of the poses: SliceMatch, CVPR 2023, eq. 2 to 4.

Shapes: S pairs, C channels, H x W ground cells, L x L aerial cells, N slices, B bands of range (1
where there are none), K poses. Descriptors of bands stand slice by slice: [S, N * B, C].

Mixed precision ends at the encoders: here, as in `slicematch.scoring`, autocast is off.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812  the name torch's own documents use

# Added to the squared length of a vector that is scaled to length 1 (ours). Means of features have
# squared lengths around 1; of one shorter than 1e-4, the gradient would grow without bound.
EPSILON = 1e-8
# The least area of a slice, in cells, for whose mean features are divided by all of it.
LEAST_AREA = 1e-12


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
        self.attention = Attention(channels)

    def forward(self, features: Tensor) -> Tensor:
        """Ground descriptors d_g^n.

        Parameters
        ----------
        features : float [S, C, H, W]
            z_g. Where N does not divide W, its attended map is first interpolated linearly along
            W to the next multiple of N.

        Returns
        -------
        descriptors : float [S, N, C]
            Unit length; zero where a slice's features are all zero.
        """
        with torch.autocast(features.device.type, enabled=False):
            attended = features * self.attention(features)  # z'_g = M_g * z_g
            return unit(slice_means(attended, self.slices).mean(dim=2).transpose(1, 2))


class AerialAttention(nn.Module):
    """What each ground descriptor looks for in the aerial feature map (eq. 3).

    Parameters
    ----------
    channels : int
        C.
    cross_view : bool
        Whether the attention sees the similarity to the ground descriptor; without it (the
        paper's ablation) all slices share one attention map.
    """

    def __init__(self, channels: int, cross_view: bool = True) -> None:
        super().__init__()
        self.cross_view = cross_view
        self.attention = Attention(channels, similarity=cross_view)

    def forward(self, features: Tensor, ground: Tensor) -> Tensor:
        """Attention maps M_a^n, or with bands M_a^{n,b}.

        Parameters
        ----------
        features : float [S, C, L, L]
            z_a.
        ground : float [S, N * B, C]
            d_g^{n,b}.

        Returns
        -------
        attention : float [S, N * B, L, L], or [S, 1, L, L] without cross-view attention
            In (0, 1).
        """
        with torch.autocast(features.device.type, enabled=False):
            if not self.cross_view:
                return self.attention(features)
            directions = unit(features.movedim(1, -1))  # [S, L, L, C]
            # S^n, the cosine (ours)
            similarity = torch.einsum("sijc,snc->snij", directions, unit(ground))
            return self.attention(features, similarity)


def slice_means(features: Tensor, slices: int) -> Tensor:
    """Means over the columns of each slice, row by row: [S, C, H, W] to [S, C, H, N].

    Where N does not divide W, the map is first interpolated linearly along W to the next multiple
    of N.
    """
    height, width = features.shape[-2:]
    columns = -(-width // slices)
    if columns * slices != width:
        size = (height, columns * slices)
        features = F.interpolate(features, size, mode="bilinear", align_corners=False)
    return features.unflatten(-1, (slices, columns)).mean(dim=-1)


def aerial_descriptors(features: Tensor, attention: Tensor, masks: Tensor) -> Tensor:
    """Aerial descriptors d_a^{k,n} from dense masks (eq. 4).

    Parameters
    ----------
    features : float [S, C, L, L]
        z_a.
    attention : float [S, N * B, L, L] or [S, 1, L, L]
        M_a^{n,b}, or the map that all slices and bands share.
    masks : float [S, K, N * B, L, L]
        P^{k,n,b}: the share of each cell that band b of slice n of pose k covers.

    Returns
    -------
    descriptors : float [S, K, N * B, C]
        Unit length. The descriptor of an empty mask is zero, and so is its gradient (ours).
    """
    weights = masks * attention[:, None]
    areas = masks.sum(dim=(-2, -1)).clamp_min(LEAST_AREA)
    return unit(torch.einsum("sknij,scij->sknc", weights, features) / areas[..., None])


class Attention(nn.Module):
    """sigmoid(conv1x1(.)): two 1x1 convolutions with a ReLU between, C // 2 wide (ours).

    Parameters
    ----------
    channels : int
        Of the feature maps.
    similarity : bool
        Whether a map of similarities is seen beside them, one for each attention map.
    maps : int
        How many attention maps come out; with similarities, as many as there are of those.
    """

    def __init__(self, channels: int, similarity: bool = False, maps: int = 1) -> None:
        super().__init__()
        width = max(1, channels // 2)
        self.channels = channels
        self.first = nn.Conv2d(channels + similarity, width, 1)
        self.second = nn.Conv2d(width, maps, 1)

    def forward(self, features: Tensor, similarity: Tensor | None = None) -> Tensor:
        """Attention maps in (0, 1).

        Parameters
        ----------
        features : float [S, C, H, W]
        similarity : float [S, N, H, W], optional

        Returns
        -------
        attention : float [S, N or maps, H, W]
        """
        return torch.sigmoid(self.logits(features, similarity))

    def logits(self, features: Tensor, similarity: Tensor | None = None) -> Tensor:
        """What the sigmoid is taken of; arguments and shapes as for the maps."""
        # The first convolution of concat(z, S^n) is the sum of those of z and of S^n: the
        # larger part is the same for all slices and done once.
        weight = self.first.weight
        hidden = F.conv2d(features, weight[:, : self.channels], self.first.bias)[:, None]
        if similarity is not None:
            hidden = hidden + weight[:, self.channels] * similarity[:, :, None]
        hidden = F.relu(hidden)  # [S, N or 1, width, H, W]
        return self.second(hidden.flatten(0, 1)).view(hidden.shape[0], -1, *hidden.shape[-2:])


def unit(vectors: Tensor) -> Tensor:
    """Vectors scaled to length 1 along the last axis: v / sqrt(|v|^2 + 1e-8).

    The epsilon keeps the gradient finite: it is below 1e4 for the shortest vectors, which scaled
    exactly would have one without bound.

    Parameters
    ----------
    vectors : float [..., C]

    Returns
    -------
    units : float [..., C]
        In the dtype of the vectors, computed in float32 at least; a zero vector stays zero, and
        passes no gradient.
    """
    # A half-precision square overflows for a length of 256, and a bfloat16 one has three digits.
    exact = vectors.to(torch.promote_types(vectors.dtype, torch.float32))
    squared = exact.square().sum(dim=-1, keepdim=True)
    return (exact * ((squared + EPSILON).rsqrt() * (squared > 0))).to(vectors.dtype)
