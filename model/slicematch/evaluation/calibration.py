"""Fitting the temperature of a run's scores on its validation part."""

import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.utils.data import Subset

from slicemask.files import write_text
from slicematch.data.dataset import BadSampleLog, collate
from slicematch.data.loading import PoseLoader
from slicematch.errors import ConfigError, RunError
from slicematch.evaluation.evaluate import spread
from slicematch.evaluation.metrics import nearest_candidates
from slicematch.localization.localizer import Localizer
from slicematch.localization.probabilities import fit_temperature, mean_nll
from slicematch.runs.config import check_workers
from slicematch.runs.folder import Checkpoint, RunFolder

# Samples that a temperature is fitted to and scores of theirs that are kept (200 MB), at most.
MOST_SAMPLES = 1000
MOST_SCORES = 50_000_000


def calibrate(
    run: str | Path,
    *,
    grid: str | None = None,
    root: str | None = None,
    checkpoint: Checkpoint = "best",
    device: str = "auto",
    workers: int | None = None,
    cache: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Fit the temperature under which the true poses of the validation part are likeliest.

    Training does this at its end; for older runs it can be done at any time. Samples are taken
    evenly from the validation part: at most 1,000, and of many candidates fewer, so that there
    are at most 50 million scores (but one sample at least).

    Parameters
    ----------
    run : path
        A run folder. Its ``calibration.json`` is written, or replaced.
    grid : str, optional
        Candidates such as "21x21x64"; the run's test grid by default.
    root : str, optional
        Where the data lie, if not where they lay in training.
    checkpoint, device, workers, cache, progress
        As in `slicematch.evaluation.evaluate.evaluate`.

    Returns
    -------
    content : dict
        What was written: the temperature, the mean negative log-likelihood ("nll") of the true
        candidates under it and under the loss's tau, and what it was fitted to.

    Raises
    ------
    RunError
        If the run cannot be loaded.
    ConfigError, DatasetError
        If the run has no validation part, or its data cannot be read.
    """
    folder = RunFolder(Path(run))
    config = folder.load_config()
    workers = check_workers(config.workers if workers is None else workers)
    if config.validation_fraction == 0:
        raise ConfigError(
            f"{run}: was trained with validation_fraction 0, so no sample is left to fit a "
            "temperature to; without one the loss's tau is used"
        )
    try:
        folder.load_calibration(config)
    except RunError:  # it is to be replaced, and no localizer loads beside it
        folder.calibration_file.unlink()
    localizer = Localizer.load(
        run, grid=grid, checkpoint=checkpoint, device=device, cache=cache, refine="none"
    )
    dataset = config.dataset("validation", root)
    candidates = localizer.within()
    most = min(MOST_SAMPLES, max(1, MOST_SCORES // len(candidates.poses)))
    chosen = spread(len(dataset), most)
    loader = PoseLoader(
        Subset(dataset, chosen),
        config.batch_size,
        num_workers=workers,
        collate_fn=collate,
    )
    scores = np.empty((len(chosen), len(candidates.poses)), dtype=np.float32)
    truths = np.empty(len(chosen), dtype=np.int64)
    read = 0
    with tempfile.TemporaryDirectory() as scratch:
        log = BadSampleLog(Path(scratch, "bad_samples.jsonl"), config.max_bad_samples)
        dataset.bad_sample_log = log
        for batch in loader:
            if batch is not None:
                images = (batch[kind].to(localizer.device) for kind in ("ground", "aerial"))
                rows = slice(read, read + len(batch["pose"]))
                with torch.no_grad():
                    scores[rows] = localizer.model(*images, candidates).float().cpu().numpy()
                truths[rows] = nearest_candidates(candidates.poses, batch["pose"].numpy())
                read = rows.stop
            if progress is not None:
                progress(read, len(chosen))
    if read == 0:
        raise ConfigError(f"{run}: none of the {len(chosen)} validation samples can be read")
    scores, truths = scores[:read], truths[:read]
    temperature, nll = fit_temperature(scores, truths)
    content = {
        "temperature": temperature,
        "nll": nll,
        "nll_of_tau": mean_nll(scores, truths, config.tau),
        "samples": read,
        "grid": str(localizer.grid),
        "checkpoint": checkpoint,
    }
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    write_text(folder.calibration_file, text, RunError)
    return content
