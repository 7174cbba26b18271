"""The commands of the toolkit, as a user types them."""

import json
import subprocess
import sys

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from slicemask import open_bank
from slicemask.bank.seal import write_seal
from slicemask.cli.main import main

SMALL = ["build", "--grid", "3x3x8", "--slices", "4", "--cells", "4"]


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Run a command in an empty folder; give its result."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("SLICEMASK_CACHE", raising=False)

    def invoke(*arguments):
        result = CliRunner().invoke(main, [str(argument) for argument in arguments])
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        return result

    return invoke


@pytest.fixture
def bank(run, tmp_path):
    """Path of a small bank in masks_cache."""
    assert run(*SMALL).exit_code == 0
    return tmp_path / "masks_cache" / "3x3x8_hfov360_n4_l4.h5"


def sentence(result):
    """The one sentence of a failed command."""
    assert result.exit_code != 0
    assert "Traceback" not in result.output
    (line,) = [line for line in result.output.splitlines() if line.startswith("Error: ")]
    return line


def test_build_says_what_it_built_and_then_that_it_is_there(run, bank):
    assert bank.exists()
    again = run(*SMALL)
    assert again.exit_code == 0
    assert "already exists and matches" in again.output
    stamp = bank.stat().st_mtime_ns
    forced = run(*SMALL, "--force")
    assert "built in" in forced.output
    assert bank.stat().st_mtime_ns != stamp
    assert [path.name for path in bank.parent.iterdir()] == [bank.name]


def test_a_build_leaves_the_threads_turns_as_they_were(run):
    before = sys.getswitchinterval()
    assert run(*SMALL).exit_code == 0
    assert sys.getswitchinterval() == before


def test_build_as_json(run):
    content = json.loads(run(*SMALL, "--json").output)
    assert content["poses"] == 72
    assert content["masks"] == 288
    assert content["distinct_masks"] == 72
    assert content["reused"] is False
    assert json.loads(run(*SMALL, "--json").output)["reused"] is True


def test_where_banks_go(run, tmp_path, monkeypatch):
    assert run(*SMALL, "--cache", "here").exit_code == 0
    monkeypatch.setenv("SLICEMASK_CACHE", str(tmp_path / "there"))
    assert run(*SMALL).exit_code == 0
    assert run(*SMALL, "--out", "mine.h5").exit_code == 0
    for path in ("here/3x3x8_hfov360_n4_l4.h5", "there/3x3x8_hfov360_n4_l4.h5", "mine.h5"):
        with open_bank(tmp_path / path) as opened:
            assert len(opened) == 72
    assert not (tmp_path / "masks_cache").exists()


def test_headings_in_radians_are_warned_about_on_stderr(tmp_path):
    (tmp_path / "poses.csv").write_text("u\tv\theading_deg\n0.5\t0.5\t1.57\n0.5\t0.5\t3.14\n")
    ran = subprocess.run(
        [sys.executable, "-m", "slicemask", "build", "--poses", "poses.csv", "--cache", "new/er"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    assert ran.stderr.startswith("poses.csv: all headings lie within 0 and 2 pi")
    assert "built" in ran.stdout


def test_names_tell_banks_apart(run, tmp_path):
    more = (
        [], ["--extent", "0.2,0.2,0.8,0.8"], ["--places", "endpoints"], ["--engine", "rays"],
        ["--hfov", "81.5", "--projection", "pinhole"], ["--hfov", "81.5"], ["--cells", "5"],
    )  # fmt: skip
    for options in more:
        assert "built in" in run(*SMALL, *options).output
    assert len(list((tmp_path / "masks_cache").iterdir())) == len(more)


def test_poses_from_csv_and_npy_give_one_bank(run, tmp_path):
    (tmp_path / "poses.csv").write_text("u,v,heading_deg\n0.25,0.5,90\n0.125,0,-45\n")
    np.save(tmp_path / "poses.npy", [[0.25, 0.5, 90.0], [0.125, 0.0, 315.0]])
    options = ("--slices", 8, "--cells", 20)
    assert run("build", "--poses", "poses.csv", *options, "--out", "a.h5").exit_code == 0
    assert run("build", "--poses", "poses.npy", *options, "--out", "b.h5").exit_code == 0
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()


def test_info(run, bank):
    text = run("info", bank).output
    assert "72 (3x3x8)" in text
    assert "288, 72 of them distinct" in text
    content = json.loads(run("info", bank, "--json").output)
    assert content["spec"]["frustum"] == {
        "hfov_deg": 360.0, "projection": "equirectangular", "slices": 4,
    }  # fmt: skip
    assert content["distinct_masks"] == 72
    assert content["bytes"] == bank.stat().st_size


def test_verify_uses_the_other_engine(run, bank, tmp_path):
    result = run("verify", bank)
    assert result.exit_code == 0
    assert "288 masks of 72 poses recomputed with rays" in result.output
    assert run(*SMALL, "--engine", "rays").exit_code == 0
    other = bank.with_name("3x3x8_hfov360_n4_l4_rays.h5")
    content = json.loads(run("verify", other, "--sample", "10", "--json").output)
    assert content["engine"] == "shapely"
    assert content["poses"] == 3
    assert content["passed"] is True


@pytest.mark.parametrize("where", ["masks/data", "index"])
def test_verify_finds_a_wrong_mask_in_a_sealed_bank(run, bank, where):
    with h5py.File(bank, "r+") as file:
        values = file[where][:]
        if where == "index":
            values[[0, 1]] = values[[1, 0]]
        else:
            values[values < 1] *= 0.999999
        file[where][:] = values
    write_seal(bank, 1)
    result = run("verify", bank, "--all")
    assert result.exit_code == 1
    assert "are wrong, first slice" in result.output
    assert json.loads(run("verify", bank, "--json").output)["passed"] is False


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--grid", "21x21"], "grid is '21x21'"),
        (["--grid", "0x3x3"], "rows is 0"),
        (["--grid", "3x3x3", "--hfov", "400"], "hfov is 400.0 degrees"),
        (["--grid", "3x3x3", "--hfov", "0"], "hfov is 0.0 degrees"),
        (["--grid", "3x3x3", "--hfov", "200", "--projection", "pinhole"], "less than 180"),
        (["--grid", "3x3x3", "--slices", "0"], "slices is 0"),
        (["--grid", "3x3x3", "--cells", "0"], "cells is 0"),
        (["--grid", "3x3x3", "--jobs", "0"], "jobs is 0"),
        (["--grid", "3x3x3", "--extent", "0.8,0,0.2,1"], "extent is 0.8,0,0.2,1"),
        (["--grid", "3x3x3", "--extent", "0,0,1"], "'0,0,1' is not u0,v0,u1,v1"),
        (["--grid", "99999x99999x999"], "choose fewer"),
        (["--poses", "none.csv"], "none.csv: there is no such file"),
        (["--grid", "3x3x3", "--poses", "poses.csv"], "either --grid"),
        ([], "either --grid"),
        (["--poses", "poses.csv", "--places", "endpoints"], "belong to --grid"),
        (["--grid", "3x3x3", "--out", "no/such/folder.h5"], "no/such: there is no such folder"),
        (["--grid", "3x3x3", "--out", "."], "is a folder"),
        (["--grid", "3x3x3", "--engine", "voxels"], "'voxels' is not one of 'shapely', 'rays'"),
    ],
)
def test_what_cannot_be_built_is_said_in_a_sentence(run, tmp_path, options, message):
    assert message in sentence(run("build", *options))
    assert list(tmp_path.rglob("*")) == []


def test_a_file_that_is_no_bank_is_kept(run, tmp_path):
    (tmp_path / "thesis.txt").write_text("years of work")
    for force in ([], ["--force"]):
        message = sentence(run(*SMALL, "--out", "thesis.txt", *force))
        assert "exists and is not a slicemask bank" in message
    assert (tmp_path / "thesis.txt").read_text() == "years of work"


def test_another_bank_is_replaced_only_by_force(run, bank):
    other = ["build", "--grid", "2x2x4", "--slices", "4", "--cells", "4", "--out", bank]
    message = sentence(run(*other))
    assert "3x3x8" in message
    assert "2x2x4" in message
    assert run(*other, "--force").exit_code == 0
    with open_bank(bank) as opened:
        assert len(opened) == 16


@pytest.mark.parametrize("command", ["info", "verify", "visualize"])
def test_banks_that_cannot_be_read(run, tmp_path, bank, command):
    assert "there is no such bank" in sentence(run(command, "none.h5"))
    (tmp_path / "empty.h5").touch()
    assert "empty.h5: is empty" in sentence(run(command, "empty.h5"))
    (tmp_path / "text.h5").write_text("not a bank at all")
    assert "is not a slicemask bank" in sentence(run(command, "text.h5"))
    content = bank.read_bytes()
    (tmp_path / "cut.h5").write_bytes(content[:-100])
    assert "cut short" in sentence(run(command, "cut.h5"))
    altered = bytearray(content)
    altered[len(content) // 2] ^= 1
    (tmp_path / "altered.h5").write_bytes(altered)
    assert "was altered" in sentence(run(command, "altered.h5"))
    newer = content.replace(b"slicemask-bank 1\n", b"slicemask-bank 2\n", 1)
    (tmp_path / "newer.h5").write_bytes(newer)
    assert "version 2" in sentence(run(command, "newer.h5"))
    with h5py.File(tmp_path / "foreign.h5", "w") as file:
        file["x"] = 1
    assert "HDF5 file but not a slicemask bank" in sentence(run(command, "foreign.h5"))


def test_visualize_the_newest_bank_and_any_pose(run, tmp_path, bank):
    assert run("visualize").exit_code == 0
    assert (tmp_path / "3x3x8_hfov360_n4_l4_pose-36.png").exists()
    Image.new("RGB", (64, 64), "darkgreen").save(tmp_path / "tile.png")
    result = run("visualize", bank, "--pose", "1,1,2", "--aerial", "tile.png", "--out", "one.png")
    assert "u 0.5, v 0.5, heading 90 degrees" in result.output
    at = ["visualize", "--at", "0.66,0.70,0", "--hfov", "81.5", "--projection", "pinhole"]
    content = json.loads(run(*at, "--out", "two.svg", "--json").output)
    assert content == {"path": "two.svg", "pose": {"u": 0.66, "v": 0.7, "heading_deg": 0.0}}
    assert (tmp_path / "two.svg").read_text().lstrip().startswith("<?xml")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--pose", "9,9,9"], "pose 9,9,9 is not in the grid 3x3x8"),
        (["--pose", "72"], "pose 72 is not in the bank"),
        (["--pose", "1,2"], "pose is '1,2'"),
        (["--pose", "9" * 5000], "row,column,heading"),
        (["--hfov", "90"], "--hfov belongs to --at"),
        (["--at", "0.5,0.5"], "'0.5,0.5' is not u,v,heading_deg"),
        (["--at", "0.5,1.5,0"], "outside the tile"),
        (["--at", "0.5,0.5,0", "--pose", "1"], "--at needs no BANK"),
        (["--aerial", "none.png"], "none.png"),
        (["--out", "figure.docx"], "figure.docx"),
        (["--out", "nowhere/figure.png"], "nowhere"),
    ],
)
@pytest.mark.usefixtures("bank")
def test_what_cannot_be_drawn_is_said_in_a_sentence(run, tmp_path, options, message):
    before = sorted(tmp_path.rglob("*"))
    assert message in sentence(run("visualize", *options))
    assert sorted(tmp_path.rglob("*")) == before


def test_visualize_without_a_bank_says_how_to_build_one(run):
    assert "slicemask build" in sentence(run("visualize"))


def test_the_installed_command_prints_no_bar_into_a_pipe(tmp_path):
    found = subprocess.run(
        [sys.executable, "-m", "slicemask", *SMALL], cwd=tmp_path, capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    assert found.stderr == ""
    assert found.stdout.count("\n") == 1


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--hfov", "6.2832"], "as if it were in radians; in degrees that is 360"),
        (["--hfov", "1.4224"], "as if it were in radians; in degrees that is 81.5"),
        (["--hfov", "81.5"], "a camera's have equal widths: --projection pinhole"),
        (["--hfov", "63.4"], "a camera's have equal widths: --projection pinhole"),
        ([], None),
        (["--hfov", "90"], None),
        (["--hfov", "360"], None),
        (["--hfov", "5"], None),
        (["--hfov", "81.5", "--projection", "pinhole"], None),
        (["--hfov", "81.5", "--projection", "equirectangular"], None),
    ],
)
@pytest.mark.parametrize(
    "command", [["build", "--grid", "1x1x1", "--cells", "4"], ["visualize", "--at", "0.5,0.5,0"]]
)
def test_fields_of_view_that_are_almost_surely_slips(run, caplog, command, options, said):
    result = run(*command, "--slices", "2", *options)
    assert result.exit_code == 0
    assert [said in record.getMessage() for record in caplog.records] == [True] * bool(said)
