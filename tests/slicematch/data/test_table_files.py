"""Tables as files: CSV, Parquet and GeoJSON, and what is said of those that are none."""

import json

import pytest
from slicematch.data.errors import DatasetError
from slicematch.data.table_files import find_table, read_table, write_table

COLUMNS = {
    "id": ["a", "b"],
    "ground": ["a, the first.jpg", "b.jpg"],
    "lat": [52.5, -33.25],
    "lon": [4.125, 151.0],
    "heading_deg": [None, 90.0],
}


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".geojson"])
def test_what_is_written_is_read(tmp_path, suffix):
    if suffix == ".parquet":
        pytest.importorskip("pyarrow")
    path = tmp_path / f"photos{suffix}"
    write_table(path, COLUMNS)
    table = read_table(path)
    as_text = {
        name: [None if cell is None else str(cell) for cell in cells]
        for name, cells in table.columns.items()
    }
    assert as_text == {
        name: [None if cell is None else str(cell) for cell in cells]
        for name, cells in COLUMNS.items()
    }
    assert [path.name for path in tmp_path.iterdir()] == [path.name]


def test_csv_as_spreadsheets_write_it(tmp_path):
    path = tmp_path / "photos.csv"
    path.write_bytes("\ufeff\r\nGround;U; note \r\n\r\na.jpg;0.5;\r\n b.jpg ;1;x\r\n".encode())
    table = read_table(path)
    assert table.columns == {
        "ground": ["a.jpg", "b.jpg"],
        "u": ["0.5", "1"],
        "note": [None, "x"],
    }
    assert [table.where(row) for row in (0, 1)] == [f"{path}, line 4", f"{path}, line 5"]


def test_geoparquet_s_points_are_latitude_and_longitude(tmp_path):
    geopandas = pytest.importorskip("geopandas")
    points = geopandas.points_from_xy([4.125, 151.0], [52.5, -33.25])
    frame = geopandas.GeoDataFrame({"ground": ["a.jpg", "b.jpg"]}, geometry=points, crs=4326)
    frame.to_parquet(tmp_path / "photos.parquet")
    table = read_table(tmp_path)
    assert table.columns == {
        "lat": [52.5, -33.25],
        "lon": [4.125, 151.0],
        "ground": ["a.jpg", "b.jpg"],
    }
    frame.to_crs(32631).to_parquet(tmp_path / "photos.parquet")
    with pytest.raises(DatasetError, match="points are in WGS 84 / UTM zone 31N; expected latit"):
        read_table(tmp_path)


def test_a_folder_s_table_is_found(tmp_path):
    with pytest.raises(DatasetError, match="holds no table of photographs"):
        find_table(tmp_path)
    (tmp_path / "drive.csv").write_text("ground\n")
    assert find_table(tmp_path) == tmp_path / "drive.csv"
    (tmp_path / "other.geojson").write_text("")
    with pytest.raises(DatasetError, match=r"several tables \(drive\.csv, other\.geojson\)"):
        find_table(tmp_path)
    (tmp_path / "photos.csv").write_text("ground\n")
    assert find_table(tmp_path) == tmp_path / "photos.csv"
    with pytest.raises(DatasetError, match="there is no such file or folder"):
        find_table(tmp_path / "none.csv")
    (tmp_path / "photos.xlsx").write_text("")
    with pytest.raises(DatasetError, match=r"its suffix is \.xlsx; a table of photographs is one"):
        find_table(tmp_path / "photos.xlsx")


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.csv", b"", "holds no row"),
        ("a.csv", b"ground,u\n", "holds no row"),
        ("a.csv", b"ground,u\na.jpg\n", r"a\.csv, line 2: has 1 fields; expected 2"),
        ("a.csv", b"ground,u\n\na,b.jpg,1\n", r"line 3: has 3 fields; expected 2.*quote"),
        ("a.csv", b"ground,Ground\na.jpg,b.jpg\n", "names the column 'ground' twice"),
        ("a.csv", b'ground\n"a.jpg\n', "line 2: unexpected end of data"),
        ("a.csv", b"ground\n\xff\xfe\n", "is not text in UTF-8"),
        ("a.geojson", b"{}", "is no GeoJSON collection"),
        ("a.geojson", b"[1", "is no GeoJSON collection"),
        ("a.geojson", b'{"features": [1]}', "is no GeoJSON collection"),
        ("a.parquet", b"PAR1 no more", "is unreadable as Parquet"),
    ],
)
def test_files_that_are_no_tables(tmp_path, name, content, said):
    if name.endswith("parquet"):
        pytest.importorskip("pyarrow")
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DatasetError, match=said):
        read_table(tmp_path / name)


def test_features_need_not_have_the_same_properties(tmp_path):
    features = [
        {"type": "Feature", "geometry": None, "properties": {"ground": "a.jpg", "u": 0.5}},
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [4.0, 52.0, 3.0]},
            "properties": {"ground": "b.jpg"},
        },
    ]
    path = tmp_path / "a.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    table = read_table(path)
    assert table.columns == {
        "ground": ["a.jpg", "b.jpg"],
        "u": [0.5, None],
        "lat": [None, 52.0],
        "lon": [None, 4.0],
    }
    assert table.where(1) == f"{path}, row 2"


def test_a_table_that_cannot_be_written_leaves_nothing(tmp_path):
    with pytest.raises(DatasetError, match=r"its suffix is \.txt"):
        write_table(tmp_path / "a.txt", COLUMNS)
    with pytest.raises(DatasetError, match="there is no such folder"):
        write_table(tmp_path / "none" / "a.csv", COLUMNS)
    assert list(tmp_path.iterdir()) == []
