"""SliceMatch: encode both images, aggregate to descriptors, score poses."""

from pathlib import Path

import torch
from torch import Tensor, nn

from slicematch.devices import check_precision
from slicematch.errors import ConfigError
from slicematch.network.aggregation import AerialAttention, GroundAggregator
from slicematch.network.bands import BandedGroundAggregator, RangeBands
from slicematch.network.encoders import Encoder
from slicematch.network.stages import Stages
from slicematch.precision import Precision
from slicematch.scoring.candidates import Candidates
from slicematch.scoring.scores import score_candidates


class SliceMatch(nn.Module):
    """Cross-view pose estimation by slices: Lentsch, Xia, Caesar, Kooij, CVPR 2023.

    Shapes: S pairs, C channels, N slices, B bands of range (1 where there are none), L x L aerial
    cells, K poses.

    Parameters
    ----------
    encoder : str
        timm backbone of both images; the two share no weights.
    weights : str or path
        Weights that both encoders start from: see `slicematch.network.encoders.Encoder`.
    ground_size : (height, width)
        Pixels of the ground images.
    aerial_size : int
        Pixels along each side of the aerial images.
    stride : int
        Stride of the feature maps.
    slices : int
        N.
    cross_view_attention : bool
        Whether the aerial attention sees the ground descriptors (eq. 3).
    bands : RangeBands, optional
        The bands of range that slices are cut into (ours); none in the paper.
    pyramid : int, optional
        Channels of a feature pyramid over the encoders' stages (ours); none in the paper: see
        `slicematch.network.encoders.Encoder`.
    pyramid_to : int
        Stride of the deepest stage that it takes.
    known : (Stages, Stages), optional
        Of the ground and of the aerial encoder, found before: see there.

    Attributes
    ----------
    cells : int
        L, the cells along each side of the aerial feature map, and so of the masks.
    channels : int
        C.

    Raises
    ------
    ConfigError, WeightsError
        As `slicematch.network.encoders.Encoder`.
    """

    def __init__(
        self,
        encoder: str = "vgg16",
        weights: str | Path = "imagenet",
        ground_size: tuple[int, int] = (320, 640),
        aerial_size: int = 512,
        stride: int = 16,
        slices: int = 16,
        cross_view_attention: bool = True,
        bands: RangeBands | None = None,
        pyramid: int | None = None,
        pyramid_to: int = 32,
        known: tuple[Stages, Stages] | None = None,
    ) -> None:
        super().__init__()
        if slices < 1:
            raise ConfigError(f"slices is {slices}; it must be at least 1")
        self.ground_encoder, self.aerial_encoder = (
            Encoder(encoder, size, stride, weights, pyramid, pyramid_to, stages)
            for size, stages in zip(
                (ground_size, (aerial_size, aerial_size)), known or (None, None), strict=True
            )
        )
        self.channels = self.aerial_encoder.channels
        self.cells = self.aerial_encoder.feature_size[0]
        self.ground_aggregator: nn.Module
        if bands is None:
            self.ground_aggregator = GroundAggregator(self.channels, slices)
        else:
            rows = self.ground_encoder.feature_size[0]
            self.ground_aggregator = BandedGroundAggregator(self.channels, slices, rows, bands)
        self.aerial_attention = AerialAttention(self.channels, cross_view_attention)

    @property
    def stages(self) -> tuple[Stages, Stages]:
        """Of the ground and of the aerial encoder."""
        return self.ground_encoder.stages, self.aerial_encoder.stages

    def forward(self, ground: Tensor, aerial: Tensor, candidates: Candidates) -> Tensor:
        """Images [S, 3, height, width] and [S, 3, A, A] to scores [S, K] of K candidates."""
        return self.score(self.encode_ground(ground), self.encode_aerial(aerial), candidates)

    def for_inference(self, device: torch.device, precision: Precision = "32-true") -> "SliceMatch":
        """Set the model to evaluate on a device, in a precision; returns it.

        Parameters
        ----------
        device : torch.device
            To which it moves.
        precision : {"32-true", "16-mixed", "bf16-mixed"}
            In which the encoders compute.

        Raises
        ------
        ConfigError
            If there is no such precision, or not on that device.
        """
        for encoder in (self.ground_encoder, self.aerial_encoder):
            encoder.precision = check_precision(precision, device)
        if device.type == "cpu":
            _keep_memory()
        return self.eval().to(device)

    def encode_ground(self, images: Tensor) -> Tensor:
        """Ground images [S, 3, height, width] to descriptors d_g^{n,b} [S, N * B, C]."""
        return self.ground_aggregator(self.ground_encoder(images))

    def encode_aerial(self, images: Tensor) -> Tensor:
        """Aerial images [S, 3, A, A] to feature maps z_a [S, C, L, L]."""
        return self.aerial_encoder(images)

    def attend(self, aerial: Tensor, ground: Tensor) -> Tensor:
        """Attention maps M_a of z_a [S, C, L, L] for d_g [S, N * B, C].

        [S, N * B, L, L], or [S, 1, L, L] without cross-view attention.
        """
        return self.aerial_attention(aerial, ground)

    def score(self, ground: Tensor, aerial: Tensor, candidates: Candidates) -> Tensor:
        """Scores of candidates.

        Parameters
        ----------
        ground : float [S, N * B, C]
            What `encode_ground` gives.
        aerial : float [S, C, L, L]
            What `encode_aerial` gives.
        candidates : Candidates
            K poses.

        Returns
        -------
        scores : float [S, K]
            Cosines, in [-1, 1]; `Candidates.scatter_to_grid` lays them on the grid.
        """
        return score_candidates(ground, aerial, self.attend(aerial, ground), candidates)


def _keep_memory() -> None:
    """Have glibc keep the memory that features leave for the next ones.

    It gives back blocks larger than any that was freed before, up to 32 MiB, and zeroes them when
    they are asked for again: a quarter of the time of an answer among few candidates. To free such
    a block once, which nobody has touched, costs nothing.
    """
    torch.empty(31 << 20, dtype=torch.uint8)
