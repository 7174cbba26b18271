"""Calibration: what probabilities are worth, and the temperature that makes scores probabilities.

Temperature scaling: Guo, Pleiss, Sun, Weinberger, *On Calibration of Modern Neural Networks*, ICML
2017, section 4.2.
"""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize_scalar
from scipy.special import log_softmax

from slicemask.files import write_text
from slicematch.data import OWN
from slicematch.data.source import Part
from slicematch.errors import ConfigError, RunError
from slicematch.evaluation.measure import read_batches
from slicematch.evaluation.metrics import nearest_candidates
from slicematch.evaluation.samples import check_one_source, evenly_spaced_indices
from slicematch.localization.localizer import Localizer
from slicematch.runs.config import TrainConfig, check_workers
from slicematch.runs.folder import Checkpoint, RunFolder
from slicematch.runs.shipped import find_run

# Temperatures that are tried: from scores that settle everything to scores that settle nothing.
_LEAST, _MOST = 1e-4, 10.0
# Samples that a temperature is fitted to and scores of theirs that are kept (200 MB), at most.
MOST_SAMPLES = 1000
MOST_SCORES = 50_000_000
# With fewer samples than this, a temperature is a guess, and is held near what it would be without
# them: a few answers that happen to be right would make all probabilities 1.
FEW_SAMPLES = 30


def fit_temperature(scores: NDArray[np.float32], truths: NDArray[np.int64]) -> tuple[float, float]:
    """The temperature under which the true candidates are likeliest.

    Parameters
    ----------
    scores : float [n, K]
        Of the candidates; -inf leaves one out.
    truths : int [n]
        The candidate nearest to each truth.

    Returns
    -------
    temperature : float
        In [1e-4, 10].
    nll : float
        The mean negative log-likelihood of the true candidates under it.

    Raises
    ------
    ConfigError
        If there is no sample, or a score is NaN or infinite, or that of a true candidate -inf.
    """
    if len(scores) == 0:
        raise ConfigError("there are no samples to fit a temperature to; at least one is needed")
    # A NaN outdoes any maximum.
    if not (scores.max() < np.inf and scores[np.arange(len(truths)), truths].min() > -np.inf):
        raise ConfigError(
            "no temperature can be fitted: some scores are not finite numbers, as those of a run "
            "that has diverged; train again with a lower learning rate"
        )
    found = minimize_scalar(
        lambda log_temperature: mean_nll(scores, truths, math.exp(log_temperature)),
        bounds=(math.log(_LEAST), math.log(_MOST)),
        method="bounded",
        options={"xatol": 1e-3},
    )
    return float(math.exp(found.x)), float(found.fun)


def mean_nll(scores: NDArray[np.float32], truths: NDArray[np.int64], temperature: float) -> float:
    """Mean negative log-likelihood of true candidates under a temperature.

    Parameters
    ----------
    scores : float [n, K]
        Of the candidates; -inf leaves one out.
    truths : int [n]
        The candidate nearest to each truth.
    temperature : float
        Greater than 0.
    """
    return float(
        np.mean(
            [
                -log_softmax(row.astype(np.float64) / temperature)[truth]
                for row, truth in zip(scores, truths, strict=True)
            ]
        )
    )


@dataclass(frozen=True)
class Calibration:
    """What probabilities promised and what came true, of n estimates.

    Parameters
    ----------
    probability : float64 [n]
        That the camera is within reach of the estimate.
    within_reach : bool [n]
        Whether it is.
    in_credible_region : bool [n]
        Whether the true place's cell lies in the 95 % credible region: the fewest, likeliest
        places that hold this much (`slicematch.localization.probabilities.credible_region`).
    region_area : float64 [n]
        How much of the tile that region takes, in [0, 1].
    """

    probability: NDArray[np.float64]
    within_reach: NDArray[np.bool]
    in_credible_region: NDArray[np.bool]
    region_area: NDArray[np.float64]

    def summary(self) -> dict[str, float]:
        """The expected calibration error, and means of all."""
        return {
            "expected_error": calibration_error(self.probability, self.within_reach),
            "mean_probability": float(self.probability.mean()),
            "within_reach": float(self.within_reach.mean()),
            "coverage": float(self.in_credible_region.mean()),
            "region_area": float(self.region_area.mean()),
        }


def calibration_error(probabilities: ArrayLike, held: ArrayLike, bins: int = 10) -> float:
    """Expected calibration error: how far probabilities lie from the shares that came true.

    The mean over samples of | mean probability - share that held |, each taken over the samples
    of one of ``bins`` equal bins of probability (Guo and others, ICML 2017, eq. 3).

    Parameters
    ----------
    probabilities : float [n]
        What was promised, in [0, 1].
    held : bool [n]
        What came true.

    Examples
    --------
    >>> round(calibration_error([0.8, 0.8, 0.8, 0.8], [True, True, True, False]), 3)
    0.05
    """
    promised, held = np.asarray(probabilities, float), np.asarray(held, float)
    number = np.minimum((promised * bins).astype(int), bins - 1)
    gaps = np.bincount(number, promised - held, bins)
    return float(np.abs(gaps).sum() / len(promised))


def calibrate(
    run: str | Path,
    *,
    dataset: Any = None,
    grid: str | None = None,
    data: str | None = None,
    root: str | None = None,
    data_settings: Mapping[str, Any] | None = None,
    checkpoint: Checkpoint = "best",
    device: str = "auto",
    workers: int | None = None,
    cache: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Fit the temperature under which the true poses of the validation part are likeliest.

    Training does this at its end; for older runs, or for other data, it can be done at any time.
    Of another data set the training part is taken, none of which was trained on; augmentation is
    left out. Samples are taken evenly from the part: at most 1,000, and of many candidates fewer,
    so that there are at most 50 million scores (but one sample at least).

    Parameters
    ----------
    run : path
        A run folder. Its ``calibration.json`` is written, or replaced; an ensemble's
        ``ensemble.json``.
    dataset : torch.utils.data.Dataset, optional
        Validation samples of the program's own, as `slicematch.PoseDataset` documents them, instead
        of a part of the run's data set or of another one.
    grid : str, optional
        Candidates such as "21x21x64"; the run's test grid by default.
    data, root, data_settings
        Another data set, or where the data lie, if not where they lay in training: see
        `slicematch.evaluate`.
    checkpoint : {"best", "last"}
        Which weights.
    device : str
        "auto", "cpu", "cuda" or "cuda:N".
    workers : int, optional
        Processes that load images; the run's own number by default.
    cache : path, optional
        The folder of banks.
    progress : callable, optional
        Called with (samples done, samples in all).

    Returns
    -------
    content : dict
        What was written: the temperature, the mean negative log-likelihood ("nll") of the true
        candidates under it and under the loss's tau, and what it was fitted to, of which the name
        of the data set ("own" of a program's), of its root and of its part; with fewer than
        30 samples also a "caution": the temperature is then the geometric mean, weighed by
        their number, of the one that fits them and of the one of the run that training started
        from (or the loss's tau).

    Raises
    ------
    RunError
        If the run cannot be loaded.
    ConfigError, DatasetError
        If the run has no validation part, or its data cannot be read.
    """
    if find_run(run) != Path(run):
        raise ConfigError(
            f"{run} comes with slicemask, whose files stay as they are; copy it with slicemask "
            f"pack {run} --out DIR, and calibrate the copy"
        )
    check_one_source(dataset, data, root, data_settings)
    folder = RunFolder(Path(run))
    config = folder.load_config()
    workers = check_workers(config.workers if workers is None else workers)
    others = data not in (None, config.data)
    part: Part = "train" if others else "validation"
    if config.validation_fraction == 0 and dataset is None and not others:
        raise ConfigError(
            f"{run}: was trained with validation_fraction 0, so no sample is left to fit a "
            "temperature to; without one the loss's tau is used"
        )
    measured = config.with_data(data, root, data_settings)
    samples = (
        measured.dataset(part) if dataset is None else config.own_dataset(dataset, "validation")
    )
    ensemble = bool(folder.members())
    file = folder.ensemble_file if ensemble else folder.calibration_file
    try:
        folder.load_calibration(config, ensemble)
    except RunError:  # it is to be replaced, and no localizer loads beside it
        file.unlink()
    localizer = Localizer.load(
        run, grid=grid, checkpoint=checkpoint, device=device, cache=cache, refine="none"
    )
    localizer.config = measured
    candidates = localizer.within()
    most = min(MOST_SAMPLES, max(1, MOST_SCORES // len(candidates.poses)))
    chosen = evenly_spaced_indices(len(samples), most)
    scores = np.empty((len(chosen), len(candidates.poses)), dtype=np.float32)
    truths = np.empty(len(chosen), dtype=np.int64)
    read = 0
    faults: dict[str, str] = {}
    for batch in read_batches(samples, chosen, config, workers, faults):
        if batch is not None:
            rows = slice(read, read + len(batch["pose"]))
            found = localizer.scores(batch["ground"], batch["aerial"])
            scores[rows] = found.float().cpu().numpy()
            truths[rows] = nearest_candidates(candidates.poses, batch["pose"].numpy())
            read = rows.stop
        if progress is not None:
            progress(read, len(chosen))
    if read == 0:
        raise ConfigError(
            f"{run}: none of the {len(chosen)} samples can be read; mend them, or name the data's "
            f"root; first: {next(iter(faults.values()))}"
        )
    scores, truths = scores[:read], truths[:read]
    temperature, _ = fit_temperature(scores, truths)
    if read < FEW_SAMPLES:
        expected = localizer.temperature if ensemble else _expected_temperature(config)
        temperature = temperature ** (read / FEW_SAMPLES) * expected ** (1 - read / FEW_SAMPLES)
    content = {
        "temperature": temperature,
        "nll": mean_nll(scores, truths, temperature),
        "nll_of_tau": mean_nll(scores, truths, config.tau),
        "samples": read,
        "grid": str(localizer.grid),
        "checkpoint": checkpoint,
        "data": OWN if dataset is not None else measured.data,
    }
    if dataset is None:
        content |= {"root": Path(measured.root).name, "part": part}
    if ensemble:
        content["members"] = [member.temperature for member in localizer.members]
    if read < FEW_SAMPLES:
        content["caution"] = (
            f"fitted to only {read} validation samples, and held near {expected:.4g}, which "
            f"{_holder(config, ensemble)}; probabilities are rough "
            f"with fewer than {FEW_SAMPLES}: fit it to more"
        )
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    write_text(file, text, RunError)
    return content


def _holder(config: TrainConfig, ensemble: bool) -> str:
    """What has the temperature that was expected, for a sentence."""
    if ensemble:
        return "its networks come to"
    return f"{'the loss' if config.init is None else config.init} has"


def _expected_temperature(config: TrainConfig) -> float:
    """What a temperature is before any sample is seen: that of the run it started from, or tau."""
    if config.init is not None:
        start = RunFolder(find_run(config.init))
        try:
            fitted = start.load_calibration(start.load_config())
        except RunError:  # the run may be gone since
            fitted = None
        if fitted is not None:
            return fitted.temperature
    return config.tau
