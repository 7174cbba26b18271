"""The benchmarks, which mypy does not read: each module finds what it takes from the others."""

import importlib
from pathlib import Path

import pytest

MODULES = sorted(path.stem for path in (Path(__file__).parents[2] / "benchmarks").glob("*.py"))


@pytest.mark.parametrize("name", MODULES)
def test_it_imports(name):
    importlib.import_module(f"benchmarks.{name}")
