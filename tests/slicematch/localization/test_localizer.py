"""Localising with a run, and its evaluation: what they give, not how well a model is trained."""

import json
import re
import shutil

import numpy as np
import pytest
import torch
from PIL import Image
from slicematch.errors import ConfigError, RunError
from slicematch.evaluation.timing import time_run
from slicematch.localization.estimate import Estimate
from slicematch.localization.likeliest import likeliest_poses
from slicematch.localization.localizer import Localizer
from slicematch.localization.modes import Mode, within_reach
from slicematch.scoring.scores import score_masks

from slicemask import Frustum, PoseGrid, build_bank, slice_masks
from slicemask.errors import ImageError


def test_an_unrefined_estimate_is_the_best_candidate(localizer, images):
    estimate = localizer.localize(*images, refine="none")
    assert estimate.scores.shape == (4, 5, 8)
    assert estimate.heat_map.shape == (4, 5)
    best = np.unravel_index(estimate.scores.argmax(), estimate.scores.shape)
    np.testing.assert_array_equal(
        estimate.pose, estimate.grid.poses()[np.ravel_multi_index(best, estimate.scores.shape)]
    )
    assert estimate.score == estimate.scores[best] == estimate.heat_map.max()
    assert -1 <= estimate.scores.min() < estimate.score <= 1


def test_a_pair_scorer_scores_as_the_answer_is_scored(localizer, images):
    ground, tile = images
    estimate = localizer.localize(ground, tile, refine="none")
    encoded = localizer.encode_aerial(tile)
    scorer = localizer.pair_scorer(localizer.encode_ground(ground), encoded)
    contributions = scorer.contributions(torch.from_numpy(estimate.pose[None]))
    assert contributions.shape == (1, 4, 1)
    assert contributions.sum().item() == pytest.approx(estimate.score, abs=1e-5)


def test_it_scores_as_the_model_does_on_the_data_sets_samples(localizer, run, images):
    from dataclasses import replace

    aligned = replace(localizer.config, heading_half_width_deg=0.0)
    sample = aligned.dataset("test")[0]
    with torch.no_grad():
        scores = localizer.model(
            sample["ground"][None], sample["aerial"][None], localizer.candidates
        )
    expected = localizer.candidates.scatter_to_grid(scores)[0].numpy()
    np.testing.assert_allclose(localizer.localize(*images).scores, expected, atol=1e-5)


def test_paths_pictures_and_arrays_give_the_same(localizer, images):
    opened = [Image.open(path).convert("RGB") for path in images]
    expected = localizer.localize(*images).scores
    np.testing.assert_array_equal(localizer.localize(*opened).scores, expected)
    np.testing.assert_array_equal(localizer.localize(*map(np.asarray, opened)).scores, expected)


def test_a_tile_is_encoded_once_for_many_ground_images(run, cache, vigor, images):
    localizer = Localizer.load(run, cache=cache, device="cpu")
    encoded = []
    hook = localizer.model.aerial_encoder.register_forward_hook(lambda *_: encoded.append(1))
    tile = localizer.encode_aerial(images[1])
    panoramas = sorted((vigor.root / "Chicago" / "panorama").iterdir())
    estimates = [localizer.localize(panorama, tile) for panorama in panoramas]
    assert len(encoded) == 1
    for panorama, estimate in zip(panoramas, estimates, strict=True):
        expected = localizer.localize(panorama, images[1])
        np.testing.assert_array_equal(estimate.scores, expected.scores)
        np.testing.assert_array_equal(estimate.pose, expected.pose)
    assert len(encoded) == 1 + len(panoramas)
    hook.remove()


def test_candidates_of_a_prior_are_planned_once(run, cache):
    localizer = Localizer.load(run, cache=cache, device="cpu")
    some = localizer.within((10, 60))
    assert localizer.within((10.0, 60.0)) is some
    assert localizer.within(np.array([10.0, 60.0])) is some
    assert localizer.within((10, 60), (0.5, 0.5, 0.4)) is not some
    assert localizer.within() is localizer.candidates
    for centre in range(0, 360, 15):  # as many as come, only a few are kept
        localizer.within((centre, 60))
    assert localizer.within((10, 60)) is not some
    assert len(localizer.within((10, 60)).poses) == len(some.poses)


def test_priors_leave_candidates_out(localizer, images):
    whole = localizer.localize(*images)
    near_north = localizer.localize(*images, heading_prior=(350, 60), refine="none")
    assert np.isfinite(near_north.scores).any(axis=(0, 1)).tolist() == [
        True, True, False, False, False, False, False, True,
    ]  # fmt: skip
    corner = localizer.localize(*images, place_prior=(0.1, 0.125, 0.05), refine="none")
    assert np.isfinite(corner.heat_map).sum() == 1
    np.testing.assert_array_equal(corner.pose[:2], [0.1, 0.125])
    kept = np.isfinite(near_north.scores)
    np.testing.assert_allclose(near_north.scores[kept], whole.scores[kept], atol=1e-6)


def test_a_bank_of_ones_own(run, cache, images, tmp_path):
    frustum = Frustum(360, 4)
    bank = build_bank(PoseGrid.parse("2x2x4"), frustum, 4, out=tmp_path / "my.h5").path
    assert Localizer.load(run, bank, device="cpu").localize(*images).scores.shape == (2, 2, 4)

    other = build_bank(PoseGrid.parse("2x2x4"), Frustum(360, 8), 4, out=tmp_path / "o.h5").path
    with pytest.raises(ConfigError, match=r"o.h5: holds 2x2x4.* the run needs hfov 360"):
        Localizer.load(run, other)
    poses = build_bank([[0.5, 0.5, 0.0]], frustum, 4, out=tmp_path / "list.h5").path
    with pytest.raises(ConfigError, match="holds a list of poses"):
        Localizer.load(run, poses)
    with pytest.raises(ConfigError, match="either a bank or a grid"):
        Localizer.load(run, bank, grid="2x2x4")
    with pytest.raises(ConfigError, match="device 'abacus' cannot be used"):
        Localizer.load(run, cache=cache, device="abacus")


def test_pictures_that_are_invalid(localizer, images):
    with pytest.raises(ImageError, match="an aerial tile must be square"):
        localizer.localize(images[0], images[0])
    with pytest.raises(ImageError, match="must be at least 2 times as wide as high"):
        localizer.localize(images[1], images[1])
    with pytest.raises(ImageError, match="nowhere"):
        localizer.localize("nowhere.jpg", images[1])
    with pytest.raises(ImageError, match=r"an array float64 with shape \[4, 4, 2\]"):
        localizer.localize(images[0], np.zeros((4, 4, 2)))
    for height, width in ((0, 0), (0, 8), (8, 0)):
        empty = np.zeros((height, width, 3), np.uint8)
        with pytest.raises(ImageError, match=rf"shape \[{height}, {width}, 3\]"):
            localizer.localize(images[0], empty)
        with pytest.raises(ImageError, match=rf"shape \[{height}, {width}, 3\]"):
            localizer.localize(empty, images[1])


def test_encoders_in_fewer_bits(run, cache, localizer, images):
    mixed = Localizer.load(run, cache=cache, device="cpu", precision="bf16-mixed")
    whole, rough = (each.encode_aerial(images[1]).features for each in (localizer, mixed))
    assert rough.dtype == torch.float32
    assert 0 < (rough - whole).norm() / whole.norm() < 0.02
    scores = mixed.localize(*images).scores
    np.testing.assert_allclose(scores, localizer.localize(*images).scores, atol=0.02)


@pytest.mark.parametrize(
    ("precision", "said"),
    [
        ("8-mixed", "precision is '8-mixed'; it must be one of 32-true, 16-"),
        ("16-mixed", "precision '16-mixed' is for GPUs, .* choose bf16-mixed"),
    ],
)
def test_precisions_that_cannot_be(run, cache, precision, said):
    with pytest.raises(ConfigError, match=said):
        Localizer.load(run, cache=cache, device="cpu", precision=precision)


@pytest.mark.parametrize("refine", ["fine", "continuous"])
def test_a_refined_estimate_scores_no_less(localizer, images, refine):
    grid = localizer.localize(*images, refine="none")
    refined = localizer.localize(*images, refine=refine)
    np.testing.assert_array_equal(refined.scores, grid.scores)
    assert refined.score > grid.score
    assert (refined.pose != grid.pose).any()
    # The score is that of the pose's own exact masks.
    masks = slice_masks(torch.from_numpy(refined.pose)[None], localizer.frustum, 4, "rays")
    with torch.no_grad():
        ground = localizer.encode_ground(images[0])
        aerial = localizer.encode_aerial(images[1]).features
        attention = localizer.model.attend(aerial, ground)
        score = score_masks(ground, aerial, attention, masks[None])
    assert refined.score == pytest.approx(score.item(), abs=1e-6)
    assert [mode.score for mode in refined.modes] == sorted(
        (mode.score for mode in refined.modes), reverse=True
    )


@pytest.mark.parametrize("refine", ["mean", "fine", "continuous"])
def test_a_refined_estimate_keeps_to_the_priors(localizer, images, refine):
    for mode in localizer.localize(*images, (0, 20), (0.1, 0.125, 0.05), refine=refine).modes:
        assert abs((mode.pose[2] + 180) % 360 - 180) <= 20 + 1e-9
        assert np.hypot(mode.pose[0] - 0.1, mode.pose[1] - 0.125) <= 0.05 + 1e-9
    aligned = localizer.localize(*images, heading_prior=(45, 0), refine=refine)
    assert {mode.pose[2] for mode in aligned.modes} == {45.0}
    assert len({mode.pose[0] for mode in aligned.modes}) > 1


def test_a_mean_estimate_is_the_likeliest_pose(localizer, images):
    estimate = localizer.localize(*images, refine="mean")
    expected = likeliest_poses(estimate.probabilities, estimate.grid)
    found = np.array([mode.pose for mode in estimate.modes])
    np.testing.assert_allclose(found[:, :2], expected[:, :2], atol=1e-12)
    np.testing.assert_allclose((found - expected)[:, 2] % 360, 0, atol=1e-9)
    assert estimate.modes[0].probability == max(mode.probability for mode in estimate.modes)
    aligned = localizer.localize(*images, heading_prior=(45, 0), refine="mean")
    assert {mode.pose[2] for mode in aligned.modes} == {45.0}


@pytest.mark.parametrize("refine", ["none", "mean", "fine", "continuous"])
def test_modes_come_best_first_and_apart(localizer, refine):
    rng = np.random.default_rng(0)
    for _ in range(10):
        ground, aerial = (
            rng.integers(0, 256, (*size, 3), np.uint8) for size in ((32, 64), (64, 64))
        )
        estimate = localizer.localize(ground, aerial, refine=refine)
        measure = "probability" if refine == "mean" else "score"
        values = [getattr(mode, measure) for mode in estimate.modes]
        assert values == sorted(values, reverse=True)
        poses = np.array([mode.pose for mode in estimate.modes])
        for m, pose in enumerate(poses):
            assert not within_reach(pose, np.delete(poses, m, axis=0), estimate.grid).any()


@pytest.mark.parametrize("caller", [torch.no_grad, torch.inference_mode])
@pytest.mark.parametrize("refine", ["none", "mean", "fine", "continuous"])
def test_the_caller_need_not_keep_gradients(localizer, run, cache, images, refine, caller):
    expected = localizer.localize(*images, refine=refine)
    other = Localizer.load(run, cache=cache, device="cpu")
    with caller():
        inside = other.localize(*images, refine=refine)
    # The tile that was kept is from inside.
    for found in (inside, other.localize(*images, refine=refine)):
        np.testing.assert_array_equal(found.pose, expected.pose)


@pytest.mark.parametrize("refine", ["none", "mean", "fine", "continuous"])
def test_a_model_that_has_diverged_is_refused(run, cache, images, refine):
    diverged = Localizer.load(run, cache=cache, device="cpu")
    with torch.no_grad():
        next(diverged.model.aerial_encoder.parameters()).fill_(torch.nan)
    with pytest.raises(RunError, match="the best score is nan; it must be finite"):
        diverged.localize(*images, refine=refine)


def test_probabilities_sum_to_one_and_modes_share_them(localizer, images):
    estimate = localizer.localize(*images, heading_prior=(0, 100))
    assert estimate.probabilities.shape == (4, 5, 8)
    assert estimate.probabilities.sum() == pytest.approx(1)
    assert (estimate.probabilities[..., 3:6] == 0).all()
    np.testing.assert_allclose(estimate.place_map.sum(), 1)
    assert 0 < sum(mode.probability for mode in estimate.modes) <= 1 + 1e-9
    expected = torch.from_numpy(estimate.scores / estimate.temperature).flatten().softmax(0)
    np.testing.assert_allclose(estimate.probabilities.ravel(), expected, atol=1e-6)


def test_a_fitted_temperature_is_used(run, vigor, cache, images, tmp_path):
    copy = shutil.copytree(run, tmp_path / "run")
    loss = Localizer.load(copy, cache=cache, device="cpu")
    assert (loss.temperature, loss.calibrated) == (0.1, False)
    content = {"temperature": 0.025, "grid": "4x5x8", "checkpoint": "best"}
    (copy / "calibration.json").write_text(json.dumps(content))
    fitted = Localizer.load(copy, cache=cache, device="cpu")
    assert (fitted.temperature, fitted.calibrated) == (0.025, True)
    # Of other candidates or weights it is the best there is, and not fitted to them.
    for other in ({"grid": "4x5x4"}, {"checkpoint": "last"}):
        others = Localizer.load(copy, cache=cache, device="cpu", **other)
        assert (others.temperature, others.calibrated) == (0.025, False)
    one, other = (some.localize(*images).probabilities for some in (loss, fitted))
    assert other.max() > one.max()


@pytest.mark.parametrize(
    "content",
    [
        "",
        "[1]",
        '{"temperature": 0.0, "grid": "4x5x8", "checkpoint": "best"}',
        '{"temperature": NaN, "grid": "4x5x8", "checkpoint": "best"}',
        '{"temperature": 0.1, "grid": "4x5", "checkpoint": "best"}',
        '{"temperature": 0.1, "grid": "4x5x8", "checkpoint": "worst"}',
        '{"temperature": 0.1}',
        "{}",
    ],
)
def test_a_spoilt_calibration_is_refused(run, cache, tmp_path, content):
    copy = shutil.copytree(run, tmp_path / "run")
    (copy / "calibration.json").write_text(content)
    with pytest.raises(RunError, match=r"calibration.json: holds no temperature"):
        Localizer.load(copy, cache=cache, device="cpu")


def test_a_refinement_of_another_name_is_refused(localizer, run, cache, images):
    with pytest.raises(ConfigError, match="refine is 'coarse'; it must be one of none, mean, fine"):
        localizer.localize(*images, refine="coarse")
    with pytest.raises(ConfigError, match="refine is 'coarse'"):
        Localizer.load(run, cache=cache, device="cpu", refine="coarse")


def test_a_run_is_timed_on_its_own_grid_or_another(run, cache):
    assert time_run(run, cache=cache, device="cpu", runs=1).poses == 4 * 5 * 8
    timings = time_run(run, grid="2x2x4", cache=cache, device="cpu", batch_size=2, runs=1)
    assert (timings.poses, timings.batch_size) == (16, 2)


def test_offsets_in_metres_and_on_the_globe():
    modes = (
        Mode(np.array([0.75, 0.25, 90.0]), 0.5, 0.75),
        Mode(np.array([0.5, 0.5, 0.0]), 0.25, 0.25),
    )
    estimate = Estimate(modes, np.zeros((1, 1, 1)), PoseGrid(1, 1, 1), 640, 0.1)
    assert estimate.offset_m(0.1) == (16.0, 16.0)
    assert estimate.as_dict(0.1) == {
        "u": 0.75, "v": 0.25, "heading_deg": 90.0, "score": 0.5, "probability": 0.75,
        "east_m": 16.0, "north_m": 16.0, "covariance": [[0.0] * 3] * 3, "temperature": 0.1,
        "other_modes": [
            {"u": 0.5, "v": 0.5, "heading_deg": 0.0, "score": 0.25, "probability": 0.25,
             "east_m": 0.0, "north_m": 0.0},
        ],
    }  # fmt: skip
    placed = estimate.as_dict(0.1, (52.0, 4.0))
    assert placed["latitude"] == pytest.approx(52 + 16 / 111_260, abs=2e-6)
    assert placed["longitude"] == pytest.approx(4 + 16 / 68_680, abs=2e-6)
    assert placed["other_modes"][0]["latitude"] == pytest.approx(52.0)
    with pytest.raises(ConfigError, match="metres per pixel is -1"):
        estimate.offset_m(-1)
    with pytest.raises(ConfigError, match="give its metres per pixel too"):
        estimate.as_dict(centre=(52.0, 4.0))


def test_an_estimate_prints_as_one_line(localizer, images):
    estimate = localizer.localize(*images)
    u, v, heading_deg = estimate.pose
    assert str(estimate).startswith(f"u {u:.4f}, v {v:.4f}, heading {heading_deg:.2f} degrees")
    assert "m east" not in str(estimate)
    placed = localizer.localize(*images, metres_per_pixel=0.9)
    assert re.search(r"m (east|west) and .* m (north|south) of the centre; prob", str(placed))
    assert placed.as_dict() == estimate.as_dict() | {"covariance": placed.as_dict()["covariance"]}
    for text in (str(placed), repr(placed), repr([placed])):
        assert "\n" not in text
        assert "array" not in text


@pytest.mark.parametrize(
    ("heading_prior", "place_prior", "said"),
    [
        (None, (0.5, 0.5, 20), "in shares of the tile's side, not in metres or pixels"),
        ((0, 180), (40, 32, 100), "has a radius of 100 tile sides"),
        ((90, 270), None, "has a half width beyond 180 degrees"),
    ],
)
def test_priors_that_are_almost_surely_slips(
    run, cache, images, caplog, heading_prior, place_prior, said
):
    localizer = Localizer.load(run, cache=cache, device="cpu")
    for _ in range(2):
        localizer.localize(*images, heading_prior, place_prior)
    (record,) = caplog.records  # once, not for each image
    assert said in record.getMessage()
    caplog.clear()
    localizer.localize(*images, (90, 180), (0.5, 0.5, 1.0))
    assert not caplog.records


XMP = (
    b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF '
    b'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description '
    b'xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" GPano:PoseHeadingDegrees="90"/>'
    b"</rdf:RDF></x:xmpmeta>"
)


def test_the_heading_that_a_panorama_says_is_its_prior(localizer, images, caplog):
    panorama = Image.open(images[0])
    panorama.load()
    panorama.info["xmp"] = XMP
    found = localizer.localize(panorama, images[1], refine="none")
    assert np.isfinite(found.scores).any(axis=(0, 1)).tolist() == [
        abs(heading - 90) <= 30 for heading in localizer.grid.headings_deg
    ]
    assert "only headings within 30 degrees of the 90 that its own data give" in caplog.text
    # What the caller says goes before it, and an image without such data has none.
    every = localizer.localize(panorama, images[1], (0.0, 180.0), refine="none")
    assert np.array_equal(every.scores, localizer.localize(*images, refine="none").scores)
    other = localizer.localize(panorama, images[1], (200.0, 30.0), refine="none")
    assert abs(other.pose[2] - 200) <= 30
