"""Which module may import which: one way, and never in a circle.

Imports are read from the source, so those inside functions count as well.
"""

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from slicemask.cli.main import _COMMANDS, main

ROOT = Path(__file__).parents[1]
PACKAGES = {"slicemask": ROOT / "slicemask", "slicematch": ROOT / "model" / "slicematch"}


def _modules():
    """Every module of both packages, by name, with its file."""
    found = {}
    for package, folder in PACKAGES.items():
        for path in sorted(folder.rglob("*.py")):
            parts = path.relative_to(folder).with_suffix("").parts
            parts = parts[:-1] if parts[-1] == "__init__" else parts
            found[".".join((package, *parts))] = path
    return found


MODULES = _modules()


def _imports(name, everywhere):
    """Modules of ours that a module imports, by names that exist in MODULES.

    ``everywhere`` is whether imports inside functions count, and those for type checkers alone.
    """
    tree = ast.parse(MODULES[name].read_text())
    nodes = ast.walk(tree) if everywhere else _at_import(tree.body)
    package = name if MODULES[name].name == "__init__.py" else name.rpartition(".")[0]
    found = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            wanted = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1]
            base = node.module or "" if node.level == 0 else ".".join([*above, node.module or ""])
            base = base.rstrip(".")
            # `from package import module` is the module; any other name is the package's own.
            wanted = [
                f"{base}.{alias.name}" if f"{base}.{alias.name}" in MODULES else base
                for alias in node.names
            ]
        else:
            continue
        found |= {module for module in wanted if module in MODULES}
    return found - {name}


def _at_import(body):
    """Statements that run when a module is imported: not those of functions."""
    for node in body:
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            yield from _at_import(node.orelse)
        elif not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            yield node
            for field in ("body", "orelse", "finalbody", "handlers"):
                yield from _at_import(getattr(node, field, []))


def _within(module, package):
    return module == package or module.startswith(f"{package}.")


def _breaches(importer, imported, exempt=()):
    """Imports of one package by another, as "a -> b", but for those of exempt packages."""
    return [
        f"{module} -> {found}"
        for module in MODULES
        if _within(module, importer) and not any(_within(module, free) for free in exempt)
        for found in sorted(_imports(module, everywhere=True))
        if _within(found, imported)
    ]


def test_the_reader_of_imports_finds_them():
    # All other tests here would pass if it found none.
    assert "slicemask.geometry.frustum" in _imports("slicemask.geometry.masks", everywhere=False)
    inside = _imports("slicemask.geometry.masks", everywhere=True)
    assert {"slicemask.geometry.rays", "slicemask.geometry.coverage"} <= inside
    assert any(_within(name, "slicematch") for name in _imports("slicemask.cli.train", True))
    assert sum(len(_imports(module, everywhere=False)) for module in MODULES) > 100


def test_slicemask_knows_nothing_of_the_model_but_in_its_commands():
    assert _breaches("slicemask", "slicematch", exempt=["slicemask.cli"]) == []


def test_libraries_know_nothing_of_the_commands():
    exempt = ["slicemask.cli", "slicemask.__main__"]
    assert _breaches("slicemask", "slicemask.cli", exempt) == []
    assert _breaches("slicematch", "slicemask.cli") == []


def test_geometry_knows_nothing_of_what_uses_it():
    for user in ("bank", "plot", "synth", "view"):
        assert _breaches("slicemask.geometry", f"slicemask.{user}") == []


def test_banks_know_nothing_of_pictures_and_cities():
    for user in ("plot", "synth", "view"):
        assert _breaches("slicemask.bank", f"slicemask.{user}") == []


def test_the_network_and_its_scores_know_nothing_of_data_and_runs():
    for room in ("network", "scoring"):
        for user in ("data", "runs", "training", "localization", "evaluation"):
            if f"slicematch.{user}" in MODULES:
                assert _breaches(f"slicematch.{room}", f"slicematch.{user}") == []


def test_modules_import_each_other_in_no_circle():
    graph = {module: _imports(module, everywhere=False) for module in MODULES}
    try:
        tuple(TopologicalSorter(graph).static_order())
    except CycleError as error:
        raise AssertionError("circle: " + " <- ".join(error.args[1])) from None


@pytest.mark.parametrize("package", PACKAGES)
def test_torch_and_click_stay_where_they_belong(package):
    for module, path in MODULES.items():
        if not _within(module, package) or _within(module, "slicemask.cli"):
            continue
        names = {
            alias.name.partition(".")[0]
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, (ast.Import, ast.ImportFrom))
            for alias in (
                node.names if isinstance(node, ast.Import) else [ast.alias(node.module or "")]
            )
        }
        unwanted = {"click", "torch"} if package == "slicemask" else {"click"}
        assert not names & unwanted, module


@pytest.mark.parametrize("name", _COMMANDS)
def test_the_list_of_commands_says_what_each_command_s_own_help_says(name):
    module, line = _COMMANDS[name]
    command = main.get_command(click.Context(main), name)
    assert command.name == name
    assert command.callback.__module__ == f"slicemask.cli.{module}"
    # The first sentence or paragraph, as click cuts it.
    assert command.get_short_help_str(limit=1000) == line


@pytest.mark.filterwarnings("error::DeprecationWarning")
def test_the_list_of_commands_needs_nothing_that_the_next_click_lacks():
    shown = CliRunner().invoke(main, ["--help"], catch_exceptions=False, terminal_width=80)
    assert all(line in shown.output for _, line in _COMMANDS.values())


def test_every_command_module_is_in_the_list():
    listed = {module for module, _ in _COMMANDS.values()}
    commands = {
        path.stem
        for path in (ROOT / "slicemask" / "cli").glob("*.py")
        if "@click.command" in path.read_text()
    }
    assert commands == listed
