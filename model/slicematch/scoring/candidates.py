"""Candidate poses with their slice masks, as a network scores them."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from slicemask import Bank
from slicematch.angles import angle_difference_deg
from slicematch.errors import ConfigError
from slicematch.priors import in_place_prior
from slicematch.scoring.plan import (
    Masks,
    PoolingPlan,
    SharedPlan,
    as_means,
    plan_pooling,
    plan_shared,
)


@dataclass(frozen=True)
class Candidates:
    """Candidate poses and their slice masks, on one device; made by `from_bank`.

    Attributes
    ----------
    poses : float64 [K, 3]
        u, v, heading_deg; a NumPy array.
    index : int32 or int64 [K, N, B]
        The mask that is band b of slice n of pose k; B is 1 where there are no bands.
    masks : (row starts [M + 1], flat cells [nnz], weights [nnz])
        The M distinct masks as CSR rows of L * L cells, each divided by its sum (`as_means`).
    cells : int
        L.
    shape : tuple of int
        Shape of the whole grid, (rows, columns, headings), or (poses,) for a list.
    grid_index : int64 [K]
        Where these poses stand in the whole grid, flattened.
    """

    poses: np.ndarray
    index: Tensor
    masks: Masks
    cells: int
    shape: tuple[int, ...]
    grid_index: Tensor

    @classmethod
    def from_bank(cls, bank: Bank, device: torch.device | str = "cpu") -> "Candidates":
        """All poses of a bank (`slicemask.open_bank`)."""
        (data, indices, indptr), poses = bank.csr_arrays(), np.asarray(bank.poses)
        # 32-bit indices: half the memory, and faster products, where the count allows them.
        # A little less than they reach, for loops that step past the end.
        integer = np.int32 if len(data) < 2**31 - 2**10 else np.int64
        grid, index = bank.spec.grid, np.asarray(bank.index).astype(integer, copy=False)
        starts, cells, fractions = (
            torch.from_numpy(np.ascontiguousarray(part))
            for part in (
                indptr.astype(integer, copy=False),
                indices.astype(integer, copy=False),
                data,
            )
        )
        return cls(
            poses=poses,
            index=torch.from_numpy(index.reshape(*index.shape[:2], -1)),
            masks=as_means((starts, cells, fractions)),
            cells=bank.spec.cells,
            shape=(len(poses),) if grid is None else grid.shape,
            grid_index=torch.arange(len(poses)),
        ).to(device)

    def to(self, device: torch.device | str) -> "Candidates":
        """Return the same candidates on another device."""
        starts, cells, weights = (part.to(device) for part in self.masks)
        return replace(
            self,
            index=self.index.to(device),
            masks=(starts, cells, weights),
            grid_index=self.grid_index.to(device),
        )

    def within(
        self,
        heading_prior: tuple[float, float] | None = None,
        place_prior: tuple[float, float, float] | None = None,
    ) -> "Candidates":
        """Return the candidates that agree with what is known before.

        Parameters
        ----------
        heading_prior : (centre, half_width), optional
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
        if heading_prior is not None:
            centre, half_width = _numbers("heading prior", heading_prior, 2)
            keep &= np.abs(angle_difference_deg(self.poses[:, 2], centre)) <= half_width + 1e-9
        if place_prior is not None:
            u, v, radius = _numbers("place prior", place_prior, 3)
            keep &= in_place_prior(self.poses[:, 0], self.poses[:, 1], (u, v, radius))
        if not keep.any():
            raise ConfigError(
                f"no candidate pose agrees with heading prior {heading_prior} (centre, half "
                f"width in degrees) and place prior {place_prior} (u, v, radius); widen them, or "
                "choose a grid with candidates there"
            )
        if keep.all():
            return self
        chosen = torch.from_numpy(np.flatnonzero(keep)).to(self.grid_index.device)
        return replace(
            self,
            poses=self.poses[keep],
            index=self.index[chosen],
            grid_index=self.grid_index[chosen],
        )

    def scatter_to_grid(self, scores: Tensor) -> Tensor:
        """Scores [B, K] laid on the whole grid: [B, rows, columns, headings].

        Candidates that a prior left out get -inf, so that neither a maximum nor a softmax sees
        them.
        """
        whole = scores.new_full((len(scores), math.prod(self.shape)), -math.inf)
        whole[:, self.grid_index] = scores
        return whole.view(-1, *self.shape)

    @cached_property
    def plans(self) -> list[PoolingPlan]:
        """How each band's masks are pooled where slices have their own attention; kept."""
        return [plan_pooling(index, self.masks) for index in self.index.unbind(dim=2)]

    @cached_property
    def shared_plans(self) -> list[SharedPlan]:
        """How each band's masks are pooled where slices share their attention; kept."""
        return [plan_shared(index, self.masks) for index in self.index.unbind(dim=2)]


def _numbers(name: str, prior: tuple[float, ...], count: int) -> tuple[float, ...]:
    """The prior's numbers, checked: finite, as many as it takes, the last one not negative."""
    values = tuple(float(value) for value in prior)
    if len(values) != count or not all(map(math.isfinite, values)) or values[-1] < 0:
        form = "(centre, half_width)" if count == 2 else "(u, v, radius)"
        raise ConfigError(f"{name} is {prior!r}; it must be {form}, finite, the last at least 0")
    return values
