"""How modules import each other: never in a circle, and slicemask nothing of slicematch."""

import ast
from graphlib import TopologicalSorter
from pathlib import Path

import slicematch

import slicemask

ROOTS = {module.__name__: Path(module.__file__).parent for module in (slicemask, slicematch)}


def modules():
    """Every module's name and file."""
    for name, root in ROOTS.items():
        for file in root.rglob("*.py"):
            parts = file.relative_to(root).with_suffix("").parts
            yield ".".join([name, *(part for part in parts if part != "__init__")]), file


def imported(file, known):
    """The modules that a file imports when it is imported itself."""
    nodes = list(ast.parse(file.read_text("utf-8")).body)
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom) and node.module:
            inner = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from (name for name in [node.module, *inner] if name in known)
        elif isinstance(node, ast.Try | ast.With) or (
            isinstance(node, ast.If) and "TYPE_CHECKING" not in ast.unparse(node.test)
        ):
            nodes += node.body


def graph():
    found = dict(modules())
    return {name: set(imported(file, found)) - {name} for name, file in found.items()}


def test_no_module_imports_itself_by_way_of_others():
    imports = graph()
    assert len(imports) > 100
    assert "slicematch.scoring.off_grid" in imports["slicematch.localization.localizer"]
    # Packages import their parts for their users; their parts ask each other.
    parts = {
        name: {other for other in others if not (name.startswith(other + "."))}
        for name, others in imports.items()
    }
    assert list(TopologicalSorter(parts).static_order())


def test_only_the_commands_of_slicemask_know_slicematch():
    for name, others in graph().items():
        if name.startswith("slicemask") and not name.startswith("slicemask.cli"):
            assert not [other for other in others if other.startswith("slicematch")], name
