"""Pose grids, lists and files, and the errors that name what is wrong with them."""

import numpy as np
import pytest

from slicemask import Frustum, PoseError, PoseGrid, SpecError, read_poses, slice_masks
from slicemask.geometry.poses import check_poses


def test_a_grid_lists_rows_then_columns_then_headings():
    poses = PoseGrid(1, 2, 2).poses()
    assert poses.tolist() == [[0.25, 0.5, 0], [0.25, 0.5, 180], [0.75, 0.5, 0], [0.75, 0.5, 180]]


def test_endpoints_and_extent():
    grid = PoseGrid.parse("3x2x1", extent=(0.25, 0.0, 0.75, 1.0), places="endpoints")
    assert grid.v.tolist() == [0.0, 0.5, 1.0]
    assert grid.u.tolist() == [0.25, 0.75]
    assert PoseGrid(1, 1, 1, places="endpoints").poses().tolist() == [[0.5, 0.5, 0.0]]


def test_the_paper_s_test_headings_are_the_grid_s():
    n, r = np.meshgrid(np.arange(16), np.arange(4))
    assert np.array_equal(np.unique(360 * n / 16 + 360 * r / 64), PoseGrid(1, 1, 64).headings_deg)


@pytest.mark.parametrize("text", ["", "21", "21x21", "21x21x", "21x21x64x2", "axbxc", "-1x2x3",
                                  "1.5x2x3", "21 21 64", "9999999999x1x1"])  # fmt: skip
def test_grid_text_that_is_none(text):
    with pytest.raises(SpecError, match=r"ROWSxCOLUMNSxHEADINGS.*such as 21x21x64"):
        PoseGrid.parse(text)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"rows": 0}, "rows is 0"),
        ({"headings": -3}, "headings is -3"),
        ({"columns": 2.5}, "columns is 2.5"),
        ({"extent": (0.5, 0, 0.5, 1)}, "0.5,0,0.5,1"),
        ({"extent": (0, 0, 1, 1.5)}, "0 <= v0 < v1 <= 1"),
        ({"extent": (0, 0, 1, float("nan"))}, "nan"),
        ({"extent": (0, 0, 1)}, "four numbers"),
        ({"places": "corners"}, "'corners'.*centres, endpoints"),
    ],
)
def test_grids_that_are_invalid(arguments, message):
    with pytest.raises(SpecError, match=message):
        PoseGrid(**({"rows": 2, "columns": 2, "headings": 2} | arguments))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0, 4), "hfov is 0"),
        ((360.1, 4), "360.1"),
        ((float("nan"), 4), "nan"),
        ((float("inf"), 4), "inf"),
        ((90, 0), "slices is 0"),
        ((90, 1.5), "slices is 1.5"),
        ((180, 4, "pinhole"), "less than 180"),
        ((90, 4, "fisheye"), "'fisheye'.*equirectangular, pinhole"),
    ],
)
def test_frusta_that_are_invalid(arguments, message):
    with pytest.raises(SpecError, match=message):
        Frustum(*arguments)


@pytest.mark.parametrize("cells", [0, -1, 2.0, 8193])
def test_cells_that_are_invalid(cells):
    with pytest.raises(SpecError, match=f"cells is {cells}"):
        slice_masks([[0.5, 0.5, 0]], Frustum(), cells)


def test_an_engine_that_there_is_not():
    with pytest.raises(SpecError, match=r"'voxels'.*shapely, rays"):
        slice_masks([[0.5, 0.5, 0]], Frustum(), 4, "voxels")


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        ([0.5, 1.2, 0], "pose 1 lies outside the tile: u=0.5, v=1.2"),
        ([-1e-9, 0.5, 0], "pose 1 lies outside"),
        ([0.5, float("nan"), 0], "pose 1 is not finite"),
        ([0.5, 0.5, float("inf")], "pose 1 is not finite"),
    ],
)
def test_a_pose_that_is_invalid_is_named(pose, message):
    with pytest.raises(PoseError, match=message):
        slice_masks([[0.5, 0.5, 0], pose], Frustum(), 4)


@pytest.mark.parametrize("poses", [[0.5, 0.5, 0], [[0.5, 0.5]], np.zeros((0, 3)), [["a", 1, 2]]])
def test_arrays_that_are_no_poses(poses):
    with pytest.raises(PoseError):
        slice_masks(poses, Frustum(), 4)


def test_csv_in_any_order_with_more_columns_and_headings_of_any_turn(tmp_path):
    path = tmp_path / "poses.csv"
    path.write_text("name,heading_deg, v,u\n\na,-90,0.25,0.75\nb,720,1,0\n")
    assert read_poses(path).tolist() == [[0.75, 0.25, 270.0], [0.0, 1.0, 0.0]]


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("header", ["u {0}v{0}heading_deg", "U{0}V{0}Heading_deg"])
@pytest.mark.parametrize("start", ["", "\ufeff", "\n  \n", "\ufeff\r\n"])
def test_tables_as_programs_write_them(tmp_path, separator, header, start):
    path = tmp_path / "poses.csv"
    lines = [header, "0.25{0} 0.5{0}90", "", " ", "{0}{0}", "1e-1{0}.5{0}-10.", "\t"]
    text = start + "\r\n".join(line.format(separator) for line in lines)
    path.write_text(text, encoding="utf-8", newline="")
    assert read_poses(path).tolist() == [[0.25, 0.5, 90.0], [0.1, 0.5, 350.0]]


@pytest.mark.parametrize("other", ["a,b,c,d", "a\tb\tc\td", "note, mine"])
def test_further_columns_may_hold_other_separators(tmp_path, other):
    path = tmp_path / "poses.csv"
    path.write_text(f"u;v;heading_deg;{other}\n0.25;0.5;90;x,y,z\n")
    assert read_poses(path).tolist() == [[0.25, 0.5, 90.0]]


@pytest.mark.parametrize(
    "array",
    [
        np.zeros((2, 3), dtype="datetime64[s]"),
        np.zeros((2, 3), dtype="timedelta64[s]"),
        np.array([["0.5", "0.5", "90"]]),
        np.array([[b"0.5", b"0.5", b"90"]]),
        np.zeros((2, 3), dtype=bool),
    ],
    ids=lambda array: str(array.dtype),
)
def test_arrays_of_another_kind_than_numbers_are_refused(tmp_path, array):
    path = tmp_path / "poses.npy"
    np.save(path, array)
    with pytest.raises(PoseError, match=r"poses\.npy: poses must be real numbers .*of type"):
        read_poses(path)
    with pytest.raises(PoseError, match="poses must be real numbers"):
        check_poses(array)


@pytest.mark.parametrize("suffix", ["csv", "npy"])
@pytest.mark.parametrize(
    ("headings", "warned"),
    [
        ([0.0, 1.57, 3.14], True),
        ([0.0, 6.2832], True),
        ([1.57, 1.57], False),
        ([0.0, 1.0, 2.0], False),
        ([0.0, 1.57, 90.0], False),
        ([-1.5, 1.5], False),
    ],
)
def test_headings_that_look_like_radians_are_warned_about(
    tmp_path, caplog, suffix, headings, warned
):
    path = tmp_path / f"poses.{suffix}"
    poses = [[0.5, 0.5, heading] for heading in headings]
    if suffix == "npy":
        np.save(path, poses)
    else:
        lines = (",".join(map(str, pose)) for pose in poses)
        path.write_text("\n".join(["u,v,heading_deg", *lines]))
    assert np.allclose(read_poses(path)[:, 2], np.array(headings) % 360)
    assert len(caplog.messages) == warned
    assert all("as if they were in radians" in message for message in caplog.messages)


def test_npy_gives_the_same_poses(tmp_path):
    path = tmp_path / "poses.npy"
    np.save(path, np.array([[0.1, 0.2, -1e-20]], dtype=np.float32))
    assert read_poses(path)[0, 2] == 0.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("u,v\n0,0\n", "line 1: heading_deg missing"),
        ("", "line 1: u, v, heading_deg missing"),
        ("u|v|heading_deg\n0|0|0\n", "line 1: u, v, heading_deg missing.*separated by commas"),
        ("\n \nu,v\n0,0\n", "line 3: heading_deg missing"),
        ("U,u,v,heading_deg\n0,0,0,1\n", "line 1: a column named twice"),
        ("u,v,heading_deg\n0.5,0.5,1_0\n", "line 2: '0.5,0.5,1_0' does not give three numbers"),
        ("u,v,heading_deg\n0.5,0.5,\u0661\n", "line 2: '0.5,0.5,\u0661' does not give"),
        ("u;v;heading_deg\n0,5;0,5;90\n", "line 2: '0,5;0,5;90' does not give .* such as 0.5"),
        (" \nu\tv\theading_deg\n0\t0\t0\n\t\n0\t2\t0\n", "line 5 lies outside the tile"),
        ("u,v,heading_deg,u\n0,0,0,1\n", "line 1: a column named twice"),
        ("u,v,heading_deg\n", "no poses"),
        ("u,v,heading_deg\n0.5,0.5,0\n0.5,nan,0\n", "line 3 is not finite"),
        ("u,v,heading_deg\n0.5,0.5,0\n\n0.5,1.5,0\n", "line 4 lies outside the tile"),
        ("u,v,heading_deg\n0.5,0.5\n", "line 2: '0.5,0.5' does not give three numbers"),
        ("u,v,heading_deg\n0.5,north,0\n", "line 2: '0.5,north,0'"),
    ],
)
def test_pose_files_that_are_invalid_name_the_line(tmp_path, text, message):
    path = tmp_path / "poses.csv"
    path.write_text(text)
    with pytest.raises(PoseError, match=message) as caught:
        read_poses(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_that_hold_no_poses(tmp_path):
    with pytest.raises(PoseError, match="no such file"):
        read_poses(tmp_path / "none.csv")
    binary = tmp_path / "poses.csv"
    binary.write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(PoseError, match="neither CSV"):
        read_poses(binary)
    pickled = tmp_path / "poses.npy"
    np.save(pickled, np.array([{"u": 1}]), allow_pickle=True)
    with pytest.raises(PoseError, match=r"not a plain \.npy"):
        read_poses(pickled)
    empty = tmp_path / "empty.npy"
    empty.touch()
    with pytest.raises(PoseError, match=r"not a plain \.npy"):
        read_poses(empty)
    whole = tmp_path / "whole.npy"
    np.save(whole, np.zeros((1, 3)))
    header = whole.read_bytes()
    for number, content in enumerate((
        b"PK\x03\x04garbage",
        header[:-1],
        header.replace(b"(1, 3), }            ", b"(1000000000000, 3), }"),
        header.replace(b"{'descr': '<f8',", b"{'descr': ((     "),
    )):  # fmt: skip
        damaged = tmp_path / f"damaged{number}.npy"
        damaged.write_bytes(content)
        with pytest.raises(PoseError, match=rf"damaged{number}.npy: is not a plain \.npy"):
            read_poses(damaged)
    records = np.zeros((2, 3), dtype=[("a", "<f8")])
    for number, array in enumerate((5.0, np.zeros((1, 3), dtype=complex), records)):
        odd = tmp_path / f"odd{number}.npy"
        np.save(odd, array)
        with pytest.raises(PoseError, match=r"shape \[\]|real numbers"):
            read_poses(odd)
    flat = tmp_path / "flat.npy"
    np.save(flat, np.zeros(3))
    with pytest.raises(PoseError, match=r"shape \[3\]"):
        read_poses(flat)
    with pytest.raises(PoseError, match="cannot be read"):
        read_poses(tmp_path)
