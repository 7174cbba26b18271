"""Checking a bank: its masks recomputed independently, by the other engine."""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slicemask.bank.read import Bank
from slicemask.errors import SpecError
from slicemask.geometry.masks import Engine, slice_masks
from slicemask.interrupts import CancelCheck, run_cancellable
from slicemask.threads import thread_count

# Half a unit in the last place of a float32 below 1, and what two engines may differ by.
TOLERANCE = 2.0**-25 + 1e-9
# A circle between bands is a polygon to one of them.
CIRCLE_TOLERANCE = 2.0**-25 + 1e-6

_BATCH_VALUES = 1 << 20


@dataclass(frozen=True)
class Verification:
    """What a verification found.

    Parameters
    ----------
    engine : str
        The engine that recomputed the masks: not the bank's.
    poses, masks : int
        How many poses were taken, and masks compared.
    largest_difference : float
        Between a stored fraction and the recomputed one.
    wrong_masks : int
        Masks that differ by more than ``tolerance`` somewhere.
    first_wrong : tuple of int, optional
        Pose and slice of the first of them, and its band if slices have bands.
    tolerance : float
        What rounding to float32 and the engines' own differences explain.
    """

    engine: Engine
    poses: int
    masks: int
    largest_difference: float
    wrong_masks: int
    first_wrong: tuple[int, ...] | None
    tolerance: float = TOLERANCE

    @property
    def passed(self) -> bool:
        """Whether every compared mask is right."""
        return self.wrong_masks == 0


def verify_bank(
    bank: Bank,
    sample: int | None = 2000,
    jobs: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Verification:
    """Recompute a bank's masks from its poses with the other engine, and compare.

    Neither symmetry nor equality is used: each slice of each pose is computed on its own, so
    that the index and the permutations are checked as much as the geometry.

    Parameters
    ----------
    bank : Bank
        An open bank.
    sample : int or None
        Compare at least this many masks, of poses drawn at random (the same ones each time);
        None compares all.
    jobs : int
        Threads; as many as there are processors by default.
    progress : callable, optional
        Called with (poses done, poses in all), from the thread that compares.

    Returns
    -------
    verification : Verification
        What was compared and found; see ``passed``.

    Raises
    ------
    BankFormatError
        If the bank cannot be read, or its poses are not those its spec names.
    SpecError
        If the sample is less than 1.
    """
    if sample is not None and sample < 1:
        raise SpecError(f"sample is {sample!r}; it must be at least 1")
    spec = bank.spec
    masks, cells = math.prod(spec.frustum.mask_axes), spec.cells
    circles = bool(spec.frustum.bands) and spec.frustum.projection == "equirectangular"
    tolerance = CIRCLE_TOLERANCE if circles else TOLERANCE
    poses = bank.poses  # which reading holds against the spec
    engine: Engine = "rays" if spec.engine == "shapely" else "shapely"
    count = len(bank) if sample is None else min(len(bank), -(-sample // masks))
    chosen = np.arange(len(bank))
    if count < len(bank):
        chosen = np.sort(np.random.default_rng(0).choice(len(bank), count, replace=False))
    matrix = bank.csr() if sample is None else None

    def differences(some: NDArray[np.int64]) -> NDArray[np.float64]:
        """Largest difference in each mask of some poses, [k, N] or [k, N, B]."""
        expected = slice_masks(poses[some], spec.frustum, cells, engine)
        if matrix is None:
            stored = bank.masks(some)
        else:
            stored = matrix[bank.index[some].ravel()].toarray().reshape(expected.shape)
        return np.asarray(np.abs(stored - expected).max(axis=(-2, -1)))

    step = max(1, _BATCH_VALUES // (masks * cells**2))
    parts = [chosen[start : start + step] for start in range(0, count, step)]

    def compare(check: CancelCheck) -> Verification:
        largest, wrong, first, done = 0.0, 0, None, 0
        pool = ThreadPoolExecutor(min(thread_count(jobs), len(parts)))
        try:
            for part, difference in zip(parts, pool.map(differences, parts), strict=True):
                check()
                largest = max(largest, float(difference.max()))
                faulty = np.argwhere(~(difference <= tolerance))
                wrong += len(faulty)
                if len(faulty) and first is None:
                    first = (int(part[faulty[0, 0]]), *map(int, faulty[0, 1:]))
                done += len(part)
                if progress:
                    progress(done, count)
        finally:
            pool.shutdown(cancel_futures=True)
        return Verification(engine, count, count * masks, largest, wrong, first, tolerance)

    return run_cancellable(compare)
