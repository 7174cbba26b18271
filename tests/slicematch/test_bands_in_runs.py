"""Runs whose slices are cut into bands: trained, resumed, evaluated and asked for answers."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from slicematch.errors import ConfigError, RunError
from slicematch.evaluation.evaluate import evaluate
from slicematch.localization.localizer import Localizer
from slicematch.runs.config import TrainConfig
from slicematch.runs.folder import RunFolder, build_model
from slicematch.scoring.off_grid import PairScorer
from slicematch.training.train import train

from slicemask.cli.main import main

TINY = {
    "encoder": "test_convnext", "weights": "none", "ground_size": (64, 64), "aerial_size": 64,
    "slices": 4, "train_grid": "3x3x4", "test_grid": "4x5x8", "epochs": 2, "batch_size": 2,
    "validation_fraction": 0.4, "heat_map_every": 0, "workers": 0, "accelerator": "cpu",
}  # fmt: skip
CASES = {
    "geometry, shared attention": {"cross_view_attention": False, "elevations": (-45.0, 45.0)},
    "learned rows, attention a band": {"band_rows": "learned", "grid_jitter": True},
    "the paper's descriptors": {
        "band_values": False, "band_weights": False, "near_negatives": 3, "bands": (0.1, 0.3),
    },
}  # fmt: skip


@pytest.fixture(scope="module", params=CASES)
def banded(request, vigor, tmp_path_factory, cache):
    """A banded run on a VIGOR tree."""
    settings = {"bands": (6.0, 18.0), **TINY, **CASES[request.param]}
    config = TrainConfig(
        data="vigor", root=str(vigor.root), data_settings={"cities": ["Chicago"]}, **settings
    )
    out = tmp_path_factory.mktemp("runs") / "vigor"
    return train(config, out, cache=cache, progress=False)


def test_a_run_keeps_its_bands_and_answers(banded, vigor, cache, images):
    config = RunFolder(banded).load_config()
    side = 640 * 0.111262
    expected = (0.1, 0.3) if config.bands == (0.1, 0.3) else (6 / side, 18 / side)
    assert config.frustum().bands == pytest.approx(expected, abs=5e-5)
    assert config.camera_height_m == 2.5
    localizer = Localizer.load(banded, cache=cache, device="cpu")
    assert localizer.candidates.index.shape == (160, 4, 3)
    estimates = {
        refine: localizer.localize(*images, refine=refine, place_prior=(0.5, 0.5, 0.4))
        for refine in ("none", "mean", "fine", "continuous")
    }
    best = estimates["none"].score
    assert np.isfinite(best)
    for refine in ("fine", "continuous"):
        assert estimates[refine].score >= best - 1e-6
    assert estimates["mean"].probabilities.sum() == pytest.approx(1.0)
    assert localizer.localize(*images, heading_prior=(0.0, 20.0)).pose[2] % 340 <= 20


def test_scores_off_the_grid_are_those_on_it(banded, cache, images):
    localizer = Localizer.load(banded, cache=cache, device="cpu")
    estimate = localizer.localize(*images, refine="none", heading_prior=(0.0, 180.0))
    with torch.no_grad():
        ground = localizer.encode_ground(images[0])
        aerial = localizer.encode_aerial(images[1]).features
        attention = localizer.model.attend(aerial, ground)
        scorer = PairScorer(ground[0], aerial[0], attention[0], localizer.frustum)
        found = scorer(torch.from_numpy(localizer.grid.poses()))
    assert np.abs(found.numpy() - estimate.scores.ravel()).max() <= 1e-5


def test_a_run_is_evaluated_and_calibrated(banded, cache, tmp_path):
    evaluation, folder = evaluate(banded, cache=cache, device="cpu", out=tmp_path / "out")
    assert len(evaluation.names) == 5
    assert json.loads((folder / "result.json").read_text())["calibrated"]


def test_a_resumed_run_ends_as_one_that_was_not_stopped(banded, cache, tmp_path):
    config = RunFolder(banded).load_config()
    halfway = replace(config, epochs=1)
    again = train(halfway, tmp_path / "again", cache=cache, progress=False)
    train(config, again, resume=True, cache=cache, progress=False)
    weights = [RunFolder(run).load_model("last")[1].state_dict() for run in (banded, again)]
    for name, value in weights[0].items():
        assert torch.equal(value, weights[1][name]), name
    with pytest.raises(RunError, match="was trained with bands"):
        train(replace(config, bands=(0.2, 0.25)), again, resume=True, cache=cache, progress=False)


def test_kitti_has_bands_by_depth(make_kitti_tree, tmp_path, cache):
    tree = make_kitti_tree(tmp_path / "kitti", 6)
    settings = {**TINY, "ground_size": (32, 64), "validation_fraction": 0.0, "epochs": 1}
    config = TrainConfig(
        data="kitti", root=str(tree.root), heading_half_width_deg=10, bands=(8.0, 20.0),
        elevations=(-14.0, 4.0), **settings,
    )  # fmt: skip
    run = train(config, tmp_path / "run", cache=cache, progress=False)
    loaded = RunFolder(run).load_config()
    assert loaded.camera_height_m == 1.65
    assert loaded.frustum().projection == "pinhole"
    assert len(loaded.frustum().bands) == 2
    evaluation, _ = evaluate(run, cache=cache, device="cpu", out=tmp_path / "out", refine="fine")
    assert len(evaluation.names) == 6


def test_elevations_beyond_a_camera_s_are_refused(make_kitti_tree, tmp_path, cache):
    tree = make_kitti_tree(tmp_path / "kitti", 4)
    config = TrainConfig(
        data="kitti", root=str(tree.root), elevations=(-45.0, 45.0), max_bad_samples=0, **TINY
    )
    with pytest.raises(ValueError, match=r"elevations are -45,45; .* shows -15\.\d+ to 13\.\d+"):
        train(config, tmp_path / "run", cache=cache, progress=False)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"bands": (12, 6)}, "bands is .* increasing ranges above 0"),
        ({"bands": (0,)}, "bands is"),
        ({"bands": ("x",)}, "bands is .* a list of finite numbers"),
        ({"elevations": (45, -45)}, "elevations is"),
        ({"elevations": (-100, 45)}, "elevations is"),
        ({"camera_height_m": 0}, "camera_height_m is 0.0; it must be greater than 0"),
        ({"band_rows": "guess"}, "band_rows is 'guess'; it must be one of geometry, learned"),
    ],
)
def test_settings_that_are_invalid(settings, words):
    with pytest.raises(ConfigError, match=words):
        TrainConfig(data="vigor", root="x", **settings)


def test_metres_and_shares():
    config = TrainConfig(data="vigor", root="x", bands=(6, 12, 24), hfov_deg=360)
    with pytest.raises(ConfigError, match="tile_side_m, the tiles' side, is not known"):
        config.frustum()
    known = replace(config, tile_side_m=80.0)
    assert known.frustum().bands == (0.075, 0.15, 0.3)
    assert known.band_ranges_m() == (6.0, 12.0, 24.0)
    shares = replace(known, bands=(0.1, 0.25))
    assert shares.frustum().bands == (0.1, 0.25)
    assert shares.band_ranges_m() == (8.0, 20.0)


def test_without_bands_the_model_is_the_paper_s(vigor):
    config = TrainConfig(data="vigor", root=str(vigor.root), **TINY)
    assert config.bands == ()
    assert config.camera_height_m is None
    names = build_model(config).state_dict()
    assert not [name for name in names if "values" in name or "weight_" in name]


def test_the_command_takes_bands(tmp_path):
    arguments = ["train", "--data=vigor", f"--root={tmp_path}/no", "--bands=6,12,24",
                 "--elevations=-45,45", "--band-rows=learned", "--no-band-values"]  # fmt: skip
    done = CliRunner().invoke(main, arguments)
    assert "there is no such folder" in done.stderr
    done = CliRunner().invoke(main, ["train", "--data=vigor", "--root=x", "--bands=6;12"])
    assert done.exit_code == 2
    assert "'6;12' is not numbers separated by commas, such as 6,12,24" in done.stderr
