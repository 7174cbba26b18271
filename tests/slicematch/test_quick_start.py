import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    ("program", "left_out"), [("/usr/bin/slicemask", True), ("mine.py", False)]
)
def test_only_the_command_itself_does_without(program, left_out):
    code = (
        "import sys\n"
        f"sys.argv = [{program!r}]\n"
        "from slicematch._quick_start import start_quickly\n"
        "start_quickly()\n"
        "print(sys.modules.get('huggingface_hub', 'not asked for'))\n"
        "print(type(sys.modules.get('torch._dynamo')).__name__)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    expected = ["None", "_StandIn"] if left_out else ["not asked for", "NoneType"]
    assert found.stdout.split("\n")[:2] == expected
