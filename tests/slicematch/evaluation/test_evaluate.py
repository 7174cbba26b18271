"""Evaluating a run: the figures are those of its samples, and nothing is left out in silence."""

import csv
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from slicematch.data.images import denormalise
from slicematch.errors import ConfigError, RunError
from slicematch.evaluation.drawing import draw_estimate
from slicematch.evaluation.evaluate import evaluate
from slicematch.evaluation.headings import read_headings
from slicematch.runs.config import TrainConfig

from slicemask import PoseGrid


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
    assert result["oracle"]["place_mean_m"] <= result["errors"]["place_mean_m"]
    assert len({sample["true_heading_deg"] for sample in result["per_sample"]}) > 1

    report = evaluation.report()
    assert "oracle among the candidates" in report
    assert f"{result['oracle']['place_median_m']:.2f} m" in report

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

    # The oracle is still that of the grid; calibration is that of the samples.
    unrefined, _ = evaluate(run, cache=cache, device="cpu", refine="none", overwrite=True)
    assert result["oracle"] == unrefined.oracle.summary()
    assert (evaluation.scores >= unrefined.scores).all()
    samples, sure = result["per_sample"], result["calibration"]
    assert sure["mean_probability"] == pytest.approx(np.mean([s["probability"] for s in samples]))
    assert sure["within_reach"] == np.mean([s["within_reach"] for s in samples])
    assert sure["coverage"] == np.mean([s["in_credible_region"] for s in samples])
    for sample in samples:
        metres = 0.1 * 0.111262 * 640
        close = sample["error_place_m"] <= 1.5 / 4 * 10 * metres
        assert sample["within_reach"] == (close and sample["error_heading_deg"] <= 1.5 * 45)


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
        assert "none of the 5 samples is readable" in line
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
    assert "1 sample could not be read" in evaluation.report()
    result = json.loads((folder / "result.json").read_text())
    (fault,) = result["unreadable"]
    assert str(broken) in fault["error"]
    assert fault["index"] not in evaluation.indices
    (line,) = (folder / "bad_samples.jsonl").read_text().splitlines()
    assert json.loads(line) == fault


@pytest.fixture
def edited(vigor, tmp_path):
    """A copy of the tree whose label lines are edited by a function of them."""

    def edit(change):
        root = shutil.copytree(vigor.root, tmp_path / "edited")
        path = root / "splits__corrected" / "Chicago" / "same_area_balanced_test__corrected.txt"
        path.write_text("\n".join(change(path.read_text().splitlines())))
        return root

    return edit


def moved(line, d0, d1):
    fields = line.split(" ")
    return " ".join([*fields[:2], f"{d0}.0", f"{d1}.0", *fields[4:]])


def repeated(lines):
    """The first panorama three times, each time elsewhere in its tile, and the second one twice."""
    first, second = lines[:2]
    places = [(first, 10, 20), (second, -30, 60), (first, 100, -50), (first, -90, 30)]
    return [moved(*place) for place in [*places, (second, 70, -80)]]


def test_samples_of_one_name_are_told_apart(run, cache, edited, tmp_path, monkeypatch):
    """As in KITTI's test file, where a frame comes up to three times with other shifts."""
    shown = []

    def recorded(aerial, *arguments, **options):
        shown.append(options)
        return draw_estimate(aerial, *arguments, **options)

    monkeypatch.setattr("slicematch.evaluation.evaluate.draw_estimate", recorded)
    evaluation, folder = evaluate(
        run, root=str(edited(repeated)), out=tmp_path / "out", cache=cache, device="cpu"
    )
    assert len(evaluation.names) == 5
    assert len(set(evaluation.names)) == 2
    with (folder / "samples.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    result = json.loads((folder / "result.json").read_text())
    assert [int(row["index"]) for row in rows] == [s["index"] for s in result["per_sample"]]
    assert [int(row["index"]) for row in rows] == list(range(5))
    assert [float(row["true_v"]) for row in rows] == [
        0.5 + d / 640 for d in (10, -30, 100, -90, 70)
    ]

    # Each picture shows the ground image of the sample whose truth it shows.
    config = TrainConfig.load(run / "config.yaml")
    dataset = replace(config, root=str(tmp_path / "edited")).dataset("test")
    assert len(shown) == 3
    for options in shown:
        (index,) = np.flatnonzero((dataset.poses() == options["truth"]).all(axis=1))
        expected = denormalise(dataset[index]["ground"], *config.normalisation())
        np.testing.assert_array_equal(options["ground"], expected)
        assert f"sample {index}, " in options["title"]


def test_unreadable_samples_of_one_name_all_count(run, cache, edited, tmp_path):
    root = edited(repeated)
    evaluation, _ = evaluate(run, root=str(root), out=tmp_path / "a", cache=cache, device="cpu")
    panorama = evaluation.names[0].removeprefix("Chicago/")
    (root / "Chicago" / "panorama" / panorama).write_bytes(b"no picture")
    evaluation, folder = evaluate(
        run, root=str(root), out=tmp_path / "b", cache=cache, device="cpu", workers=1
    )
    assert evaluation.indices == [1, 4]
    assert [fault["index"] for fault in evaluation.unreadable] == [0, 2, 3]
    assert "3 samples could not be read" in evaluation.report()
    lines = (folder / "bad_samples.jsonl").read_text().splitlines()
    assert [json.loads(line)["index"] for line in lines] == [0, 2, 3]


def test_in_the_training_part_no_sample_stands_in_for_another(run, cache, vigor, tmp_path):
    root = shutil.copytree(vigor.root, tmp_path / "vigor")
    sorted((root / "Chicago" / "satellite").iterdir())[2].write_bytes(b"no picture")
    evaluation, _ = evaluate(
        run, root=str(root), part="train", out=tmp_path / "out", cache=cache, device="cpu"
    )
    assert evaluation.indices == [0, 1, 3, 4]
    assert len(set(evaluation.names)) == 4


@pytest.mark.parametrize(("change", "count"), [((400, 0), 1), ((0, -321), 1), ((320, -320), 0)])
def test_labels_off_their_tile_are_counted_aloud(slicemask, edited, tmp_path, change, count):
    root = edited(lambda lines: [moved(lines[0], *change), *lines[1:]])
    result = slicemask("evaluate", "--root", root, "--out", tmp_path / "out")
    assert ("1 label lies off its tile" in result.stdout) == (count == 1)
    content = json.loads((tmp_path / "out" / "result.json").read_text())
    assert (content["labels_left_out"], content["samples"]) == (count, 5 - count)


def write_headings(path, headings, unit):
    values = np.asarray(headings) / {"degrees": 1, "radians": 180 / np.pi, "turns": 360}[unit]
    if path.suffix == ".npy":
        np.save(path, values)
    else:
        path.write_text("\ufeff" + "\n".join(f"{value!r}" for value in values.tolist()) + "\n\n")
    return path


@pytest.mark.parametrize("suffix", [".txt", ".npy"])
@pytest.mark.parametrize("unit", ["degrees", "radians", "turns"])
def test_headings_of_a_file_are_those_of_the_labels(run, cache, edited, tmp_path, suffix, unit):
    """A heading belongs to its line, whether or not lines before it are left out."""
    headings = [350.25, 10.5, 123.0, 90.0, 301.75]
    path = write_headings(tmp_path / f"h{suffix}", headings, unit)
    root = edited(lambda lines: [lines[0], moved(lines[1], 400, 0), *lines[2:]])
    evaluation, folder = evaluate(
        run, root=str(root), headings=path, headings_unit=unit, out=tmp_path / "out",
        cache=cache, device="cpu",
    )  # fmt: skip
    np.testing.assert_allclose(evaluation.truths[:, 2], [350.25, 123.0, 90.0, 301.75])
    assert json.loads((folder / "result.json").read_text())["headings"] == str(path)
    # The ground image is turned with them: as one that faces north is, by whole columns.
    np.save(tmp_path / "north.npy", np.zeros(5))
    dataset = replace(TrainConfig.load(run / "config.yaml"), root=str(root)).dataset("test")
    dataset.use_headings(np.zeros(4))
    north = dataset[2]["ground"]
    dataset.use_headings(np.full(4, 90.0))
    east = dataset[2]["ground"]
    np.testing.assert_allclose(north.roll(-16, dims=2), east, atol=1e-5)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1\n2\n3\n", "there are 3 headings for 5 labels of the test part"),
        ("1\n2\nx\n4\n5\n", "h.txt, line 3: 'x' is no heading; expected one number"),
        ("1\n2\n1_0\n4\n5\n", "line 3: '1_0' is no heading"),
        ("1\n2\nnan\n4\n5\n", "heading 2 is nan; expected a finite number"),
        ("", "holds no heading"),
        (None, "there is no such file of headings"),
    ],
)
def test_headings_that_do_not_fit(slicemask, tmp_path, text, said):
    if text is not None:
        (tmp_path / "h.txt").write_text(text)
    options = ["--headings", tmp_path / "h.txt", "--out", tmp_path / "out"]
    result = slicemask("evaluate", *options)
    assert result.exit_code == 1
    (line,) = result.stderr.splitlines()
    assert said in line
    assert not (tmp_path / "out").exists()


def test_degrees_that_look_like_radians_are_said_to(tmp_path, caplog):
    path = write_headings(tmp_path / "h.npy", [350.0, 10.0, 123.0], "radians")
    read_headings(path)
    assert "as if they were radians" in caplog.text
    caplog.clear()
    read_headings(write_headings(tmp_path / "h.txt", [350.0, 10.0, 123.0], "turns"))
    assert "as if they were turns" in caplog.text
    caplog.clear()
    read_headings(write_headings(tmp_path / "h.txt", [350.0, 10.0, 123.0], "degrees"))
    read_headings(path, "radians")
    assert not caplog.records


def test_a_heading_prior_of_its_own(run, cache, tmp_path):
    aligned, folder = evaluate(run, heading_half_width_deg=0, cache=cache, device="cpu")
    assert folder.name == "same-area_test_4x5x8_best_mean_prior0"
    assert (aligned.truths[:, 2] == 0).all()
    assert (aligned.errors.heading_deg == 0).all()
    assert aligned.settings["heading_prior"] == (0.0, 0.0)
    wide, _ = evaluate(run, heading_half_width_deg=50, cache=cache, device="cpu")
    away = np.abs((wide.truths[:, 2] + 180) % 360 - 180)
    assert 0 < away.max() <= 50
    path = write_headings(tmp_path / "h.txt", [0.0, 49.0, 51.0, 310.0, 180.0], "degrees")
    told, _ = evaluate(
        run, heading_half_width_deg=50, headings=path, out=tmp_path / "o", cache=cache, device="cpu"
    )
    assert told.settings["headings_outside_the_prior"] == 2
    assert "2 samples have a true heading outside the heading prior" in told.report()


def test_recalls_are_those_asked_for(slicemask, run, cache, tmp_path):
    options = ["--recalls", "2,10.5", "--out", tmp_path / "out", "--json"]
    errors = json.loads(slicemask("evaluate", *options).stdout)["errors"]
    assert {name for name in errors if "recall" in name} == {
        f"{kind}_recall_{value}{unit}"
        for kind, unit in (("lateral", "m"), ("longitudinal", "m"), ("heading", "deg"))
        for value in ("2", "10.5")
    }
    assert (
        "lateral_recall_3m"
        in evaluate(run, cache=cache, device="cpu", out=tmp_path / "b")[0].summary()["errors"]
    )
    for wrong in ("0", "-1,3", "nan", "inf"):
        result = slicemask("evaluate", "--recalls", wrong)
        assert result.exit_code == 1
        assert "they must be distances" in result.stderr
    assert slicemask("evaluate", "--recalls", "1;3").exit_code == 2


def test_the_best_picture_is_best_in_place_and_heading(run, cache, tmp_path, monkeypatch):
    titles = []

    def recorded(*arguments, **options):
        titles.append(options["title"])
        return draw_estimate(*arguments, **options)

    monkeypatch.setattr("slicematch.evaluation.evaluate.draw_estimate", recorded)
    found, _ = evaluate(run, cache=cache, device="cpu", out=tmp_path / "out")
    together = found.errors.place_m / (0.1 * found.tile_metres) + found.errors.heading_deg / 30
    order = np.argsort(together)
    for title, n in zip(titles, (order[0], order[2], order[-1]), strict=True):
        assert f"sample {n}, {found.names[n]}" in title


@pytest.mark.parametrize(
    ("side_m", "said"),
    [(71.0, ""), (60.0, "was trained with tiles of 60 m"), (30.0, None)],
)
def test_tiles_of_another_size_than_in_training(run, cache, tmp_path, caplog, side_m, said):
    """Tiles of Chicago are 71.2 m a side: as in training, a fifth larger, more than twice."""
    other = shutil.copytree(run, tmp_path / "run")
    config = TrainConfig.load(other / "config.yaml")
    assert config.tile_side_m == pytest.approx(71.2, abs=0.1)
    replace(config, tile_side_m=side_m).save(other / "config.yaml")
    out = tmp_path / "out"
    if said is None:
        with pytest.raises(ConfigError, match=r"71\.\d+ m wide .* trained with tiles of 30 m"):
            evaluate(other, cache=cache, device="cpu", out=out)
        assert not out.exists()
        return
    evaluate(other, cache=cache, device="cpu", out=out)
    assert (said in caplog.text) if said else "trained" not in caplog.text


@pytest.mark.slow
def test_on_dask_the_result_is_the_same_bytes(run, cache, tmp_path, one_thread):
    pytest.importorskip("distributed")
    pytest.importorskip("pyarrow")
    folders = [
        evaluate(run, cache=cache, device="cpu", workers=0, out=tmp_path / name, dask=dask)[1]
        for name, dask in (("alone", None), ("together", "2"))
    ]
    names = [sorted(path.name for path in folder.iterdir()) for folder in folders]
    assert names[0] == names[1]
    for name in ("result.json", "samples.csv", "bad_samples.jsonl"):
        alone, together = ((folder / name).read_bytes() for folder in folders)
        assert alone == together
