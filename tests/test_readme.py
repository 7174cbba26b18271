"""The documentation's Python and commands, run as they are written.

What takes minutes (training, generated cities) is parsed instead: every command and option that a
page names has to exist.
"""

import ast
import importlib
import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import click
import numpy as np
import pytest
from PIL import Image

from slicemask.cli.main import main

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]
SCRIPTS = sorted(path for kind in ("tutorials", "gallery") for path in (DOCS / kind).glob("*.py"))
OLD_RUN = ROOT / "tests" / "slicematch" / "runs" / "data" / "vigor_run_v1"
CHEAP = ("build", "info", "verify", "visualize")


def _blocks(page, language):
    """Return the fenced blocks of a page in a language, "" for those that name none."""
    found = re.findall(r"^( *)```(\w*)\n(.*?)^ *```$", page.read_text(), re.DOTALL | re.MULTILINE)
    return [
        "".join(line.removeprefix(indent) for line in text.splitlines(keepends=True))
        for indent, name, text in found
        if name == language
    ]


def _commands(page, *programs):
    """Return the lines of a page's blocks that call these programs, as lists of words."""
    found = []
    for block in _blocks(page, ""):
        for line in block.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            if words and words[0] in programs:
                found.append(words)
    return found


@pytest.fixture
def workplace(tmp_path, monkeypatch):
    """A folder with what the README's examples name: poses, images, and a trained run."""
    random = np.random.default_rng(0)
    (tmp_path / "poses.csv").write_text("u,v,heading_deg\n0.5,0.5,10\n0.2,0.3,200\n")
    for name, shape in {"tile.png": (64, 64, 3), "pano.jpg": (32, 64, 3)}.items():
        Image.fromarray(random.integers(0, 256, shape, dtype=np.uint8)).save(tmp_path / name)
    shutil.copytree(OLD_RUN, tmp_path / "runs" / "vigor")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("SLICEMASK_CACHE", raising=False)
    return tmp_path


@pytest.fixture(scope="module")
def banks(tmp_path_factory):
    """One cache for all pages: they build the same bank."""
    return tmp_path_factory.mktemp("banks")


def _run_python(page):
    """Run a page's Python from top to bottom; what it leaves, by name."""
    names = {}
    blocks = _blocks(page, "python")
    assert blocks
    for block in blocks:
        exec(compile(block, page.name, "exec"), names)
    return names


def test_the_readme_s_python_runs_as_written(workplace, banks, monkeypatch):
    pytest.importorskip("torch")
    monkeypatch.setenv("SLICEMASK_CACHE", str(banks))
    names = _run_python(ROOT / "README.md")
    assert names["rows"].shape == (28224, 1024)
    assert names["estimate"].pose.shape == (3,)


def test_the_python_of_other_pages_runs_as_written(workplace, banks, monkeypatch):
    pytest.importorskip("torch")
    monkeypatch.setenv("SLICEMASK_CACHE", str(banks))
    assert _run_python(DOCS / "index.md")["masks"].shape == (1, 16, 32, 32)
    assert _run_python(DOCS / "howto" / "masks-and-banks.md")["area"].shape == (28224, 16)
    assert _run_python(DOCS / "howto" / "answers-on-the-map.md")["estimate"].pose.shape == (3,)


@pytest.mark.filterwarnings("ignore:Sparse")  # torch says that its CSR tensors are in beta
def test_both_ways_into_torch_are_what_slicemask_says_they_are(workplace, banks, monkeypatch):
    pytest.importorskip("torch")
    monkeypatch.setenv("SLICEMASK_CACHE", str(banks))
    from slicemask import open_bank

    names = _run_python(DOCS / "howto" / "masks-in-torch.md")
    assert names["descriptors"].shape == (2, 16, 64)
    names["descriptors"].square().sum().backward()
    assert (names["poses"].grad != 0).all()
    with open_bank(names["built"].path) as bank:
        one = bank.masks(1234).reshape(16, -1)
    features = names["features"].detach().flatten(1).numpy()
    pooled = names["pooled"].detach().numpy()[names["index"][1234]]
    np.testing.assert_allclose(pooled, one @ features.T, rtol=1e-5, atol=1e-4)
    names["pooled"].sum().backward()
    assert (names["features"].grad > 0).all()
    assert names["scores"].shape == (2, 28224)


@pytest.mark.slow
def test_the_commands_on_banks_run_as_written(workplace):
    page = DOCS / "howto" / "masks-and-banks.md"
    (block,) = [text for text in _blocks(page, "") if "slicemask build" in text]
    assert {line.split()[1] for line in _slicemask_lines(block)} == set(CHEAP)
    # A page may ask for as many poses as take a minute, a test runs with fewer.
    for many, fewer in (("64x64x64 --e", "16x16x64 --e"), ("128x", "16x"), ("15x15x", "5x5x")):
        assert many in block
        block = block.replace(many, fewer)
    _run_block(block, workplace)
    assert (workplace / "figure.png").exists()
    assert (workplace / "gt.h5").exists()
    assert list(workplace.glob("*.gif"))


@pytest.mark.slow
def test_the_predictions_run_as_written(workplace):
    pytest.importorskip("torch")
    page = DOCS / "howto" / "answers-on-the-map.md"
    (block,) = [text for text in _blocks(page, "") if "slicemask predict" in text]
    assert len(_slicemask_lines(block)) == 4
    _run_block(block, workplace)
    assert (workplace / "overlay.png").exists()
    assert (workplace / "pose.geojson").exists()


def _slicemask_lines(block):
    joined = block.replace("\\\n", " ").splitlines()
    return [line for line in joined if line.startswith("slicemask ")]


def _run_block(block, folder):
    """Run lines in a shell that finds the command, and stops at the first that fails."""
    call = f'slicemask() {{ "{sys.executable}" -m slicemask "$@"; }}\nset -eu\n'
    env = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'model'}"}
    done = subprocess.run(
        ["bash", "-c", call + block], cwd=folder, env=env, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_and_option_on_a_page_exists(page):
    for _, name, *args in _commands(page, "slicemask"):
        if name not in main.list_commands(click.Context(main)):
            raise AssertionError(f"{page.name}: slicemask has no command {name}")
        command = main.get_command(click.Context(main), name)
        try:
            command.make_context(name, list(args))
        except click.UsageError as error:
            raise AssertionError(f"{page.name}: {name} {args}: {error.message}") from error


@pytest.fixture(scope="module")
def options():
    """Every option of every command, and of the other programs that pages call."""
    context = click.Context(main)
    commands = [main, *(main.get_command(context, name) for name in main.list_commands(context))]
    found = {
        option
        for command in commands
        for param in command.params
        for option in (*param.opts, *param.secondary_opts)
    }
    torchrun = {"--nnodes", "--nproc-per-node", "--rdzv-backend", "--rdzv-endpoint"}
    srun = {"--nodes", "--ntasks-per-node"}
    benchmarks = {"--prior", "--sheet", "--single-every"}
    return found | torchrun | srun | benchmarks | {"--help", "--logdir"}


@pytest.mark.parametrize("page", PAGES + SCRIPTS, ids=lambda page: page.name)
def test_every_option_that_a_page_speaks_of_exists(page, options):
    named = set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", page.read_text()))
    assert named - options == set()


def test_the_workflows_run_targets_that_exist():
    targets = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE))
    run = set()
    for workflow in (ROOT / ".github" / "workflows").glob("*.yml"):
        run |= set(re.findall(r"run: make (\w+)", workflow.read_text()))
    assert {"test", "core", "lowest", "lint", "docs", "linkcheck"} <= run <= targets


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_target_and_module_on_a_page_exists(page):
    targets = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE))
    text = page.read_text()
    for _, target in _commands(page, "make"):
        assert target in targets
    assert set(re.findall(r"`make (\w+)", text)) <= targets
    for name in re.findall(r"python -m ((?:benchmarks|slicemask|slicematch)[\w.]*)", text):
        assert importlib.util.find_spec(name) is not None
    for name in re.findall(r"(?:python |pytest |[\s`])((?:examples|tests)/[\w/.]+\.py)", text):
        assert (ROOT / name).exists()


@pytest.mark.parametrize("page", PAGES + SCRIPTS, ids=lambda page: page.name)
def test_every_name_that_a_page_imports_exists(page):
    blocks = [page.read_text()] if page.suffix == ".py" else _blocks(page, "python")
    for block in blocks:
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.ImportFrom):
                needed = {"slicematch": "torch", "slicemask.synth": "trimesh"}
                for package, other in needed.items():
                    if node.module.startswith(package):
                        pytest.importorskip(other)
                module = importlib.import_module(node.module)
                assert [alias.name for alias in node.names if not hasattr(module, alias.name)] == []


def _leads_somewhere(name):
    """Whether a dotted name is a module, or something that is inside one."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for part in parts[count:]:
            if not hasattr(found, part):
                return False
            found = getattr(found, part)
        return True
    return False


def test_every_dotted_name_of_ours_leads_somewhere():
    pytest.importorskip("torch")
    pytest.importorskip("trimesh")
    sources = [*(ROOT / "slicemask").rglob("*.py"), *(ROOT / "model").rglob("*.py")]
    named = {
        (name, page.name)
        for page in [*PAGES, *SCRIPTS, *sources, *(DOCS / "reference").glob("*.rst")]
        for name in re.findall(r"`~?(slice(?:mask|match)(?:\.\w+)+)", page.read_text())
    }
    assert len(named) > 30
    # Files are named alike.
    named = {(name, page) for name, page in named if not name.endswith((".h5", ".py"))}
    assert [pair for pair in sorted(named) if not _leads_somewhere(pair[0])] == []


@pytest.mark.parametrize(
    "package", ["slicemask", "slicemask.plot", "slicemask.synth", "slicematch"]
)
def test_every_public_name_stands_in_the_reference(package):
    page = DOCS / "reference" / f"{package.partition('.')[0]}.rst"
    listed = set(page.read_text().split())
    names = importlib.import_module(package).__all__
    assert [name for name in names if name not in listed and not name.startswith("__")] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_relative_link_and_heading_on_a_page_exists(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        if target.startswith(("https://", "http://")):
            continue
        file, _, anchor = target.partition("#")
        linked = page.parent / file if file else page
        assert linked.exists(), f"{page.name}: {target}"
        if anchor:
            assert anchor in _anchors(linked), f"{page.name}: {target}"


def _anchors(page):
    headings = re.findall(r"^#+ (.*)$", page.read_text(), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_file_that_a_page_names_exists(page):
    text = page.read_text()
    folders = "slicemask|model|tests|docs|examples|benchmarks"
    paths = re.findall(rf"`((?:{folders})/[^`*]*)`", text)
    assert [path for path in paths if not (ROOT / path).exists()] == []
    # A bare name follows the path of its folder: "`.../coverage.py`, `rays.py`".
    known = {path.name for folder in folders.split("|") for path in (ROOT / folder).rglob("*.py")}
    known |= {path.name for path in ROOT.glob("*.py")}
    assert [name for name in re.findall(r"`(\w+\.py)`", text) if name not in known] == []


def test_the_bank_format_page_reads_a_bank_as_written(workplace):
    (block,) = _blocks(ROOT / "docs" / "bank-format.md", "python")
    from slicemask import Frustum, PoseGrid, build_bank, open_bank

    out = re.search(r'"(\S+\.h5)"', block)[1]
    build_bank(PoseGrid.parse("21x21x64"), Frustum(360, 16), 32, out=out)
    names = {}
    exec(compile(block, "bank-format.md", "exec"), names)
    with open_bank(out) as bank:
        assert (names["pose_slices"].toarray() == bank.masks(1234).reshape(16, -1)).all()
