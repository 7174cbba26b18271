import subprocess
import sys

import pytest

ASK = ["predict", "generated-city", "--example", "1", "--grid", "2x2x4"]


@pytest.mark.parametrize(
    ("call", "left_out"), [("main()", True), (f"main({ASK!r}, standalone_mode=False)", False)]
)
def test_only_the_command_itself_does_without(call, left_out):
    """Wherever its program lies: a process that hands arguments over may need what is left out."""
    code = (
        "import sys\n"
        f"sys.argv = ['anything', *{ASK!r}]\n"
        "from slicemask.cli.main import main\n"
        f"try: {call}\n"
        "except SystemExit as end: assert not end.code, end.code\n"
        "print(sys.modules['huggingface_hub'] is None, type(sys.modules['torch._dynamo']).__name__)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    expected = "True _StandIn" if left_out else "False module"
    assert found.stdout.splitlines()[-1] == expected
