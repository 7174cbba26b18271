"""The benchmarks' command: what it says on its way, and what it keeps."""

import json
import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from benchmarks import __main__ as command
from benchmarks.figure import Figure

CODE = """
import sys
from pathlib import Path
from benchmarks import __main__ as command
from benchmarks.figure import Figure
command.TABLES.clear()
command.TABLES["quick"] = lambda: [Figure("poses", "5")]
command.RESULTS = Path(sys.argv[1])
command.main([], standalone_mode=False)
"""


@pytest.fixture
def tables(monkeypatch, tmp_path):
    """Two tables that take no time."""

    def quick():
        """Quick figures."""
        return [Figure("poses a second", "5", "4", met=True)]

    monkeypatch.setattr(command, "TABLES", {"quick": quick, "none": list})
    monkeypatch.setattr(command, "RESULTS", tmp_path / "results")
    return tmp_path / "results"


def test_off_a_terminal_each_table_is_a_line(tables):
    result = CliRunner().invoke(command.main, [])
    assert result.exit_code == 0, result.output
    assert result.stderr.splitlines() == [
        "measuring quick, table 1 of 2",
        "measuring none, table 2 of 2",
    ]
    assert "Quick figures" in result.stdout
    assert "none: this machine has nothing to measure it on" in result.stdout
    (figure,) = json.loads((tables / "quick.json").read_text())["figures"]
    assert figure == {"what": "poses a second", "measured": "5", "target": "4", "met": True}


@pytest.mark.skipif(sys.platform == "win32", reason="terminals")
def test_on_a_terminal_a_bar_stands(tmp_path):
    terminal, theirs = pty.openpty()
    root = Path(command.__file__).parent.parent
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "80"}
    subprocess.run(
        [sys.executable, "-c", CODE, str(tmp_path)],
        stderr=theirs, stdout=subprocess.DEVNULL, env=environment, cwd=root, check=True,
    )  # fmt: skip
    os.close(theirs)
    shown = os.read(terminal, 100_000).decode()
    os.close(terminal)
    assert "measuring quick" in shown
    assert "0/1" in shown
    assert "1/1" in shown
