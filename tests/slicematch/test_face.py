"""What `import slicematch` offers, and what it costs."""

import ast
import inspect
import subprocess
import sys
from pathlib import Path

import pytest
import slicematch

PACKAGE = Path(slicematch.__file__).parent


def _python(code):
    paths = [str(PACKAGE.parent), str(PACKAGE.parents[1])]
    code = f"import sys\nsys.path[:0] = {paths!r}\n{code}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_public_names():
    # A name taken out of this list breaks somebody's code: do it on purpose, and in a changelog.
    assert slicematch.__all__ == [
        "Candidates", "Estimate", "Localizer", "Odometry", "PoseDataset", "Priors", "SliceMatch",
        "TrackEstimate", "TrackSettings", "Tracker", "TrainConfig", "evaluate", "locate", "predict",
        "predict_on_map", "track", "train",
    ]  # fmt: skip
    assert set(slicematch.__all__) <= set(dir(slicematch))


@pytest.mark.parametrize("name", slicematch.__all__)
def test_every_name_is_what_it_is_called(name):
    found = getattr(slicematch, name)
    assert found.__name__ == name
    assert inspect.isclass(found) if name[0].isupper() else inspect.isfunction(found)
    assert found.__module__.startswith("slicematch.")
    assert inspect.getdoc(found)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="Localiser"):
        _ = slicematch.Localiser


def test_importing_loads_nothing_large():
    code = (
        "import slicematch\n"
        "dir(slicematch), slicematch.__all__\n"
        "large = {'torch', 'torchvision', 'timm', 'lightning', 'numpy', 'PIL', 'matplotlib',"
        " 'click', 'yaml'}\n"
        "print(*large & set(sys.modules))"
    )
    assert _python(code) == []


def test_settings_load_no_training():
    # What a command checks before it starts should not take the seconds that Lightning takes.
    code = (
        "import slicematch\n"
        "slicematch.TrainConfig\n"
        "print(*{'lightning', 'tensorboard'} & set(sys.modules))"
    )
    assert _python(code) == []


def test_modules_hide_no_function_of_their_name():
    # Importing slicematch.x sets the attribute x of the package: a module must not be named like
    # a public function, or the function would be gone once the module is imported.
    modules = {path.stem for path in PACKAGE.iterdir() if path.suffix == ".py" or path.is_dir()}
    assert not modules & set(slicematch.__all__)


def test_the_names_are_the_same_whatever_was_imported_before():
    modules = [
        ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
        for path in sorted(PACKAGE.rglob("*.py"))
        if path.name != "__init__.py" and path.name != "pooling_triton.py"  # needs triton
    ]
    code = (
        "import importlib, slicematch\n"
        f"for module in {modules!r}:\n"
        "    importlib.import_module(module)\n"
        "print(*(getattr(slicematch, name).__name__ for name in slicematch.__all__))"
    )
    assert _python(code) == slicematch.__all__


def test_the_stub_exports_each_name_for_type_checkers():
    # Only `from .x import y as y` is an export to them.
    stub = ast.parse((PACKAGE / "__init__.pyi").read_text())
    exported = [
        alias.asname
        for node in stub.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
        if alias.asname == alias.name
    ]
    assert sorted(exported) == sorted(slicematch.__all__)


@pytest.mark.slow
def test_every_name_is_typed(tmp_path):
    pytest.importorskip("mypy")
    root = PACKAGE.parents[1]
    lines = [f"reveal_type(slicematch.{name})" for name in slicematch.__all__]
    (tmp_path / "user.py").write_text("\n".join(["import slicematch", *lines]) + "\n")
    done = subprocess.run(
        [
            # With what `make lint` has found already, where it ran: a minute and a half less.
            *[sys.executable, "-m", "mypy", "--config-file", root / "pyproject.toml"],
            tmp_path / "user.py",
        ],
        cwd=root,
        capture_output=True,
        text=True,
    )
    revealed = [line for line in done.stdout.splitlines() if "Revealed type is" in line]
    assert len(revealed) == len(slicematch.__all__), done.stdout + done.stderr
    assert [line for line in revealed if '"Any"' in line] == []


def test_results_print_their_report():
    """`print` of what a function gives says what its command says."""
    found = [
        (path, node.name, {part.name for part in node.body if isinstance(part, ast.FunctionDef)})
        for path in sorted(PACKAGE.rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef)
    ]
    with_report = [one for one in found if "report" in one[2] and one[1] != "BadSampleLog"]
    assert len(with_report) >= 6
    assert [one[:2] for one in with_report if "__str__" not in one[2]] == []
