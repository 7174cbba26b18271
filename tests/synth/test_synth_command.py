"""slicemask synth, as a user types it, and what importing slicemask leaves alone."""

import json
import signal
import subprocess
import sys
import time

import pytest
from click.testing import CliRunner

from slicemask.cli.main import main

SMALL = ["--panoramas", "1", "--panorama-size", "64x32", "--tile-size", "32", "--jobs", "1"]


def run(*arguments):
    return CliRunner().invoke(main, ["synth", *map(str, arguments)])


def test_generates_then_says_that_all_is_there(tmp_path):
    first = run("--format", "vigor", *SMALL, "--out", tmp_path / "city", "--json")
    assert first.exit_code == 0, first.output
    content = json.loads(first.stdout)
    assert content["images"] == content["rendered"] == 5
    again = run("--format", "vigor", *SMALL, "--out", tmp_path / "city")
    assert "5 images, 0 of them rendered now" in again.output


def test_two_at_once_make_one_data_set(tmp_path):
    command = [
        sys.executable,
        "-c",
        "from slicemask.cli.main import main; main()",
        "synth",
        "--format",
        "vigor",
    ]
    both = [
        subprocess.Popen([*command, *SMALL, "--out", tmp_path / "city"], stderr=subprocess.PIPE)
        for _ in range(2)
    ]
    assert [(one.communicate()[1], one.returncode) for one in both] == [(b"", 0)] * 2
    assert (
        "0 of them rendered now"
        in run("--format", "vigor", *SMALL, "--out", tmp_path / "city").output
    )
    assert list((tmp_path / "city").rglob(".*")) == []


def test_errors_are_one_sentence(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    result = run("--format", "vigor", *SMALL, "--out", tmp_path)
    assert result.exit_code == 1
    assert result.output.startswith("Error: ")
    assert "is not empty" in result.output
    assert "Traceback" not in result.output


def test_options_of_the_other_format_are_refused(tmp_path):
    result = run("--format", "kitti", "--panoramas", 3, "--out", tmp_path / "drive")
    assert result.exit_code == 2
    assert "--panoramas does not belong to --format kitti" in result.output
    assert not (tmp_path / "drive").exists()
    result = run("--format", "vigor", "--panorama-size", "large", "--out", tmp_path / "city")
    assert result.exit_code == 2
    assert "is not COLUMNSxROWS" in result.output


def test_importing_slicemask_loads_no_part_of_it():
    code = (
        "import sys, slicemask\n"
        "parts = ('trimesh', 'embreex', 'slicemask.synth')\n"
        "print(*(name for name in sys.modules if name.startswith(parts)))"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.split() == []


def test_without_the_extra_the_command_says_what_to_install(tmp_path):
    code = (
        "import sys\n"
        "sys.modules['trimesh'] = None\n"
        "from slicemask.cli.main import main\n"
        f"main(['synth', '--format', 'vigor', '--out', {str(tmp_path / 'city')!r}])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert found.returncode == 1
    assert found.stderr == (
        "Error: slicemask synth needs trimesh: pip install 'slicemask[synth]'\n"
    )


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_a_city_of_many_places_stops_between_two_images(tmp_path):
    # Each place is one task of a process that renders, and these two begin at once.
    arguments = (
        "--format", "vigor", "--cities", "1", "--places", "2", "--panoramas", "60", "--jobs", "2",
        "--panorama-size", "64x32", "--tile-size", "64", "--seed", "3", "--out", str(tmp_path),
    )  # fmt: skip
    process = subprocess.Popen(
        [sys.executable, "-m", "slicemask", "synth", *arguments], stderr=subprocess.DEVNULL
    )
    while not any(tmp_path.rglob("*.jpg")) and process.poll() is None:
        time.sleep(0.02)
    process.terminate()
    assert process.wait() == 128 + signal.SIGTERM
    assert 0 < len(list(tmp_path.rglob("panorama/*.jpg"))) < 60
    assert not list(tmp_path.rglob(".*.jpg*")), "a picture that was begun is left behind"
