"""``python -m benchmarks.refinement``: what refining an answer costs beside scoring its grid.

On the paper's shapes for VIGOR with VGG16 (512 channels, 32x32 cells, 16 slices, 21x21x64 poses)
and random features. Grid and refinement are timed in turn, in one process, in seconds of the
processor (of all cores together, so that other work does not stretch them); their ratio counts.
How near refined answers come to the truth is in ``examples/refined_floor.py``.
"""

import statistics
import tempfile
import time

import click
import torch
from slicematch.localization.modes import find_modes
from slicematch.localization.refinement import refine_modes
from slicematch.network.aggregation import unit
from slicematch.priors import PosePrior
from slicematch.scoring.candidates import Candidates
from slicematch.scoring.off_grid import PairScorer
from slicematch.scoring.scores import score_candidates

from slicemask import Frustum, PoseGrid, build_bank, open_bank

CHANNELS, CELLS, TILE_METRES = 512, 32, 72.5
GRID, FRUSTUM = PoseGrid(21, 21, 64), Frustum()
# Times the grid's seconds that a refined answer may take in all.
MOST = 2.0


@click.command()
@click.option("--runs", default=7, show_default=True, help="Of which the medians are printed.")
def main(runs: int) -> None:
    """Print the seconds of the grid, and of refining its modes."""
    with tempfile.TemporaryDirectory() as folder:
        bank = build_bank(GRID, FRUSTUM, CELLS, engine="rays", out=f"{folder}/bank.h5").path
        with open_bank(bank) as opened:
            candidates = Candidates.from_bank(opened)
    generator = torch.Generator().manual_seed(0)
    ground = unit(torch.randn(1, FRUSTUM.slices, CHANNELS, generator=generator))
    features = torch.randn(1, CHANNELS, CELLS, CELLS, generator=generator).relu()
    attention = torch.rand(1, FRUSTUM.slices, CELLS, CELLS, generator=generator)
    scorer = PairScorer(ground[0], features[0], attention[0], FRUSTUM)
    seconds: dict[str, list[float]] = {"grid": [], "fine": [], "continuous": []}
    for _ in range(runs + 1):  # the first one is not counted
        start = time.process_time()
        with torch.no_grad():
            scores = score_candidates(ground, features, attention, candidates)
        grid = candidates.scatter_to_grid(scores)[0].numpy()
        seconds["grid"].append(time.process_time() - start)
        for how in ("fine", "continuous"):
            start = time.process_time()
            modes, _ = find_modes(grid, GRID)
            refine_modes(scorer, modes, GRID, PosePrior(), how, TILE_METRES)
            seconds[how].append(time.process_time() - start)
    medians = {name: statistics.median(taken[1:]) for name, taken in seconds.items()}
    print(f"{GRID} poses scored, VGG16's shapes: {medians['grid']:.2f} s")
    for how in ("fine", "continuous"):
        ratio = 1 + medians[how] / medians["grid"]
        met = "met" if ratio <= MOST else "NOT MET"
        print(
            f"refined {how}: {medians[how]:.2f} s more, {ratio:.2f} times the grid alone in all "
            f"(target {MOST:g}: {met})"
        )


if __name__ == "__main__":
    main()
