"""A feature pyramid: what deep stages know, at the resolution of a shallow one (ours)."""

from collections.abc import Sequence

from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812


class FeaturePyramid(nn.Module):
    """The finest level of a feature pyramid network: Lin et al., CVPR 2017, section 3.

    Each stage goes through a 1x1 convolution to the same channels; from the deepest on, each sum
    is brought to the size of the next finer stage (linearly) and added to it; a 3x3 convolution
    ends it.

    Parameters
    ----------
    stages : sequence of int
        Channels of the stages, the finest first.
    channels : int
        C, those of the result.
    """

    def __init__(self, stages: Sequence[int], channels: int) -> None:
        super().__init__()
        self.lateral = nn.ModuleList(nn.Conv2d(stage, channels, 1) for stage in stages)
        self.smooth = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, stages: Sequence[Tensor]) -> Tensor:
        """Feature maps [S, C_i, H_i, W_i] of the stages, the finest first, to [S, C, H_0, W_0]."""
        total = self.lateral[-1](stages[-1])
        for lateral, stage in zip(self.lateral[-2::-1], stages[-2::-1], strict=True):
            total = lateral(stage) + F.interpolate(
                total, stage.shape[-2:], mode="bilinear", align_corners=False
            )
        return self.smooth(total)
