"""`slicemask benchmark`: what it reports, not how fast it is."""

import json

import pytest
from click.testing import CliRunner
from slicematch.evaluation.timing import Timings

from slicemask.cli.main import main

SMALL = (
    "--encoder", "test_convnext", "--ground-size", "32,64", "--aerial-size", "64",
    "--slices", "4", "--grid", "3x2x8", "--runs", "1", "--device", "cpu",
)  # fmt: skip


@pytest.fixture
def benchmark(tmp_path):
    """Run the command; give its result."""

    def invoke(*arguments):
        result = CliRunner().invoke(main, ["benchmark", *arguments, "--cache", str(tmp_path)])
        assert result.exception is None or isinstance(result.exception, SystemExit)
        return result

    return invoke


def test_the_stages_are_timed_apart(benchmark):
    found = json.loads(benchmark(*SMALL, "--batch-size", "3", "--json").output)
    assert (found["poses"], found["distinct_masks"]) == (48, 48)
    assert (found["batch_size"], found["device"]) == (3, "cpu")
    assert found["precision"] == "32-true"
    stages = [found[f"{stage}_s"] for stage in ("encode", "aggregate", "score")]
    assert min(stages) > 0
    assert found["frames_per_second"] == pytest.approx(3 / sum(stages))


def test_encoders_in_fewer_bits(benchmark):
    text = benchmark(*SMALL, "--precision", "bf16-mixed").output
    assert "batches of 1, encoders bf16-mixed)" in text
    assert "Invalid value for '--precision'" in benchmark("--precision", "8-mixed").output


def test_a_pinhole_camera_and_a_list_of_stages(benchmark):
    text = benchmark(*SMALL, "--hfov", "80", "--projection", "pinhole").output
    assert [line.split()[0] for line in text.splitlines()[:3]] == ["encode", "aggregate", "score"]
    assert "48 poses, 192 masks" in text
    assert "frames a second (cpu, " in text


def test_the_report_reads_as_the_figures():
    report = Timings(0.4, 0.1, 1.5, 28224, 28224, 2, "cuda:0", "bf16-mixed", 4).report()
    assert "1500.0 ms  28,224 poses" in report
    assert report.endswith("1.00 frames a second (cuda:0, batches of 2, encoders bf16-mixed)")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--grid", "3x3"), "grid is '3x3'"),
        (("--runs", "0"), "runs is 0; it must be at least 1"),
        (("--batch-size", "-1"), "batch size is -1"),
        (("--ground-size", "0,64"), "image sizes are (0, 64) and 64 pixels"),
        (("--slices", "0"), "slices is 0"),
        (("--encoder", "abacus"), "'abacus' is no timm model"),
        (("--weights", "nowhere.safetensors"), "there is no such file"),
        (("--device", "abacus"), "device 'abacus' cannot be used"),
        (("--hfov", "400"), "hfov is 400.0"),
        (("--batch-size", "1000000000000"), "take more memory than there is"),
    ],
)
def test_arguments_that_cannot_be(benchmark, options, said):
    result = benchmark(*SMALL, *options)
    assert result.exit_code == 1
    (line,) = result.output.splitlines()
    assert line.startswith("Error: ")
    assert said in line


def test_a_run_keeps_its_settings(benchmark):
    assert "no run folder" in benchmark("nowhere").output
    result = benchmark("nowhere", "--stride", "8")
    assert result.exit_code == 2
    assert "--stride cannot be changed in a run" in result.output
