"""What commands say while they work."""

import io
from functools import partial

import pytest

from slicemask.cli.output import progress_bar, status_line
from slicemask.progress import TimedLines, readable_time


def test_off_a_terminal_a_line_comes_every_half_minute(monkeypatch, capsys):
    seconds = 0.0

    def clock():
        return seconds

    monkeypatch.setattr("slicemask.cli.output.TimedLines", partial(TimedLines, clock=clock))
    with progress_bar("evaluating", "samples") as progress:
        for done in range(1, 1001):
            seconds = done * 0.25
            progress(done, 1000)
    out, err = capsys.readouterr()
    assert out == ""
    lines = err.splitlines()
    assert len(lines) == 8  # of 250 seconds
    assert lines[0] == "evaluating: 120 of 1,000 samples, about 4 min left"
    assert lines[-1] == "evaluating: 960 of 1,000 samples, about 10 s left"


def test_short_work_off_a_terminal_is_done_in_silence(capsys):
    with progress_bar("building", "poses") as progress, status_line("loading torch") as say:
        for done in range(101):
            progress(done, 100)
        progress(0, 0)
        assert say is None
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.2, "0 s"), (45, "45 s"), (99.4, "99 s"), (130, "2 min"), (3000, "50 min"), (9000, "2.5 h")],
)
def test_times_as_people_read_them(seconds, text):
    assert readable_time(seconds) == text


def test_on_a_terminal_there_is_a_line_at_once_and_nothing_at_the_end(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    with status_line("loading torch") as say:
        first = terminal.getvalue()
        say("scoring poses")
    assert "loading torch ..." in first
    assert "scoring poses ..." in terminal.getvalue()
    assert terminal.getvalue().endswith("\x1b[2K")  # the line is removed
