"""What the columns of a table of photographs mean, and wrong cells."""

import logging

import numpy as np
import pytest
from slicematch.data.errors import DatasetError
from slicematch.data.photographs import read_photographs


@pytest.fixture
def table(tmp_path):
    """The function that writes a table and reads it."""

    def write(text):
        path = tmp_path / "photos.csv"
        path.write_text(text)
        return read_photographs(path)

    return write


def test_cells_become_numbers_and_paths(table, tmp_path):
    found = table(
        "id,ground,tile,u,v,heading_deg,camera,split,pitch_deg,accuracy_m,weather\n"
        f"1,a.jpg,sub/t.png,0.5,1,-90,front,train,1.5,5,rain\n"
        f"2,{tmp_path}/b.jpg,,,,,,test,,,\n"
    )
    assert found.ids == ["1", "2"]
    assert found.ground == [str(tmp_path / "a.jpg"), str(tmp_path / "b.jpg")]
    assert found.tile == [str(tmp_path / "sub/t.png"), None]
    assert found.camera == ["front", None]
    assert found.part("train").tolist() == [0]
    assert (found.number("heading_deg", 0), found.number("heading_deg", 1)) == (270.0, None)
    assert found.number("pitch_deg", 0) == 1.5
    np.testing.assert_array_equal(found.numbers["lat"], [np.nan, np.nan])
    np.testing.assert_array_equal(found.has("u", "v"), [True, False])


def test_without_ids_the_files_are_the_names(table):
    found = table("ground\na.jpg\na.jpg\n")
    assert found.ids == ["a.jpg", "a.jpg"]
    assert found.part("test").tolist() == [0, 1]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("image\na.jpg\n", "has no column ground, the photographs' files; its columns are image"),
        ("ground,u\na.jpg,\n ,0.5\n", "line 3: ground is empty; expected the photograph's file"),
        ("ground,u\na.jpg,1.2\n", r"line 2: u is '1\.2'; expected a number from 0"),
        ("ground,u\na.jpg,half\n", "u is 'half'; expected a number from 0"),
        ("ground,u\na.jpg,nan\n", "u is 'nan'; expected a number from 0"),
        ("ground,heading_deg\na.jpg,N\n", "heading_deg is 'N'; expected degrees clockwise"),
        ("ground,pitch_deg\na.jpg,91\n", "pitch_deg is '91'; expected degrees from -90 to 90"),
        ("ground,accuracy_m\na.jpg,-1\n", "accuracy_m is '-1'; expected metres of at least 0"),
        ("ground,metres_per_pixel\na.jpg,0\n", "metres_per_pixel is '0'; expected metres from"),
        ("ground,lon\na.jpg,181\n", "lon is '181'; expected a longitude"),
        (
            "ground,lat,lon\na.jpg,151.2,-33.9\n",
            r"lat is '151\.2'; expected a latitude .* the two are swapped",
        ),
        ("ground,split\na.jpg,val\n", "split is 'val'; expected one of train, validation, test"),
        ("ground,split\na.jpg,\n", "split is empty; expected one of train"),
        ("ground,id\na.jpg,\n", "id is empty; expected a name"),
        (
            "id,ground\nx,a.jpg\ny,b.jpg\nx,c.jpg\n",
            "line 4: id is 'x'; expected a name of its own, and line 2 has the same",
        ),
    ],
)
def test_a_wrong_cell_is_named(table, text, said):
    with pytest.raises(DatasetError, match=said) as error:
        table(text)
    assert "\n" not in str(error.value)


def test_columns_that_are_almost_right_are_said(table, caplog):
    with caplog.at_level(logging.WARNING):
        table("ground,heading,tile_latt,remark\na.jpg,5,1,\n")
    assert [record.getMessage().split(": ", 1)[1] for record in caplog.records] == [
        "has a column 'heading', which is not read; if it holds heading_deg, call it so",
        "has a column 'tile_latt', which is not read; if it holds tile_lat, call it so",
    ]


def test_headings_that_look_like_radians_are_said(table, caplog):
    table("ground,heading_deg\na.jpg,0.5\nb.jpg,3.1\n")
    assert "as if they were in radians" in caplog.text
