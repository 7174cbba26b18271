"""Beside a torchvision whose compiled operators do not load, the model's packages still import."""

import subprocess
import sys

import pytest

# What torchvision meets beside a torch of another build: its library does not load.
UNLOADABLE = """
import importlib, torch
def refuse(path):
    raise OSError(f"{path}: undefined symbol")
torch.ops.load_library = refuse
"""


def imported(*names):
    """Import modules in order, in a process of their own; what became of each."""
    code = (
        UNLOADABLE
        + f"for name in {names!r}:\n"
        + (
            "    try:\n"
            "        importlib.import_module(name)\n"
            "        print('imported')\n"
            "    except RuntimeError as error:\n"
            "        print(error)\n"
        )
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


@pytest.mark.parametrize(
    "names",
    [
        ("slicematch.network.encoders", "timm", "torchvision", "lightning.pytorch"),
        ("slicematch.training.train", "timm"),
        ("slicematch.training.callbacks",),
        ("slicematch.training.trainer",),
        ("slicematch.training.progress",),
        ("slicematch.data.augmentation", "timm"),
        ("slicematch.localization.localizer", "timm"),
    ],
)
def test_the_model_first(names):
    assert imported(*names) == ["imported"] * len(names)


@pytest.mark.parametrize("first", ["timm", "torchvision", "lightning.pytorch"])
def test_others_first(first):
    """Nothing of ours runs then; what was refused can be imported once ours has been."""
    refused, *rest = imported(first, "slicematch.network.encoders", first)
    assert refused == "operator torchvision::nms does not exist"
    assert rest == ["imported", "imported"]
