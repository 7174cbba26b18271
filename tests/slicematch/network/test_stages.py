"""Stages of backbones that are found by trial, and those that a run keeps."""

import json
import shutil
import subprocess
import sys

import pytest
import torch
from slicematch.errors import RunError
from slicematch.network.encoders import Encoder
from slicematch.network.stages import Stages, find_stages
from slicematch.runs.folder import RunFolder
from slicematch.runs.shipped import find_run

import timm  # isort: skip  after slicematch

QUESTION = "test_resnet", (64, 128), 8, 16


@pytest.mark.parametrize(
    "name", ["test_resnet", "test_vit", "test_convnext", "swin_tiny_patch4_window7_224"]
)
def test_they_say_what_the_backbone_gives(name):
    deepest = 16 if name == "test_vit" else 32
    stages = find_stages(name, (64, 128), 16, deepest)
    encoder = Encoder(name, (64, 128), 16, "none", known=stages)
    with torch.no_grad():
        features = encoder.eval()(torch.zeros(1, 3, 64, 128))
    assert tuple(features.shape[1:]) == stages.shapes[0]


def test_kept_ones_are_taken_only_for_the_same_question():
    stages = find_stages(*QUESTION)
    assert Stages.from_dict(json.loads(json.dumps(stages.to_dict()))) == stages
    assert stages.suit(*QUESTION)
    for other in (
        ("resnet50", (64, 128), 8, 16),
        ("test_resnet", (64, 64), 8, 16),
        ("test_resnet", (64, 128), 16, 16),
        ("test_resnet", (64, 128), 8, 8),
    ):
        assert not stages.suit(*other)
    wide = Encoder("test_resnet", (64, 256), 8, "none", known=stages)
    assert wide.feature_size == (8, 32)


@pytest.fixture
def run(tmp_path):
    return RunFolder(shutil.copytree(find_run("generated-city"), tmp_path / "run"))


@pytest.mark.parametrize(
    "content",
    ["", "[]", "null", "[1, 2]", "[{}, {}]", '{"a": 1}', "[" * 10_000,
     '[{"name": "x", "shapes": 3, "image_size": 1, "indices": []}, {}]'],
)  # fmt: skip
def test_a_run_is_loaded_without_them_or_with_broken_ones(run, content):
    kept = run.load_stages()
    run.stages_file.write_text(content)
    assert run.load_stages() is None
    _, model = run.load_model()
    assert [stages.shapes for stages in model.stages] == [stages.shapes for stages in kept]


@pytest.mark.parametrize(
    ("name", "value"),
    [("shapes", [[-1, 4, 4]]), ("shapes", [[4, 4]]), ("shapes", [[40, 16, 16], [112, 16, 16]]),
     ("shapes", [[40, 0, 0], [112, 16, 16]]), ("shapes", [[10**20, 32, 32], [112, 16, 16]]),
     ("indices", [1.5]), ("indices", [3, 2]), ("indices", [2, 2]), ("indices", [2]),
     ("sized", "yes"), ("name", 3), ("image_size", [256]), ("smallest_batch", "2"), ("unknown", 1)],
)  # fmt: skip
def test_values_that_cannot_be_are_passed_over(run, name, value):
    content = json.loads(run.stages_file.read_text())
    content[1][name] = value
    run.stages_file.write_text(json.dumps(content))
    assert run.load_stages() is None


@pytest.mark.parametrize(
    ("name", "value"),
    [("indices", [2, 77]), ("indices", [1, 3]), ("sized", True),
     ("shapes", [[41, 32, 32], [112, 16, 16]])],
)  # fmt: skip
def test_stages_that_the_backbone_does_not_have_are_found_again(run, name, value):
    found = run.load_model()[1].stages
    content = [stages.to_dict() for stages in found]
    content[1][name] = value
    run.stages_file.write_text(json.dumps(content))
    assert run.load_stages() is not None
    assert run.load_model()[1].stages == found


def test_other_faults_of_a_run_are_said_as_they_are(run):
    run.packed_weights.write_bytes(b"")
    with pytest.raises(RunError, match=r"weights\.safetensors: is not a checkpoint"):
        run.load_model()


def test_what_ships_is_what_a_trial_finds(run):
    for one in (run, *run.members()):
        for kept in one.load_stages():
            found = find_stages(kept.name, kept.image_size, kept.stride, kept.deepest)
            assert found.to_dict() | {"timm": kept.timm} == kept.to_dict()


@pytest.mark.skipif(
    RunFolder(find_run("generated-city")).load_stages()[0].timm != timm.__version__,
    reason="what ships was found with another version of timm",
)
def test_a_command_answers_without_what_it_does_not_need():
    code = (
        "import sys\n"
        "ask = 'predict generated-city --example 1 --grid 3x3x8'\n"
        "sys.argv = ['slicemask', *ask.split()]\n"
        "from slicemask.cli.main import main\n"
        "try: main()\n"
        "except SystemExit as end: assert not end.code, end.code\n"
        "there = {name for name, module in sys.modules.items() if module is not None}\n"
        "print(*{'sympy', 'scipy', 'huggingface_hub', 'torch._dynamo.config'} & there)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.splitlines()[-1] == "", found.stderr
