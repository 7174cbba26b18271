"""Ground descriptors of slices that are cut into bands of range (ours).

The paper averages a slice over its whole height, so range is lost. Here each band has its own
attention map, which looks at the rows where the band's ground is seen.

Shapes: S pairs, C channels, H x W ground cells, N slices, B bands.
"""

import itertools
import math
from dataclasses import dataclass
from typing import Literal, get_args

import torch
from torch import Tensor, nn

from slicemask.geometry.frustum import Projection
from slicematch.errors import ConfigError
from slicematch.network.aggregation import Attention, slice_means, unit

BandRows = Literal["geometry", "learned"]

# Waves along a row's elevation that a learned attention map sees: sine and cosine of 1, 2, 4 and 8
# times its angle.
_WAVES = 4


@dataclass(frozen=True, kw_only=True)
class RangeBands:
    """Which range each row of a ground image sees on flat ground, and what is made of it.

    Parameters
    ----------
    ranges_m : tuple of float
        r_1 < ... < r_{B-1}, metres: where the bands meet. The last one has no end.
    camera_height_m : float
        Of the camera above the ground.
    elevations_deg : (lowest, highest)
        Of the image's bottom and top edge, degrees above the horizon; of a pinhole image along
        its central column.
    projection : {"equirectangular", "pinhole"}
        Rows are equal steps of elevation, or of its tangent.
    rows : {"geometry", "learned"}
        Whether a band looks only at the rows where flat ground in its range is seen, or at rows
        that are learned, starting from those.
    value_maps : bool
        Whether each band's descriptors go through a linear map V_b of their own.
    weights : bool
        Whether each descriptor has a weight exp(a_b . d + c_b) in the score.

    Raises
    ------
    ConfigError
        If a value is out of its range; the message names it.
    """

    ranges_m: tuple[float, ...]
    camera_height_m: float
    elevations_deg: tuple[float, float]
    projection: Projection
    rows: BandRows = "geometry"
    value_maps: bool = True
    weights: bool = True

    def __post_init__(self) -> None:
        edges = (0.0, *self.ranges_m)
        if not all(math.isfinite(far) and near < far for near, far in itertools.pairwise(edges)):
            raise ConfigError(
                f"bands end at {self.ranges_m} m; they must be increasing distances above 0"
            )
        if not 0 < self.camera_height_m < math.inf:
            raise ConfigError(
                f"camera_height_m is {self.camera_height_m!r}; it must be a height above 0"
            )
        low, high = self.elevations_deg
        if not -90 <= low < high <= 90:
            raise ConfigError(
                f"elevations are {self.elevations_deg}; they must be (lowest, highest) from -90 "
                "to 90 degrees"
            )
        if self.rows not in get_args(BandRows):
            raise ConfigError(
                f"band_rows is {self.rows!r}; it must be one of {', '.join(get_args(BandRows))}"
            )

    @property
    def bands(self) -> int:
        """B."""
        return len(self.ranges_m) + 1

    def row_elevations_deg(self, edges: Tensor) -> Tensor:
        """Elevations in degrees at heights in the image, 0 its bottom edge and 1 its top edge."""
        low, high = self.elevations_deg
        if self.projection == "equirectangular":
            return low + (high - low) * edges
        low, high = (math.tan(math.radians(angle)) for angle in (low, high))
        return torch.rad2deg(torch.atan(low + (high - low) * edges))

    def fractions(self, rows: int) -> Tensor:
        """s_b: the fraction of each row that sees the ground in each band, float64 [B, H].

        Rows run from the top of the image, as in a feature map. What lies above the horizon
        belongs to the last band, so that the bands of a row sum to 1.
        """
        low, high = self.elevations_deg
        # Where each band begins, as an elevation: its far edge is the next one's near edge.
        near_deg = [-90.0] + [
            -math.degrees(math.atan2(self.camera_height_m, far)) for far in self.ranges_m
        ]
        if self.projection == "pinhole":
            low, high = (math.tan(math.radians(angle)) for angle in (low, high))
            near_deg = [-math.inf] + [math.tan(math.radians(angle)) for angle in near_deg[1:]]
        begins = (torch.tensor(near_deg, dtype=torch.float64) - low) / (high - low)  # heights
        edges = torch.cat([begins, begins.new_tensor([math.inf])])
        top = torch.arange(rows, 0, -1, dtype=torch.float64) / rows
        bottom = torch.arange(rows - 1, -1, -1, dtype=torch.float64) / rows
        inside = torch.minimum(top, edges[1:, None]) - torch.maximum(bottom, edges[:-1, None])
        return (inside * rows).clamp(0.0, 1.0)


class BandedGroundAggregator(nn.Module):
    """Ground feature map to one descriptor for each slice and band.

    For each band an attention map A_b. Rows by geometry: A_b = sigmoid(conv1x1(z_g)) * s_b(row).
    Learned: A_b = sigmoid(conv1x1(concat(z_g, waves of the row's elevation))_b + prior_b(row)),
    with a parameter prior_b that starts at 4 s_b - 2. The mean of A_b z_g over a slice's cells
    goes through V_b (the identity at first), is scaled to unit length, and weighted by
    exp(a_b . d + c_b), which starts at 1.

    Parameters
    ----------
    channels : int
        C.
    slices : int
        N.
    rows : int
        H.
    bands : RangeBands
        The bands.
    """

    waves: Tensor
    fractions: Tensor
    values: nn.Parameter | None
    weight_directions: nn.Parameter | None
    weight_offsets: nn.Parameter | None

    def __init__(self, channels: int, slices: int, rows: int, bands: RangeBands) -> None:
        super().__init__()
        self.slices = slices
        self.learned = bands.rows == "learned"
        count = bands.bands
        fractions = bands.fractions(rows).float()
        if self.learned:
            middles = (torch.arange(rows, 0, -1) - 0.5) / rows
            angles = torch.deg2rad(bands.row_elevations_deg(middles))
            angles = angles * 2.0 ** torch.arange(_WAVES)[:, None]
            self.register_buffer("waves", torch.cat([angles.sin(), angles.cos()]), persistent=False)
            self.attention = Attention(channels + 2 * _WAVES, maps=count)
            self.row_prior = nn.Parameter(4.0 * fractions - 2.0)
        else:
            self.attention = Attention(channels)
            self.register_buffer("fractions", fractions, persistent=False)
        self.values = self.weight_directions = self.weight_offsets = None
        if bands.value_maps:
            self.values = nn.Parameter(torch.eye(channels).repeat(count, 1, 1))
        if bands.weights:
            self.weight_directions = nn.Parameter(torch.zeros(count, channels))
            self.weight_offsets = nn.Parameter(torch.zeros(count))

    def forward(self, features: Tensor) -> Tensor:
        """Ground descriptors d_g^{n,b}.

        Parameters
        ----------
        features : float [S, C, H, W]
            z_g. Where N does not divide W, its attended map is first interpolated linearly along
            W to the next multiple of N.

        Returns
        -------
        descriptors : float [S, N * B, C]
            Slice by slice, near bands first. As long as their weights; zero where a band's
            features are all zero.
        """
        with torch.autocast(features.device.type, enabled=False):
            d = unit(self._means(features))  # [S, N, B, C]
            if self.weight_directions is not None and self.weight_offsets is not None:
                d = (
                    d
                    * ((d * self.weight_directions).sum(-1) + self.weight_offsets).exp()[..., None]
                )
            return d.flatten(1, 2)

    def _means(self, features: Tensor) -> Tensor:
        """V_b of the mean of A_b z_g over each slice: [S, N, B, C]."""
        if self.learned:
            count, _, _, width = features.shape
            waves = self.waves[None, :, :, None].expand(count, -1, -1, width)
            logits = self.attention.logits(torch.cat([features, waves.to(features)], dim=1))
            maps = torch.sigmoid(logits + self.row_prior[:, :, None])
            attended = features[:, None] * maps[:, :, None]  # [S, B, C, H, W]
            means = slice_means(attended.flatten(0, 1), self.slices).mean(dim=2)
            means = means.unflatten(0, (count, -1))  # [S, B, C, N]
        else:
            rows = slice_means(features * self.attention(features), self.slices)  # [S, C, H, N]
            means = torch.einsum("schn,bh->sbcn", rows, self.fractions) / rows.shape[2]
        if self.values is None:
            return means.permute(0, 3, 1, 2)
        return torch.einsum("sbcn,bdc->snbd", means, self.values)
