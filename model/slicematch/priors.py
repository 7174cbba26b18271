"""What is known of a pose before an image is seen."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from slicematch.angles import angle_difference_deg


@dataclass(frozen=True)
class PosePrior:
    """Where a camera may be, and how it may look.

    Parameters
    ----------
    extent : (u0, v0, u1, v1)
        Places, in the aerial frame.
    heading_prior : (centre, half_width) or None
        Only headings within half_width degrees of the centre; None for any.
    place_prior : (u, v, radius) or None
        Only places within the radius of (u, v), in the aerial frame.
    """

    extent: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)
    heading_prior: tuple[float, float] | None = None
    place_prior: tuple[float, float, float] | None = None

    def project(self, poses: Tensor) -> Tensor:
        """Move poses to the nearest ones that the prior allows.

        Parameters
        ----------
        poses : float64 [K, 3]
            u, v, heading_deg; any finite values.

        Returns
        -------
        poses : float64 [K, 3]
            Headings in [0, 360). Differentiable in the poses handed in.
        """
        places, headings = poses[:, :2], poses[:, 2]
        low, high = (places.new_tensor(self.extent[start : start + 2]) for start in (0, 2))
        places = torch.maximum(torch.minimum(places, high), low)
        if self.place_prior is not None:
            *centre, radius = self.place_prior
            middle = places.new_tensor(centre)
            # Towards the extent's place that is nearest to the prior's centre, and so is in both;
            # on the way to it a place stays in the extent.
            nearest = torch.maximum(torch.minimum(middle, high), low)
            away, offset = places - nearest, nearest - middle
            # The fraction of the way out that the prior allows: |offset + fraction * away| =
            # radius. The least values keep the gradient finite where nothing is left of the way.
            square = away.square().sum(dim=1, keepdim=True).clamp_min(1e-60)
            along = (away * offset).sum(dim=1, keepdim=True)
            beyond = offset.square().sum() - radius**2
            root = (along.square() - square * beyond).clamp_min(1e-60).sqrt()
            places = nearest + away * ((root - along) / square).clamp(0.0, 1.0)
        if self.heading_prior is not None:
            centre_deg, half_width = self.heading_prior
            difference = angle_difference_deg(headings, centre_deg)
            headings = centre_deg + difference.clamp(-half_width, half_width)
        headings = torch.remainder(headings, 360.0)
        # A tiny negative heading wraps to 360 itself.
        headings = torch.where(headings < 360.0, headings, headings - 360.0)
        return torch.cat([places, headings[:, None]], dim=1)


def in_place_prior(
    u: ArrayLike, v: ArrayLike, prior: tuple[float, float, float]
) -> NDArray[np.bool]:
    """Whether places lie within the radius of a prior (u, v, radius), its edge but for rounding."""
    centre_u, centre_v, radius = prior
    distance = np.hypot(np.asarray(u) - centre_u, np.asarray(v) - centre_v)
    return np.asarray(distance <= radius + 1e-9)


def count_outside(
    poses: NDArray[np.float64],
    extent: tuple[float, float, float, float],
    place_prior: tuple[float, float, float] | None = None,
) -> int:
    """How many poses no candidate can find, since they stand outside an extent or a prior.

    Parameters
    ----------
    poses : float64 [K, 3]
        u, v, heading_deg in the aerial frame.
    extent : (u0, v0, u1, v1)
        A place on its edge is inside.
    place_prior : (u, v, radius) or None
        What lies farther than the radius from (u, v) is outside, too.
    """
    u0, v0, u1, v1 = extent
    u, v, _ = poses.T
    outside = (u < u0) | (u > u1) | (v < v0) | (v > v1)
    if place_prior is not None:
        outside |= ~in_place_prior(u, v, place_prior)
    return int(np.count_nonzero(outside))
