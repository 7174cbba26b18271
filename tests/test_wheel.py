"""What users install: a wheel whose two names collide with nothing in their folders.

The wheel is built as a release builds it, and installed into an environment of its own, which has
the dependencies of this one but not the checkout.
"""

import email
import os
import re
import shutil
import subprocess
import sys
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# A module of this text says who imported it instead of one of ours, or of a dependency.
_HOSTILE = "raise SystemExit('the module ' + __name__ + ' of the user was imported')\n"

_PACKAGES = ("slicemask", "slicematch")
_BUILD = ["build", "--grid", "2x2x4", "--hfov", "360", "--cells", "8"]


class _Environment:
    """A virtual environment that borrows what is installed here, but no editable install."""

    def __init__(self, folder):
        self.folder = folder
        venv.create(folder, with_pip=False, symlinks=os.name == "posix")
        self.scripts = folder / ("Scripts" if os.name == "nt" else "bin")
        self.python = self.scripts / "python"
        # Python obeys the .pth files of this environment alone: those of editable installs in the
        # folders that it borrows from have no effect.
        installed = [path for path in sys.path if Path(path).name.endswith("-packages")]
        (self.site_packages / "borrowed.pth").write_text("\n".join(installed) + "\n")

    @property
    def site_packages(self):
        asked = "import sysconfig; print(sysconfig.get_path('purelib'))"
        return Path(_run([self.python, "-c", asked], cwd=self.folder).stdout.strip())

    def pip(self, *args):
        _run([sys.executable, "-m", "pip", "--python", self.python, *args], cwd=self.folder)

    def install(self, *args):
        self.pip("install", "--quiet", "--no-index", "--no-deps", "--no-build-isolation", *args)


def _run(args, cwd, check=True, **variables):
    env = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "SLICEMASK_"))}
    args = [str(arg) for arg in args]
    done = subprocess.run(args, cwd=cwd, env=env | variables, capture_output=True, text=True)
    if check and done.returncode != 0:
        raise AssertionError(f"{args} ended with {done.returncode}\n{done.stdout}{done.stderr}")
    return done


def _build_wheel(source, out):
    options = ["--quiet", "--no-index", "--no-deps", "--no-build-isolation", "--wheel-dir", out]
    _run([sys.executable, "-m", "pip", "wheel", *options, source], cwd=out)
    (wheel,) = out.glob("*.whl")
    return wheel


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    return _build_wheel(ROOT, tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    environment = _Environment(tmp_path_factory.mktemp("environment") / "venv")
    environment.install(wheel)
    return environment


@pytest.fixture
def hostile(wheel, tmp_path):
    """A user's folder with a module or a package of every name that ours have inside."""
    with zipfile.ZipFile(wheel) as file:
        inside = {part for name in file.namelist() for part in Path(name).with_suffix("").parts}
    names = {"cli", "model"} | {name for name in inside if name.isidentifier()}
    names -= {*_PACKAGES, *sys.stdlib_module_names}
    names = {name for name in names if not name.startswith("__")}
    assert {"errors", "bank", "data", "network", "train"} <= names
    for name in names:
        (tmp_path / f"{name}.py").write_text(_HOSTILE)
    (tmp_path / "model").mkdir()
    (tmp_path / "model" / "__init__.py").write_text(_HOSTILE)
    return tmp_path


def test_the_wheel_holds_two_names_and_their_types(wheel):
    with zipfile.ZipFile(wheel) as file:
        names = file.namelist()
    top = {name.split("/")[0] for name in names}
    assert {name for name in top if not name.endswith(".dist-info")} == set(_PACKAGES)
    for package in _PACKAGES:
        assert {f"{package}/py.typed", f"{package}/__init__.pyi"} <= set(names)


def test_the_wheel_holds_every_file_of_the_packages_and_no_other(wheel):
    with zipfile.ZipFile(wheel) as file:
        packed = {name for name in file.namelist() if ".dist-info/" not in name}
    ours = {"slicemask": ROOT / "slicemask", "slicematch": ROOT / "model" / "slicematch"}
    expected = {
        f"{package}/{path.relative_to(folder).as_posix()}"
        for package, folder in ours.items()
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert packed == expected


@pytest.fixture(scope="module")
def source_archive(tmp_path_factory):
    out = tmp_path_factory.mktemp("sdist")
    _run([sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", out], cwd=ROOT)
    (archive,) = out.glob("*.tar.gz")
    return archive


def test_the_source_archive_holds_the_documentation_and_nothing_built(source_archive):
    with tarfile.open(source_archive) as archive:
        packed = {name.split("/", 1)[1] for name in archive.getnames()}
    docs = {name for name in packed if name.startswith("docs/")}
    assert {"docs/conf.py", "docs/index.md", "docs/images/answer.jpg", "CITATION.cff"} <= packed
    for kind in ("**/*.md", "tutorials/*.py", "gallery/*.py", "reference/*.rst", "_templates/**/*"):
        found = (path for path in (ROOT / "docs").glob(kind) if path.is_file())
        assert {path.relative_to(ROOT).as_posix() for path in found} <= docs
    built = (
        "docs/auto_",
        "docs/reference/generated/",
        "docs/tutorials/runs/",
        "docs/gallery/data/",
    )
    assert [name for name in docs if name.startswith(built)] == []


def test_a_wheel_by_way_of_the_source_archive_is_the_same(wheel, source_archive, tmp_path):
    again = _build_wheel(source_archive, tmp_path)
    assert again.name == wheel.name
    assert again.read_bytes() == wheel.read_bytes()


def test_the_wheel_says_who_made_it_and_where(wheel):
    metadata = _metadata(wheel)
    assert metadata["Author"] or metadata["Author-email"]
    urls = dict(line.split(", ", 1) for line in metadata.get_all("Project-URL"))
    assert {"Source", "Documentation", "Changelog", "Issues"} <= set(urls)
    assert all(url.startswith("https://github.com/slicemask/slicemask") for url in urls.values())


def test_every_link_of_the_long_description_works_outside_the_repository(wheel):
    description = _metadata(wheel).get_payload()
    targets = _link_targets(description)
    assert [target for target in targets if not target.startswith("https://")] == []
    # Each link into the repository names a file that it has.
    base = re.compile(r"https://(?:github|raw\.githubusercontent)\.com/slicemask/slicemask/(.*)")
    files = [found[1] for target in targets if (found := base.match(target))]
    paths = [re.sub(r"^(?:blob/|raw/)?[^/]+/", "", file).split("#")[0] for file in files]
    assert len(paths) >= 10
    assert [path for path in paths if not (ROOT / path).exists()] == []
    # A picture is the file itself, not the page that shows it.
    pictures = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", description)
    assert pictures
    assert all(target.startswith("https://raw.githubusercontent.com/") for target in pictures)


def _metadata(wheel):
    with zipfile.ZipFile(wheel) as file:
        (name,) = [name for name in file.namelist() if name.endswith(".dist-info/METADATA")]
        return email.message_from_string(file.read(name).decode())


def _link_targets(markdown):
    inline = re.findall(r"\]\(([^)\s]+)", markdown)
    references = re.findall(r"^\[[^\]]+\]:\s*(\S+)", markdown, flags=re.MULTILINE)
    html = re.findall(r"(?:src|href)=[\"']([^\"']+)", markdown)
    return inline + references + html


@pytest.mark.parametrize("python_path", ["", "."])
def test_the_command_builds_in_a_hostile_folder(installed, hostile, python_path):
    command = installed.scripts / "slicemask"
    _run([command, *_BUILD, "--out", "bank.h5"], cwd=hostile, PYTHONPATH=python_path)
    done = _run([command, "info", "bank.h5", "--json"], cwd=hostile, PYTHONPATH=python_path)
    assert '"poses": 16' in done.stdout


@pytest.mark.parametrize("python_path", ["", "."])
def test_python_finds_both_packages_in_a_hostile_folder(installed, hostile, python_path):
    code = "import slicemask, slicematch; print(slicemask.__file__, slicematch.__file__)"
    done = _run([installed.python, "-c", code], cwd=hostile, PYTHONPATH=python_path)
    expected = [installed.site_packages / name / "__init__.py" for name in _PACKAGES]
    assert [Path(file) for file in done.stdout.split()] == expected


@pytest.mark.parametrize("package", _PACKAGES)
def test_everything_public_works_in_a_hostile_folder(installed, hostile, package):
    if package == "slicematch":
        pytest.importorskip("torch")
    # Names are loaded on first use: so are what the packages import inside.
    code = f"import {package} as it; print(*(getattr(it, name) and name for name in it.__all__))"
    done = _run([installed.python, "-c", code], cwd=hostile, PYTHONPATH=".")
    assert len(done.stdout.split()) > 5


def test_the_module_is_the_command(installed, hostile):
    module = _run([installed.python, "-m", "slicemask", "--version"], cwd=hostile, PYTHONPATH=".")
    script = _run([installed.scripts / "slicemask", "--version"], cwd=hostile, PYTHONPATH=".")
    assert module.stdout == script.stdout
    assert re.fullmatch(r"slicemask, version \d+\.\d+\S*\n", module.stdout)


def test_another_package_with_the_same_files_comes_and_goes(wheel, tmp_path):
    environment = _Environment(tmp_path / "venv")
    other = tmp_path / "other"
    (other / "model").mkdir(parents=True)
    (other / "cli.py").write_text("def main():\n    print('other tool, version 9')\n")
    (other / "model" / "__init__.py").write_text("")
    (other / "model" / "localizer.py").write_text("")
    (other / "pyproject.toml").write_text(
        "[build-system]\nrequires = ['hatchling']\nbuild-backend = 'hatchling.build'\n"
        "[project]\nname = 'other-tool'\nversion = '9'\n"
        "[tool.hatch.build.targets.wheel]\nonly-include = ['cli.py', 'model']\n"
    )
    before = _shown_version(environment, wheel)
    environment.install(other)
    assert (environment.site_packages / "cli.py").exists()
    with_it = _run([environment.scripts / "slicemask", "--version"], cwd=tmp_path).stdout
    environment.pip("uninstall", "--quiet", "--yes", "other-tool")
    assert not (environment.site_packages / "cli.py").exists()
    after = _run([environment.scripts / "slicemask", "--version"], cwd=tmp_path).stdout
    assert before == with_it == after
    _run([environment.scripts / "slicemask", *_BUILD, "--out", "bank.h5"], cwd=tmp_path)


def _shown_version(environment, wheel):
    environment.install(wheel)
    return _run([environment.scripts / "slicemask", "--version"], cwd=environment.folder).stdout


def _clone(folder):
    """Copy what a clone holds: the packages, `cli.py` and what the build reads."""
    folder.mkdir()
    for name in ("slicemask", "model"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("cli.py", "pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, folder / name)
    return folder


def test_an_editable_install_works_from_the_folder_that_holds_the_clone(tmp_path):
    # There, `slicemask` is the clone, a folder without __init__.py. Python takes such a folder
    # only if no package of that name comes later, and the editable install is one: a plain path.
    clone = _clone(tmp_path / "slicemask")
    environment = _Environment(tmp_path / "venv")
    environment.install("--editable", clone)
    code = "import slicemask as it, slicematch; print(it.__file__, it.Frustum(90, 4).slices)"
    commands = [[environment.python, "-m", "slicemask"], [environment.scripts / "slicemask"]]
    for python_path in ("", "."):
        done = _run([environment.python, "-c", code], cwd=tmp_path, PYTHONPATH=python_path)
        assert done.stdout.split() == [str(clone / "slicemask" / "__init__.py"), "4"]
        for command in commands:
            done = _run([*command, *_BUILD, "--cache", "."], cwd=tmp_path, PYTHONPATH=python_path)
            assert "2x2x4" in done.stdout


def test_a_clone_runs_without_an_install(tmp_path):
    clone = _clone(tmp_path / "clone")
    python = _Environment(tmp_path / "venv").python
    absent = _run([python, "-c", "import slicemask"], cwd=tmp_path, check=False)
    assert "No module named 'slicemask'" in absent.stderr
    _run([python, "cli.py", *_BUILD, "--out", "from_clone.h5"], cwd=clone)
    _run([python, clone / "cli.py", *_BUILD, "--out", "from_elsewhere.h5"], cwd=tmp_path)
    _run([python, "-m", "slicemask", *_BUILD, "--out", "module.h5"], cwd=clone)
    banks = [clone / "from_clone.h5", tmp_path / "from_elsewhere.h5", clone / "module.h5"]
    assert len({bank.read_bytes() for bank in banks}) == 1
