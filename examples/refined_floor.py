"""What refinement alone costs: how near it comes to the truth when the scores peak there.

A grid has a floor: no answer is nearer to the truth than its nearest candidate. Refined answers
have none, if the refinement finds the peak. Here the peak is the truth by construction: the ground
descriptors are those that the aerial features themselves give at a random true pose, so its cosine
is 1, on a tile of random features that change from cell to cell. Everything else is what
`Localizer` does: the scores of a grid, its modes, and their refinement. For instance::

    python examples/refined_floor.py               # 1,000 poses, 72.5 m tile, 21x21x64
    python examples/refined_floor.py --count 100 --smooth 4
"""

import tempfile
from collections.abc import Callable

import click
import numpy as np
import torch
from slicematch.evaluation.metrics import PoseErrors, pose_errors
from slicematch.localization.modes import find_modes
from slicematch.localization.refinement import Refine, refine_modes
from slicematch.network.aggregation import aerial_descriptors
from slicematch.priors import PosePrior
from slicematch.scoring.candidates import Candidates
from slicematch.scoring.off_grid import PairScorer
from slicematch.scoring.scores import score_candidates
from torch.nn import functional as F  # noqa: N812

from slicemask import Frustum, PoseGrid, build_bank, open_bank, slice_masks
from slicemask.cli.output import progress_bar

CELLS, CHANNELS = 32, 16
# What an answer is to be within, metres and degrees.
NEAR_M, NEAR_DEG = 0.05, 0.2


def measure(
    count: int,
    grid: PoseGrid | None = None,
    frustum: Frustum | None = None,
    refine: tuple[Refine, ...] = ("none", "fine", "continuous"),
    smooth: int = 1,
    tile_metres: float = 72.5,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, PoseErrors]:
    """Errors of the answers for random true poses, by the way they are refined.

    Parameters
    ----------
    count : int
        How many poses, anywhere in the grid's extent.
    grid : PoseGrid
        Where the refinement starts; 21x21x64 by default. With one heading, that is the true one.
    frustum : Frustum
        A panorama in 16 slices by default.
    refine : tuple of str
        Which answers to measure.
    smooth : int
        Cells over which the features change.
    tile_metres : float
        Side of the tile.
    seed : int
        Of poses and features.
    progress : callable, optional
        Called with (poses done, poses in all).
    """
    grid, frustum = grid or PoseGrid(21, 21, 64), frustum or Frustum()
    with tempfile.TemporaryDirectory() as folder:
        bank = build_bank(grid, frustum, CELLS, engine="rays", out=f"{folder}/bank.h5").path
        with open_bank(bank) as opened:
            candidates = Candidates.from_bank(opened)
    rng, generator = np.random.default_rng(seed), torch.Generator().manual_seed(seed)
    u0, v0, u1, v1 = grid.extent
    truths = rng.uniform((u0, v0, 0.0), (u1, v1, 360.0 if grid.headings > 1 else 0.0), (count, 3))
    answers: dict[str, list[np.ndarray]] = {how: [] for how in refine}
    attention = torch.ones(1, frustum.slices, CELLS, CELLS)
    for done, truth in enumerate(truths, start=1):
        side = -(-CELLS // smooth) + 2
        noise = torch.randn(1, CHANNELS, side, side, generator=generator)
        features = F.interpolate(noise, scale_factor=smooth, mode="bicubic")
        features = features[..., smooth : smooth + CELLS, smooth : smooth + CELLS].contiguous()
        masks = torch.from_numpy(slice_masks(truth[None], frustum, CELLS, "rays")).float()
        ground = aerial_descriptors(features, attention, masks[None])[:, 0]
        scores = score_candidates(ground, features, attention, candidates)
        modes, _ = find_modes(candidates.scatter_to_grid(scores)[0].numpy(), grid)
        scorer = PairScorer(ground[0], features[0], attention[0], frustum)
        for how, found in answers.items():
            poses = modes
            if how != "none":
                prior = PosePrior(grid.extent)
                poses, _ = refine_modes(scorer, modes, grid, prior, how, tile_metres)
            found.append(poses[0])
        if progress is not None:
            progress(done, count)
    return {how: pose_errors(found, truths, tile_metres) for how, found in answers.items()}


def share_near(errors: PoseErrors) -> float:
    """Share of answers within 0.05 m and 0.2 degrees of the truth."""
    return float(np.mean((errors.place_m <= NEAR_M) & (errors.heading_deg <= NEAR_DEG)))


@click.command()
@click.option("--count", default=1000, show_default=True, help="True poses.")
@click.option("--grid", default="21x21x64", show_default=True, help="Where refinement starts.")
@click.option("--smooth", default=1, show_default=True, help="Cells over which features change.")
@click.option("--seed", default=0, show_default=True, help="Of poses and features.")
def main(count: int, grid: str, smooth: int, seed: int) -> None:
    """Print how near unrefined and refined answers come to true poses that the scores peak at."""
    with progress_bar("refining", "poses") as progress:
        measured = measure(count, PoseGrid.parse(grid), smooth=smooth, seed=seed, progress=progress)
    print(f"{count:,} poses on a 72.5 m tile, from {grid}, features over {smooth} cells")
    print("            place m: median    99 %  heading deg: median    99 %  within 5 cm, 0.2 deg")
    for how, errors in measured.items():
        place, heading = (
            (np.median(values), np.quantile(values, 0.99))
            for values in (errors.place_m, errors.heading_deg)
        )
        print(
            f"{how:<12}{place[0]:15.4f}{place[1]:8.4f}{heading[0]:20.4f}{heading[1]:8.4f}"
            f"{share_near(errors):14.1%}"
        )


if __name__ == "__main__":
    main()
