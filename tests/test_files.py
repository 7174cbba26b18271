"""Files that are written whole or not at all, and where they can go."""

import os

import pytest

from slicemask.errors import OutputError, PlotError
from slicemask.files import atomic_write, check_folder, check_target, write_text


def test_a_name_that_leaves_no_room_for_the_partial_one_is_refused_before_the_work(tmp_path):
    # 252 bytes are a name; with the dot, the process and the suffix they are none.
    with pytest.raises(PlotError, match="is invalid: File name too long; name another file"):
        check_target(tmp_path / f"{'a' * 248}.png", (".png",), PlotError)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("a.txt", r"its suffix is \.txt; name a file that ends in \.png or \.svg"),
        ("a", "its suffix is missing"),
        ("folder.png", "is a folder; name a file"),
        ("nowhere/a.png", "nowhere: there is no such folder"),
    ],
)
def test_targets_that_cannot_be(tmp_path, name, words):
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(PlotError, match=words):
        check_target(tmp_path / name, (".png", ".svg"), PlotError)


def test_a_folder_need_not_be_there(tmp_path):
    assert check_folder(tmp_path / "a" / "b", OutputError) == tmp_path / "a" / "b"
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("name", ["file", "file/a/b"])
def test_a_folder_is_no_file_nor_in_one(tmp_path, name):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="/file: is not a folder; name another one"):
        check_folder(tmp_path / name, OutputError)


def test_a_folder_with_too_long_a_name(tmp_path):
    with pytest.raises(OutputError, match="is invalid: File name too long; name another folder"):
        check_folder(tmp_path / ("a" * 300), OutputError)


@pytest.mark.parametrize("error", [KeyboardInterrupt, ArithmeticError])
def test_an_error_leaves_the_old_file_alone(tmp_path, error):
    path = tmp_path / "a.txt"
    path.write_text("old")

    def write():
        with atomic_write(path, OutputError) as partial:
            partial.write_text("new")
            raise error

    with pytest.raises(error):
        write()
    assert os.listdir(tmp_path) == ["a.txt"]
    assert path.read_text() == "old"


def test_a_file_that_cannot_be_written_is_told_with_its_remedy(tmp_path):
    with pytest.raises(OutputError, match="cannot be written: No such file or directory; pray"):
        write_text(tmp_path / "nowhere" / "a.txt", "all", OutputError, "pray")


def test_a_link_is_replaced_and_not_what_it_leads_to(tmp_path):
    (tmp_path / "old").write_text("old")
    (tmp_path / "link").symlink_to("old")
    write_text(tmp_path / "link", "new\r\n", OutputError)
    assert (tmp_path / "old").read_text() == "old"
    assert (tmp_path / "link").read_bytes() == b"new\r\n"
    assert sorted(os.listdir(tmp_path)) == ["link", "old"]
