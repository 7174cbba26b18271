"""Run folders of older versions stay readable: a tiny one of each is kept and must answer alike.

``data/vigor_run_v1`` was trained with version 0.1 on a generated city of 12 panoramas, and stripped
of what only resuming takes.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from slicematch.localization.localizer import Localizer
from slicematch.runs.config import TrainConfig

OLD = Path(__file__).parent / "data" / "vigor_run_v1"
# What version 0.1 answered for the images below: u, v, heading_deg, score. Its means were
# taken around the best candidate, today's are where they are likeliest.
ANSWERS = {
    "none": (0.7, 0.9, 45.0, 0.23428434133529663),
    "mean": (0.2954199088818331, 0.5083211901911704, 48.55993495799726, 0.1655072271823883),
    "fine": (0.6562499993480742, 0.8585937494412065, 49.015625, 0.24104100465774536),
}


def images():
    random = np.random.default_rng(7)
    ground = random.integers(0, 256, (32, 64, 3), dtype=np.uint8)
    return ground, random.integers(0, 256, (64, 64, 3), dtype=np.uint8)


def test_the_settings_of_an_old_run_have_todays_names():
    config = TrainConfig.load(OLD / "config.yaml")
    assert config.heading_half_width_deg == 90.0
    assert config.max_bad_samples == 10
    assert config.data_settings == {"labels": "corrected", "cities": ["NewYork"]}
    assert (config.projection, config.prior_centre_deg) == ("equirectangular", 0.0)
    # Version 0.1 knew no other mean and deviation than ImageNet's.
    assert config.normalisation() == ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
    assert config.image_mean is not None


def test_settings_that_an_old_kitti_run_kept_for_vigor_are_left_behind():
    old = yaml.safe_load((OLD / "config.yaml").read_text())
    old |= {"data": "kitti", "splits": "lists", "hfov_deg": 81.5, "cities": None}
    config = TrainConfig.from_dict(old)
    assert config.data_settings == {"split_dir": "lists"}
    assert config.heading_prior() == (90.0, 90.0)


@pytest.mark.parametrize(
    ("old", "new"),
    [("heading_prior_deg", "heading_half_width_deg"), ("bad_samples", "max_bad_samples")],
)
def test_old_names_are_read_in_a_file_of_ones_own_and_new_ones_go_first(old, new):
    shared = {"data": "vigor", "root": "data"}
    assert getattr(TrainConfig.from_dict({**shared, old: 5}), new) == 5
    assert getattr(TrainConfig.from_dict({**shared, old: 5, new: 7}), new) == 7
    # Whoever writes a file today gets the encoder's own mean.
    assert TrainConfig.from_dict({**shared, old: 5}).image_mean is None


@pytest.mark.parametrize("refine", list(ANSWERS))
def test_an_old_run_answers_as_it_did(tmp_path, refine):
    localizer = Localizer.load(OLD, cache=tmp_path, device="cpu")
    assert localizer.calibrated
    assert localizer.temperature == 0.3289378011329101
    estimate = localizer.localize(*images(), refine=refine)
    assert [*estimate.pose, estimate.score] == pytest.approx(ANSWERS[refine], rel=0, abs=1e-5)


def test_loading_a_run_imports_no_data_set(tmp_path):
    """A run folder holds all that a localizer takes."""
    run = tmp_path / "run"
    (run / "checkpoints").mkdir(parents=True)
    TrainConfig.load(OLD / "config.yaml").save(run / "config.yaml")
    (run / "checkpoints" / "best.ckpt").write_bytes(
        (OLD / "checkpoints" / "best.ckpt").read_bytes()
    )
    code = (
        "import sys; from slicematch.localization.localizer import Localizer; "
        f"Localizer.load({str(run)!r}, cache={str(tmp_path)!r}, device='cpu'); "
        "print([m for m in sys.modules if m in "
        "('slicematch.data.vigor', 'slicematch.data.kitti', 'slicematch.data.dataset')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
