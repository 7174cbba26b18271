"""A trained run as files that other runtimes run, checked against PyTorch before they are kept."""

import json
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from slicemask.files import atomic_folder, check_new_folder
from slicematch.data.images import denormalise
from slicematch.errors import ConfigError, RunError
from slicematch.evaluation.metrics import pose_errors
from slicematch.evaluation.samples import evenly_spaced_indices
from slicematch.export.formats import (
    SUFFIXES,
    Format,
    Function,
    Input,
    check_installed,
    read,
    write,
)
from slicematch.export.graphs import AerialGraph, BakedScoreGraph, GroundGraph, ScoreGraph
from slicematch.export.masks import MaskTables, mask_tables
from slicematch.export.variants import Variant, write_variant
from slicematch.localization.localizer import Localizer
from slicematch.runs.folder import Checkpoint, RunFolder
from slicematch.runs.shipped import find_run

log = logging.getLogger(__name__)

# How far results may lie from PyTorch's: scores, and values over the largest of them.
TOLERANCE = 1e-5
# Images whose activations an 8-bit encoder's ranges are taken from.
_CALIBRATION_IMAGES = 32

Arrays = Mapping[str, NDArray[Any]]
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class _Pairs:
    """Pairs of images as pixels, and their poses.

    Parameters
    ----------
    ground, aerial : uint8 [n, height, width, 3], [n, A, A, 3]
    poses : float64 [n, 3]
    tile_metres : float64 [n]
    """

    ground: NDArray[np.uint8]
    aerial: NDArray[np.uint8]
    poses: NDArray[np.float64]
    tile_metres: NDArray[np.float64]


def export(
    run: str | Path,
    out: str | Path,
    *,
    format: Format = "onnx",  # noqa: A002
    baked: bool = False,
    variants: Sequence[Variant] = (),
    grid: str | None = None,
    bank: str | Path | None = None,
    checkpoint: Checkpoint = "best",
    root: str | None = None,
    samples: int = 100,
    cache: str | Path | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Write a run as graphs: its encoders with their aggregation, and its scoring.

    Parameters
    ----------
    run : path or str
        A run folder, or the name of a run that comes with slicemask. Of an ensemble the first
        network is written.
    out : path
        The folder to write, new or empty. It appears whole or not at all.
    format : {"onnx", "torch-export"}
        Of the files.
    baked : bool
        Whether the file of scores holds the candidates' masks. By default they are inputs, so that
        priors and other candidates need no other file.
    variants : sequence of {"fp16", "int8"}
        Further files of the encoders in fewer bits, of the format onnx; what each costs in
        accuracy is measured on the run's test part.
    grid : str, optional
        Candidates such as "21x21x64"; the run's test grid by default.
    bank : path, optional
        A bank of candidates instead.
    checkpoint : {"best", "last"}
        Which weights.
    root : str, optional
        Where the data lie that variants are measured on, if not where they lay in training.
    samples : int
        How many of them, at most.
    cache : path, optional
        The folder of banks.
    progress : callable, optional
        Called with (steps done, steps in all).

    Returns
    -------
    content : dict
        What ``export.json`` holds: sizes of the images, frustum, temperature, how far the files'
        results lie from PyTorch's, and what the variants cost.

    Raises
    ------
    RunError
        If the run cannot be loaded, the folder holds something, or a file's results differ from
        PyTorch's by more than 1e-5.
    ConfigError, DatasetError
        If packages are missing, options do not fit each other, or the data cannot be read.
    """
    check_installed(format)
    target = check_new_folder(out, RunError)
    if variants and format != "onnx":
        raise ConfigError(f"variants are of the format onnx, and the format is {format}")
    if samples < 1:
        raise ConfigError(f"samples is {samples}; it must be at least 1")
    localizer = Localizer.load(
        run,
        bank,
        grid=grid,
        checkpoint=checkpoint,
        device="cpu",
        cache=cache,
        refine="none",
        alone=True,
    )
    others = RunFolder(find_run(run)).members()
    if others:
        log.warning(
            "%s is an ensemble, and the files hold its first network alone, which answers otherwise"
            " than all of them together; %s can be exported likewise",
            run,
            " and ".join(str(folder.path) for folder in others),
        )
    test = _read_pairs(localizer, "test", root, samples) if variants else None
    tuning = None
    if "int8" in variants:
        # No image that it is measured on may set its ranges.
        part = "validation" if localizer.config.validation_fraction > 0 else "train"
        tuning = _read_pairs(localizer, part, root, _CALIBRATION_IMAGES)
    with atomic_folder(target, RunError) as partial:
        return _write_all(localizer, partial, format, baked, variants, test, tuning, progress)


def _write_all(
    localizer: Localizer,
    folder: Path,
    format: Format,  # noqa: A002
    baked: bool,
    variants: Sequence[Variant],
    test: _Pairs | None,
    tuning: _Pairs | None,
    progress: Progress | None,
) -> dict[str, Any]:
    steps, done = 4 + 2 * len(variants), 0

    def step() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, steps)

    model, normalisation = localizer.model.eval(), localizer.config.normalisation()
    suffix = SUFFIXES[format]
    names = {part: f"{part}{suffix}" for part in ("ground", "aerial", "scores")}
    encoders = {
        "ground": GroundGraph(model, *normalisation).eval(),
        "aerial": AerialGraph(model, *normalisation).eval(),
    }
    example = _example(localizer)
    if progress is not None:
        progress(0, steps)
    for part, graph in encoders.items():
        pixels = torch.from_numpy(np.concatenate([example[part]] * 2))
        outputs = {"ground": "descriptors", "aerial": "features"}
        write(graph, [("images", pixels, {0: "images"})], (outputs[part], "images"),
              folder / names[part], format)  # fmt: skip
        step()
    tables = mask_tables(localizer.candidates)
    with torch.no_grad():
        encoded = [encoders[part](torch.from_numpy(example[part])) for part in encoders]
        scores = model.score(encoded[0], encoded[1], localizer.candidates)[0].numpy()
    _write_scores(
        ScoreGraph(model).eval(), encoded, tables, baked, folder / names["scores"], format
    )
    step()
    masks: dict[str, Any] = {} if baked else tables.arrays()
    kept: dict[str, dict[str, Any]] = {
        "candidates.npz": {"poses": localizer.candidates.poses, **masks},
        "example.npz": {**example, "scores": scores},
    }
    for name, arrays in kept.items():
        np.savez_compressed(folder / name, **arrays)

    files = {part: read(folder / name) for part, name in names.items()}
    differences = {
        part: _difference(part, files[part]({"images": example[part]}), wanted.numpy())
        for part, wanted in zip(encoders, encoded, strict=True)
    }
    differences["scores"] = _difference("scores", _scores(files, example, masks), scores)
    step()
    content = {
        **_described(localizer, format, baked),
        "files": names,
        "largest_difference": differences,
    }
    if test is not None:
        content["accuracy"] = {"samples": len(test.poses)}
        content["accuracy"]["fp32"] = _accuracy(files, test, masks, localizer)
    for variant in variants:
        assert test is not None
        names_in_bits = {part: f"{part}.{variant}{suffix}" for part in encoders}
        for part, name in names_in_bits.items():
            images = getattr(tuning, part) if variant == "int8" else np.empty(0, np.uint8)
            write_variant(folder / names[part], folder / name, variant, images)
        step()
        in_bits = files | {part: read(folder / name) for part, name in names_in_bits.items()}
        content["files"] |= {f"{part}.{variant}": n for part, n in names_in_bits.items()}
        content["accuracy"][variant] = _accuracy(in_bits, test, masks, localizer)
        step()
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    (folder / "export.json").write_text(text, encoding="utf-8")
    return content


def _write_scores(
    graph: ScoreGraph, encoded: list[Tensor], tables: MaskTables, baked: bool, path: Path,
    format: Format,  # noqa: A002
) -> None:  # fmt: skip
    pair: list[Input] = [("ground", encoded[0][0], {}), ("features", encoded[1][0], {})]
    if baked:
        tensors = {name: torch.from_numpy(array) for name, array in tables.arrays().items()}
        whole: nn.Module = BakedScoreGraph(graph, tensors)
        write(whole, pair, ("scores", "poses"), path, format)
        return
    # The graph does not depend on the candidates: it is traced with a few made-up masks.
    count = len(tables.cells)
    index: Input = ("index", torch.zeros(7, *tables.index.shape[1:], dtype=torch.int32), {0: "K"})
    inputs = [*pair, index]
    for stem, dtype in (("cells", torch.int32), ("weights", torch.float32)):
        for t in range(count):
            axes = {0: f"blocks{t}", 1: f"rows{t}", 2: f"width{t}"}
            inputs.append((f"{stem}{t}", torch.ones(2, 3, 5, dtype=dtype), axes))
    write(graph, inputs, ("scores", "poses"), path, format)


def _example(localizer: Localizer) -> dict[str, NDArray[np.uint8]]:
    """A pair of images without a model in the world, the same each time: coloured blocks."""
    rng = np.random.default_rng(0)
    config = localizer.config
    assert config.ground_size is not None
    sizes = {"ground": config.ground_size, "aerial": (config.aerial_size, config.aerial_size)}
    found = {}
    for part, (height, width) in sizes.items():
        blocks = rng.integers(0, 256, (1, -(-height // 16), -(-width // 16), 3), dtype=np.uint8)
        pixels = blocks.repeat(16, axis=1).repeat(16, axis=2)[:, :height, :width]
        found[part] = np.ascontiguousarray(pixels)
    return found


def _scores(files: Mapping[str, Function], pair: Arrays, masks: Arrays) -> NDArray[Any]:
    """Scores [K] of a pair of images [1, height, width, 3]."""
    ground = files["ground"]({"images": pair["ground"]})[0]
    features = files["aerial"]({"images": pair["aerial"]})[0]
    return files["scores"]({"ground": ground, "features": features, **masks})


def _difference(part: str, found: NDArray[Any], wanted: NDArray[Any]) -> float:
    """How far a file's result lies from PyTorch's, over its largest value if that is above 1."""
    difference = float(np.abs(found - wanted).max() / max(1.0, np.abs(wanted).max()))
    if not difference <= TOLERANCE:  # or is no number
        raise RunError(
            f"the exported {part} differ from PyTorch's by {difference:.2g}, more than "
            f"{TOLERANCE:g}, so nothing was written; try other versions of onnx and onnxruntime, "
            "and report this with the run's config.yaml"
        )
    return difference


def _read_pairs(localizer: Localizer, part: str, root: str | None, most: int) -> _Pairs:
    """Some pairs of a part of the run's data, evenly spaced."""
    dataset = localizer.config.with_data(root=root).dataset(part)  # images as they are
    read = [dataset[index] for index in evenly_spaced_indices(len(dataset), most)]
    found = [sample for sample in read if sample is not None]
    if not found:
        raise ConfigError(f"none of the {len(read)} samples of the {part} part can be read")
    normalisation = localizer.config.normalisation()
    ground, aerial = (
        np.stack([denormalise(sample[kind], *normalisation) for sample in found])
        for kind in ("ground", "aerial")
    )
    metres = [float(sample["metres_per_pixel"]) * dataset.aerial_size for sample in found]
    poses = np.stack([np.asarray(sample["pose"]) for sample in found])
    return _Pairs(ground, aerial, poses, np.array(metres))


def _accuracy(
    files: Mapping[str, Function], pairs: _Pairs, masks: Arrays, localizer: Localizer
) -> dict[str, float]:
    """Mean and median errors of the best candidates."""
    best = []
    candidates = localizer.within()
    allowed = candidates.grid_index.numpy()
    for ground, aerial in zip(pairs.ground, pairs.aerial, strict=True):
        pair = {"ground": ground[None], "aerial": aerial[None]}
        scores = _scores(files, pair, masks)[allowed]
        best.append(candidates.poses[int(scores.argmax())])
    errors = pose_errors(np.stack(best), pairs.poses, pairs.tile_metres)
    return {name: round(value, 3) for name, value in errors.summary(recalls=()).items()}


def _described(localizer: Localizer, format: Format, baked: bool) -> dict[str, Any]:  # noqa: A002
    """What a program that runs the files has to know."""
    config, frustum = localizer.config, localizer.frustum
    return {
        "format": format,
        "masks": "baked" if baked else "input",
        "ground_size": list(config.ground_size or ()),
        "aerial_size": config.aerial_size,
        "elevations": None if config.elevations is None else list(config.elevations),
        "projection": frustum.projection,
        "hfov_deg": frustum.hfov_deg,
        "slices": frustum.slices,
        "bands": list(frustum.bands),
        "cells": localizer.model.cells,
        "grid": str(localizer.grid),
        "temperature": localizer.temperature,
    }
