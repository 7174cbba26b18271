"""Localising with a run, and its evaluation: what they give, not how well a model is trained."""

import csv
import json
import shutil

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from PIL import Image
from slicematch.errors import ConfigError, RunError
from slicematch.evaluation.evaluate import evaluate
from slicematch.evaluation.timing import time_run
from slicematch.localization.estimate import Estimate
from slicematch.localization.localizer import Localizer
from slicematch.localization.modes import Mode, within_reach
from slicematch.localization.refinement import DEFAULT
from slicematch.runs.config import TrainConfig
from slicematch.scoring.scores import score_masks
from slicematch.training.train import train

from slicemask import Frustum, PoseGrid, build_bank, slice_masks
from slicemask.cli.main import main
from slicemask.errors import ImageError


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("banks")


@pytest.fixture(scope="module")
def vigor(make_vigor_tree, tmp_path_factory):
    root = tmp_path_factory.mktemp("data") / "vigor"
    return make_vigor_tree(root, 5, panorama_size=(64, 128), tile_pixels=80)


@pytest.fixture(scope="module")
def run(vigor, tmp_path_factory, cache):
    """A run trained for one epoch: its answers are poor, and as good as any to check."""
    config = TrainConfig(
        data="vigor",
        root=str(vigor.root),
        data_settings={"cities": ["Chicago"]},
        encoder="test_convnext",
        weights="none",
        ground_size=(32, 64),
        aerial_size=64,
        slices=4,
        train_grid="3x3x4",
        test_grid="4x5x8",
        epochs=1,
        batch_size=2,
        validation_fraction=0.0,
        heat_map_every=0,
        workers=0,
        accelerator="cpu",
    )
    return train(config, tmp_path_factory.mktemp("runs") / "vigor", cache=cache, progress=False)


@pytest.fixture(scope="module")
def localizer(run, cache):
    return Localizer.load(run, cache=cache, device="cpu")


@pytest.fixture(scope="module")
def images(vigor):
    panorama, tile, *_ = vigor.labels["Chicago"][0]
    city = vigor.root / "Chicago"
    return city / "panorama" / panorama, city / "satellite" / tile


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
    panoramas = sorted((vigor.root / "Chicago" / "panorama").iterdir())
    tile = np.asarray(Image.open(images[1]).convert("RGB")).copy()
    for panorama in panoramas:
        localizer.localize(panorama, images[1])
        localizer.localize(panorama, tile)
    assert len(encoded) == 1

    known = localizer.encode_aerial(images[1])
    scores = localizer.localize(panoramas[0], known).scores
    assert len(encoded) == 1
    tile[:40] = 0  # the same array with other pixels is another tile
    assert not np.array_equal(localizer.localize(panoramas[0], tile).scores, scores)
    assert len(encoded) == 2
    hook.remove()


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


def test_pictures_that_cannot_be(localizer, images):
    with pytest.raises(ImageError, match="an aerial tile must be square"):
        localizer.localize(images[0], images[0])
    with pytest.raises(ImageError, match="must be 2 times as wide as high"):
        localizer.localize(images[1], images[1])
    with pytest.raises(ImageError, match="nowhere"):
        localizer.localize("nowhere.jpg", images[1])
    with pytest.raises(ImageError, match=r"an array float64 with shape \[4, 4\]"):
        localizer.localize(images[0], np.zeros((4, 4)))
    for height, width in ((0, 0), (0, 8), (8, 0)):
        empty = np.zeros((height, width, 3), np.uint8)
        with pytest.raises(ImageError, match=f"{width}x{height} pixels"):
            localizer.localize(images[0], empty)
        with pytest.raises(ImageError, match=f"{width}x{height} pixels"):
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
        ground = localizer.model.encode_ground(localizer._ground(images[0]))
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


def test_a_mean_estimate_is_the_mean_of_what_is_near_the_best_candidate(localizer, images):
    grid = localizer.localize(*images, refine="none")
    mean = localizer.localize(*images, refine="mean")
    poses = grid.grid.poses()
    some = within_reach(grid.pose, poses, grid.grid)
    weights = grid.probabilities.ravel()[some]
    expected = weights @ poses[some, :2] / weights.sum()
    np.testing.assert_allclose(mean.pose[:2], expected, atol=1e-12)
    turns = (poses[some, 2] - grid.pose[2] + 180) % 360 - 180
    turn = weights @ turns / weights.sum()
    assert mean.pose[2] == pytest.approx((grid.pose[2] + turn) % 360)
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
        if refine != "mean":  # means keep the order of the candidates
            scores = [mode.score for mode in estimate.modes]
            assert scores == sorted(scores, reverse=True)
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


def test_an_evaluation_writes_everything(run, cache, vigor, tmp_path):
    evaluation, folder = evaluate(run, cache=cache, device="cpu", refine="none")
    assert folder == run / "evaluation" / "same-area_test_4x5x8_best"
    assert {path.name for path in folder.iterdir()} == {
        "result.json", "samples.csv", "errors.png", "best.png", "median.png", "worst.png",
        "bad_samples.jsonl",
    }  # fmt: skip
    with (folder / "samples.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    result = json.loads((folder / "result.json").read_text())
    assert [row["name"] for row in rows] == [s["name"] for s in result["per_sample"]]
    assert len(rows) == 5
    assert (folder / "bad_samples.jsonl").read_text() == ""
    for n, (row, sample) in enumerate(zip(rows, result["per_sample"], strict=True)):
        _, _, d0, d1 = vigor.labels["Chicago"][n]
        assert float(row["true_u"]) == sample["true_u"] == 0.5 - d1 / 640
        assert float(row["true_v"]) == sample["true_v"] == 0.5 + d0 / 640
        du, dv = (float(row[axis]) - float(row[f"true_{axis}"]) for axis in "uv")
        metres = np.hypot(du, dv) * 0.111262 * 640
        assert float(row["error_place_m"]) == pytest.approx(metres)
    errors = [sample["error_place_m"] for sample in result["per_sample"]]
    assert result["errors"]["place_mean_m"] == pytest.approx(np.mean(errors))
    assert result["floor"]["place_mean_m"] <= result["errors"]["place_mean_m"]
    assert len({sample["true_heading_deg"] for sample in result["per_sample"]}) > 1

    report = evaluation.report()
    assert "floor of the grid" in report
    assert f"{result['floor']['place_median_m']:.2f} m" in report

    with pytest.raises(RunError, match="holds results already"):
        evaluate(run, cache=cache, device="cpu", refine="none")
    again, _ = evaluate(run, cache=cache, device="cpu", overwrite=True, refine="none")
    np.testing.assert_array_equal(again.truths, evaluation.truths)
    np.testing.assert_array_equal(again.estimates, evaluation.estimates)


def test_a_refined_evaluation_is_what_localising_gives(run, cache, vigor):
    evaluation, folder = evaluate(run, cache=cache, device="cpu", refine="fine")
    assert folder == run / "evaluation" / "same-area_test_4x5x8_best_fine"
    result = json.loads((folder / "result.json").read_text())
    assert (result["refine"], result["calibrated"], result["temperature"]) == ("fine", False, 0.1)
    assert "refine fine" in evaluation.report()
    assert "temperature 0.1 (not fitted to these candidates)" in evaluation.report()
    grid = PoseGrid.parse("4x5x8").poses()
    assert not (evaluation.estimates[:, None] == grid).all(axis=2).any()

    # The floor is still that of the grid; calibration is that of the samples.
    unrefined, _ = evaluate(run, cache=cache, device="cpu", refine="none", overwrite=True)
    assert result["floor"] == unrefined.floor.summary()
    assert (evaluation.scores >= unrefined.scores).all()
    samples, sure = result["per_sample"], result["calibration"]
    assert sure["mean_probability"] == pytest.approx(np.mean([s["probability"] for s in samples]))
    assert sure["share_near"] == np.mean([s["near"] for s in samples])
    assert sure["share_in_region"] == np.mean([s["in_region"] for s in samples])
    for sample in samples:
        metres = 0.1 * 0.111262 * 640
        close = sample["error_place_m"] <= 1.5 / 4 * 10 * metres
        assert sample["near"] == (close and sample["error_heading_deg"] <= 1.5 * 45)


def test_an_evaluation_says_in_which_precision_it_was(run, cache):
    evaluation, folder = evaluate(run, limit=2, cache=cache, device="cpu", precision="bf16-mixed")
    assert folder.name == "same-area_test_4x5x8_best_mean_bf16-mixed_2"
    assert json.loads((folder / "result.json").read_text())["precision"] == "bf16-mixed"
    assert "refine mean, encoders bf16-mixed" in evaluation.report()


def test_an_evaluation_of_some_samples_takes_them_from_all_over(run, cache):
    whole, _ = evaluate(run, cache=cache, device="cpu", overwrite=True, refine="none")
    some, folder = evaluate(run, limit=3, cache=cache, device="cpu", refine="none")
    assert folder.name == "same-area_test_4x5x8_best_3"
    assert some.names == whole.names[::2]
    np.testing.assert_array_equal(some.estimates, whole.estimates[::2])
    assert len(evaluate(run, limit=99, cache=cache, device="cpu")[0].names) == 5
    with pytest.raises(ConfigError, match="limit is 0; it must be at least 1"):
        evaluate(run, limit=0, cache=cache, device="cpu")
    with pytest.raises(ConfigError, match="workers is -1; it must be at least 0"):
        evaluate("nowhere", workers=-1)


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize("workers", [0, 1])
def test_an_evaluation_that_fails_leaves_what_was_there(
    slicemask, run, cache, vigor, tmp_path, workers
):
    out, root = tmp_path / "out", shutil.copytree(vigor.root, tmp_path / "vigor")
    assert slicemask("evaluate", "--out", out).exit_code == 0
    before = contents(out)
    broken = sorted((root / "Chicago" / "satellite").iterdir())
    for path in broken:
        path.unlink()
    options = ["--root", root, "--workers", workers]
    for folder in (out, tmp_path / "new"):
        result = slicemask("evaluate", *options, "--out", folder, "--overwrite")
        assert result.exit_code == 1
        (line,) = result.stderr.splitlines()
        assert "none of the 5 samples can be read" in line
        assert sum(str(path) in line for path in broken) == 1
    assert contents(out) == before
    assert not (tmp_path / "new").exists()


def test_more_bad_samples_than_the_run_bears(run, cache, vigor, tmp_path):
    few = shutil.copytree(run, tmp_path / "run")
    config = (few / "config.yaml").read_text()
    (few / "config.yaml").write_text(config.replace("max_bad_samples: 10", "max_bad_samples: 1"))
    root = shutil.copytree(vigor.root, tmp_path / "vigor")
    for path in sorted((root / "Chicago" / "satellite").iterdir())[:2]:
        path.write_bytes(b"no picture")
    with pytest.raises(RunError, match="more than 1 samples are unreadable"):
        evaluate(few, root=str(root), out=tmp_path / "out", cache=cache, device="cpu")
    assert not (tmp_path / "out").exists()


def test_results_that_cannot_be_written_are_refused_first(run, cache, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RunError, match="file: is not a folder; name another"):
        evaluate(run, out=tmp_path / "file" / "out", cache=cache, device="cpu")


def test_an_evaluation_says_what_it_left_out(run, cache, vigor, tmp_path):
    root = shutil.copytree(vigor.root, tmp_path / "vigor")
    broken = sorted((root / "Chicago" / "satellite").iterdir())[2]
    broken.write_bytes(b"no picture")
    evaluation, folder = evaluate(
        run, root=str(root), grid="2x2x2", out=tmp_path / "out", cache=cache, device="cpu"
    )
    assert len(evaluation.names) == len(evaluation.estimates) == 4
    assert "1 samples could not be read" in evaluation.report()
    result = json.loads((folder / "result.json").read_text())
    ((name, fault),) = result["unreadable"].items()
    assert str(broken) in fault
    (line,) = (folder / "bad_samples.jsonl").read_text().splitlines()
    assert json.loads(line) == {"name": name, "error": fault}


@pytest.fixture
def slicemask(run, cache):
    """Run a command on the run's banks; give its result."""

    def invoke(command, *arguments):
        arguments = [command, str(run), "--cache", str(cache), "--device", "cpu", *arguments]
        return CliRunner().invoke(main, [str(argument) for argument in arguments])

    return invoke


def test_predict_writes_geojson_and_says_how_sure_it_is(slicemask, images, localizer, tmp_path):
    pair = ["--ground", images[0], "--aerial", images[1]]
    place = ["--centre", "41.8,-87.6", "--metres-per-pixel", "0.9"]
    out = tmp_path / "pose.geojson"
    options = [*pair, *place, "--refine", "continuous", "--geojson", out]
    content = json.loads(slicemask("predict", *options, "--json").stdout)
    expected = localizer.localize(*images, refine="continuous", metres_per_pixel=0.9)
    assert content == {
        **expected.as_dict(0.9, (41.8, -87.6)), "refine": "continuous", "calibrated": False,
        "geojson": str(out),
    }  # fmt: skip
    point, area = json.loads(out.read_text())["features"]
    assert point["geometry"]["coordinates"] == [content["longitude"], content["latitude"]]
    assert area["geometry"]["type"] == "Polygon"

    text = slicemask("predict", *options).stdout
    assert f"latitude {content['latitude']:.7f}" in text
    assert f"probability {content['probability']:.1%} (uncalibrated), standard dev" in text
    assert str(out) in text.splitlines()
    assert "of the tile east" in slicemask("predict", *pair, "--refine", "none").stdout


PLACE = ("--centre", "1,2", "--metres-per-pixel", "1")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--geojson", "{0}/a.geojson"], "--geojson needs --centre and --metres-per-pixel"),
        (["--centre", "1,2"], "--centre needs --metres-per-pixel"),
        ([*PLACE, "--geojson", "{0}/a.txt"], "its suffix is .txt; name a file that ends in .geo"),
        ([*PLACE, "--geojson", "{0}/no/a.json"], "there is no such folder"),
        ([*PLACE, "--geojson", "{0}/a.json", "--out", "{0}/a.bmp"], "its suffix is .bmp"),
        (["--centre", "95,2", "--metres-per-pixel", "1"], "the tile's centre is 95,2"),
        (["--centre", "5,2", "--metres-per-pixel", "0"], "metres per pixel is 0.0"),
        (["--centre", "5", "--metres-per-pixel", "1"], "'5' is not lat,lon"),
        (["--centre", "5,2", "--metres-per-pixel", "1e300"], "it must be from 0.0001 to 1000"),
        (["--metres-per-pixel", "1e-13"], "metres per pixel is 1e-13"),
        (["--metres-per-pixel", "nan"], "metres per pixel is nan"),
        (["--refine", "finest"], "'finest' is not one of"),
        (["--truth", "0.5,0.5,0"], "--truth is drawn in the picture; it needs --out"),
        (["--truth", "5,5,nan", "--out", "{0}/a.png"], "the truth is not finite: u=5, v=5"),
        (["--truth", "5,5,0", "--out", "{0}/a.png"], "the truth lies outside the tile"),
    ],
)
def test_predict_says_what_it_lacks(slicemask, images, tmp_path, options, said):
    options = [option.format(tmp_path) for option in options]
    result = slicemask("predict", "--ground", images[0], "--aerial", images[1], *options)
    assert result.exit_code != 0
    assert said in result.stderr
    assert "Traceback" not in result.output
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("device", ["meta", "mps", "xpu", "cuda:99", "abacus"])
@pytest.mark.parametrize("command", ["predict", "evaluate", "benchmark"])
def test_devices_that_cannot_be(slicemask, images, command, device):
    pair = ["--ground", images[0], "--aerial", images[1]] if command == "predict" else []
    result = slicemask(command, *pair, "--device", device)
    assert result.exit_code == 1
    (line,) = result.stderr.splitlines()
    assert line.startswith(f"Error: device '{device}' cannot be used")


@pytest.mark.parametrize("command", ["predict", "evaluate"])
def test_the_commands_default_is_the_librarys(command):
    text = " ".join(CliRunner().invoke(main, [command, "--help"]).stdout.split())
    assert f"then gradients. [default: {DEFAULT}]" in text


def test_calibrating_a_run_without_a_validation_part(slicemask, run):
    result = CliRunner().invoke(main, ["calibrate", str(run)])
    assert result.exit_code == 1
    assert "was trained with validation_fraction 0" in result.stderr
