"""Candidates laid out place by place, of which a frame scores the few around its belief.

Where all slices share one attention map, a mask's aerial descriptor d_a knows no ground image. It
is then computed once for each tile, when the place is first needed, and a frame's scores are dot
products with what is there.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from slicemask import PoseGrid
from slicematch.network.aggregation import unit
from slicematch.scoring.candidates import Candidates
from slicematch.scoring.plan import Masks, PoolingPlan, SharedPlan, plan_pooling, take_rows
from slicematch.scoring.scores import cosine

Integers = NDArray[np.intp]


@dataclass(frozen=True)
class _Window(Candidates):
    """Some candidates of a `PlaceCandidates`, whose masks are laid out place by place.

    Attributes
    ----------
    whole : PlaceCandidates
    chosen : (int [p], int [h])
        The places and headings.
    """

    whole: "PlaceCandidates"
    chosen: tuple[Integers, Integers]

    @cached_property
    def shared_plans(self) -> list[SharedPlan]:
        """As `Candidates.shared_plans`, from what each place keeps."""
        return self.whole.shared_plans(*self.chosen)

    @cached_property
    def plans(self) -> list[PoolingPlan]:
        """As `Candidates.plans`."""
        return [plan_pooling(index, self.masks) for index in self.whole.indices(*self.chosen)]


class PlaceCandidates:
    """All candidates of a grid, of which windows are taken frame by frame.

    Parameters
    ----------
    candidates : Candidates
        Of a whole grid.
    grid : PoseGrid
        That grid.
    """

    def __init__(self, candidates: Candidates, grid: PoseGrid) -> None:
        self.grid, self.cells = grid, candidates.cells
        self.device = candidates.index.device
        rows, columns, headings = grid.shape
        slices, bands = candidates.index.shape[1:]
        self.masks: Masks = candidates.masks
        self._poses = candidates.poses.reshape(rows * columns, headings, 3)
        index = candidates.index.view(rows * columns, headings, slices, bands)
        self._bands: list[tuple[Tensor, Tensor, Tensor]] = []
        for band in range(bands):
            used, starts, slots = [], [0], []
            for place in index[..., band].unbind():
                distinct, slot = torch.unique(place, return_inverse=True)
                used.append(distinct.int())
                starts.append(starts[-1] + len(distinct))
                slots.append(slot.short())
            ends = torch.tensor(starts, device=self.device)
            self._bands.append((torch.cat(used), ends, torch.stack(slots)))
        self.slices, self.bands = slices, bands

    def window(self, places: Integers, headings: Integers) -> Candidates:
        """The candidates of some places [p] (row * C + column), and of some headings [h] there."""
        poses = self._poses[places][:, headings].reshape(-1, 3)
        return _Window(
            poses=poses,
            index=torch.empty(0, self.slices, self.bands, dtype=torch.long, device=self.device),
            masks=self.masks,
            cells=self.cells,
            shape=(len(poses),),
            grid_index=torch.arange(len(poses)),
            whole=self,
            chosen=(places, headings),
        )

    def shared_plans(self, places: Integers, headings: Integers) -> list[SharedPlan]:
        """How the masks of some places are pooled, band by band, where slices share attention."""
        plans = []
        for band in range(self.bands):
            rows, slot = self.rows(band, places, headings)
            plans.append(SharedPlan(self.masks_of(band, rows), slot))
        return plans

    def counts(self, band: int, places: Integers) -> Tensor:
        """How many masks a band has at some places, int64 [p]."""
        starts, at = self._bands[band][1], torch.from_numpy(places).to(self.device)
        return starts[at + 1] - starts[at]

    def rows(self, band: int, places: Integers, headings: Integers) -> tuple[Tensor, Tensor]:
        """Where a band's masks of some places stand among all, and which slices they serve.

        Returns
        -------
        rows : int64 [R]
            Place by place.
        slot : int64 [p * h, N]
            As `SharedPlan.slot`, among these rows.
        """
        _, starts, slots = self._bands[band]
        at, turned = (torch.from_numpy(some).to(self.device) for some in (places, headings))
        counts = self.counts(band, places)
        before = torch.cumsum(counts, 0) - counts
        numbers = torch.arange(self.slices, device=self.device)
        slot = slots[at][:, turned].long() + before[:, None, None]
        return spread(starts[at], counts), (slot * self.slices + numbers).flatten(0, 1)

    def indices(self, places: Integers, headings: Integers) -> list[Tensor]:
        """The masks of some places, int64 [p * h, N] for each band."""
        at, turned = (torch.from_numpy(some).to(self.device) for some in (places, headings))
        return [
            used[starts[at][:, None, None] + slots[at][:, turned].long()].long().flatten(0, 1)
            for used, starts, slots in self._bands
        ]

    def describe(self, features: Tensor, attention: Tensor) -> "PlaceDescriptors":
        """Begin to keep what a tile shows at these places.

        Parameters
        ----------
        features : float [1, C, L, L]
            z_a.
        attention : float [1, 1, L, L]
            M_a, which all slices share.
        """
        attended = (features * attention).float().flatten(2)[0].T.contiguous()
        return PlaceDescriptors(self, attended)

    def masks_of(self, band: int, rows: Tensor) -> Masks:
        """A band's masks by where they stand, int64 [R]."""
        chosen = self._bands[band][0][rows].long()
        lengths = self.masks[0][chosen + 1] - self.masks[0][chosen]
        return take_rows(self.masks, chosen, int(lengths.sum()))


def spread(first: Tensor, counts: Tensor) -> Tensor:
    """Runs of so many numbers [p] from each first one [p], one after another."""
    before = torch.cumsum(counts, 0) - counts
    numbers = torch.arange(int(counts.sum()), device=counts.device)
    return numbers + torch.repeat_interleave(first - before, counts)


class PlaceDescriptors:
    """Aerial descriptors of one tile, kept place by place; made by `PlaceCandidates.describe`.

    Parameters
    ----------
    candidates : PlaceCandidates
    attended : float32 [L * L, C]
        z'_a, the features times their attention.
    """

    def __init__(self, candidates: PlaceCandidates, attended: Tensor) -> None:
        self.candidates, self._attended = candidates, attended
        self.forget()

    def forget(self) -> None:
        """Give back the memory of what is known."""
        attended = self._attended
        rows, columns, headings = self.candidates.grid.shape
        device, bands = attended.device, self.candidates.bands
        # As places become known; most of a tile's are never asked for.
        self._units = [attended.new_empty(0, attended.shape[1]) for _ in range(bands)]
        self._kept = [0] * bands  # rows of these in use
        self._first = torch.zeros(bands, rows * columns, dtype=torch.long, device=device)
        # How many descriptors of each candidate are not zero.
        self._present = torch.zeros(rows * columns, headings, device=device)
        self._known = np.zeros(rows * columns, dtype=bool)

    def learn(self, places: Integers) -> None:
        """Compute what is not known yet of some places."""
        new = places[~self._known[places]]
        if not len(new):
            return
        at = torch.from_numpy(new).to(self._attended.device)
        headings = np.arange(self._present.shape[1], dtype=np.intp)
        for band in range(len(self._units)):
            rows, slot = self.candidates.rows(band, new, headings)
            starts, cells, fractions = self.candidates.masks_of(band, rows)
            weights = fractions.float()
            learned = unit(
                F.embedding_bag(
                    cells, self._attended, starts[:-1], mode="sum", per_sample_weights=weights
                )
            )
            counts = self.candidates.counts(band, new)
            self._first[band, at] = self._kept[band] + torch.cumsum(counts, 0) - counts
            self._keep(band, learned)
            present = (torch.linalg.vector_norm(learned, dim=1) > 0).float()
            counted = present[slot // self.candidates.slices].sum(dim=1)
            self._present[at] += counted.view(len(new), -1)
        self._known[new] = True

    def _keep(self, band: int, learned: Tensor) -> None:
        kept, units = self._kept[band], self._units[band]
        end = kept + len(learned)
        if end > len(units):  # with room for more, so that few of them are copied often
            larger = units.new_empty(end + kept // 2, units.shape[1])
            larger[:kept] = units[:kept]
            self._units[band] = units = larger
        units[kept:end] = learned
        self._kept[band] = end

    def scores(self, ground: Tensor, places: Integers, headings: Integers) -> Tensor:
        """Scores of some headings [h] at some places [p], as `score_candidates`: float32 [p * h].

        Parameters
        ----------
        ground : float [1, N * B, C]
            d_g^{n,b}.
        places : int [p]
            Row * C + column.
        headings : int [h]
        """
        self.learn(places)
        ground = ground[0].float()
        parts = ground.unflatten(0, (-1, len(self._units)))
        at, turned = (torch.from_numpy(some).to(ground.device) for some in (places, headings))
        total = ground.new_zeros(len(places) * len(headings))
        for band, units in enumerate(self._units):
            _, slot = self.candidates.rows(band, places, headings)
            rows = spread(self._first[band, at], self.candidates.counts(band, places))
            dots = units.index_select(0, rows) @ parts[:, band].T
            total += dots.take(slot).sum(dim=1)
        return cosine(total, self._present[at][:, turned].flatten(), ground.flatten())
