"""What importing slicemask does, and the names it promises."""

import subprocess
import sys

import slicemask


def test_importing_loads_no_torch_click_or_matplotlib():
    code = (
        "import sys, slicemask\n"
        "unwanted = {'torch', 'click', 'matplotlib', 'rich', 'shapely', 'scipy'}\n"
        "print(*unwanted & set(sys.modules))"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.split() == []


def test_importing_the_command_leaves_the_interpreter_as_it_was():
    code = (
        "import gc, sys\n"
        "before = sys.getswitchinterval()\n"
        "import slicemask.cli.main\n"
        "on = gc.isenabled()\n"
        "del sys.modules['slicemask.cli.main']\n"
        "gc.disable()\n"
        "import slicemask.cli.main\n"
        "print(on, gc.isenabled(), gc.get_freeze_count(), sys.getswitchinterval() == before)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.split() == ["True", "False", "0", "True"]


def test_public_names():
    # A name taken out of this list breaks somebody's code: do it on purpose, and in a changelog.
    assert slicemask.__all__ == [
        "Bank", "BankError", "BankExistsError", "BankFormatError", "BankSpec", "BuildResult",
        "Frustum", "PlotError", "PoseError", "PoseGrid", "SlicemaskError", "SpecError",
        "__version__", "build_bank", "open_bank", "read_poses", "slice_masks",
    ]  # fmt: skip
    assert all(hasattr(slicemask, name) for name in slicemask.__all__)
