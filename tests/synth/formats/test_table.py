"""Generated photographs with a map: what the tables say is what the pictures show."""

import csv
import json

import numpy as np
import pytest
from PIL import ExifTags, Image

pytest.importorskip("trimesh")
rasterio = pytest.importorskip("rasterio")

from slicemask.errors import SynthError  # noqa: E402
from slicemask.synth import generate_table, generate_vigor  # noqa: E402
from slicemask.synth.formats.geotiff import Ground  # noqa: E402

SMALL = {
    "panoramas": 3, "seed": 3, "panorama_size": (128, 64), "image_size": (64, 48), "tile_size": 128,
}  # fmt: skip


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    root = tmp_path_factory.mktemp("table") / "own"
    result = generate_table(root, jobs=1, **SMALL)
    assert result.images == result.rendered == 7
    return root


def rows(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def test_the_files_are_there_and_nothing_else(tree):
    found = sorted(path.relative_to(tree).as_posix() for path in tree.rglob("*"))
    assert found == [
        "cameras.yaml", "front", "front.csv", "front/00000.jpg", "front/00001.jpg",
        "front/00002.jpg", "map.tif", "panoramas", "panoramas/00000.jpg", "panoramas/00001.jpg",
        "panoramas/00002.jpg", "photos.csv", "synth.json",
    ]  # fmt: skip
    assert (
        "front: {projection: pinhole, width: 64, height: 48, fx: 50, cx: 36, cy: 24}"
        in (tree / "cameras.yaml").read_text()
    )
    for name in ("photos", "front"):
        parts = [row["split"] for row in rows(tree / f"{name}.csv")]
        assert sorted(parts) == ["test", "train", "train"]


def test_the_map_is_vigor_s_city(tree, tmp_path):
    """A tile of VIGOR's format is a part of the map, on which the cameras stand where they are."""
    options = {name: SMALL[name] for name in ("panoramas", "seed", "panorama_size", "tile_size")}
    generate_vigor(tmp_path, jobs=1, **options)
    labels = tmp_path / "splits__corrected" / "NewYork" / "pano_label_balanced__corrected.txt"
    with rasterio.open(tree / "map.tif") as file:
        assert file.crs.to_epsg() == 32618
        pixels = np.moveaxis(file.read(), 0, -1).astype(int)
        transform, size = file.transform, file.width
    assert (size, transform.a) == (pytest.approx(128 + 66 + 2 * 44, abs=2), 0.113248 * 5)
    for line, row in zip(labels.read_text().splitlines(), rows(tree / "photos.csv"), strict=True):
        _, tile, d0, d1, *_ = line.split()
        (x,), (y,) = rasterio.warp.transform(
            "EPSG:4326", "EPSG:32618", [float(row["lon"])], [float(row["lat"])]
        )
        column, down = ~transform * (x, y)
        corner = np.array([down, column]) - (64 + float(d0) / 5, 64 - float(d1) / 5)
        np.testing.assert_allclose(corner, np.rint(corner), atol=0.01)
        top, left = np.rint(corner).astype(int)
        tile = np.asarray(Image.open(tmp_path / "NewYork" / "satellite" / tile)).astype(int)
        # Sensors' noise is drawn for each picture.
        off = np.abs(pixels[top : top + 128, left : left + 128] - tile)
        assert np.median(off) <= 4


def test_panoramas_are_vigor_s_turned(tree, tmp_path):
    options = {name: SMALL[name] for name in ("panoramas", "seed", "panorama_size", "tile_size")}
    generate_vigor(tmp_path, jobs=1, **options)
    labels = tmp_path / "splits__corrected" / "NewYork" / "pano_label_balanced__corrected.txt"
    for line, row in zip(labels.read_text().splitlines(), rows(tree / "photos.csv"), strict=True):
        north = np.asarray(Image.open(tmp_path / "NewYork" / "panorama" / line.split(" ")[0]))
        own = np.asarray(Image.open(tree / row["ground"])).astype(int)
        # The map's north is 0.66 degrees off true north there.
        columns = (float(row["heading_deg"]) - 0.66) * 128 / 360
        assert columns == pytest.approx(round(columns), abs=0.02)
        turned = np.roll(north, -round(columns), axis=1).astype(int)
        assert np.abs(own - turned).mean() < 3


def test_exif_is_a_little_off(tree):
    offsets = []
    for name in ("photos", "front"):
        for row in rows(tree / f"{name}.csv"):
            with Image.open(tree / row["ground"]) as image:
                exif = image.getexif()
            gps = exif.get_ifd(ExifTags.IFD.GPSInfo)
            lat, lon = (sum(float(v) / 60**k for k, v in enumerate(gps[tag])) for tag in (2, 4))
            assert (gps[1], gps[3], float(gps[ExifTags.GPS.GPSHPositioningError])) == (
                "N",
                "W",
                5.0,
            )
            north = (lat - float(row["lat"])) * 111_200
            east = (-lon - float(row["lon"])) * 84_400
            turn = float(gps[ExifTags.GPS.GPSImgDirection]) - float(row["heading_deg"])
            offsets.append([east, north, (turn + 180) % 360 - 180])
            focal = exif.get_ifd(ExifTags.IFD.Exif).get(ExifTags.Base.FocalLengthIn35mmFilm)
            assert focal == (27 if name == "front" else None)
    spread = np.abs(offsets)
    assert (spread.max(axis=0) < 20).all()
    assert (spread.mean(axis=0) > 1).all()


def test_it_goes_on_where_it_stopped_with_the_same_bytes(tree, tmp_path):
    generate_table(tmp_path / "own", jobs=2, **SMALL)
    files = {p.relative_to(tree): p for p in tree.rglob("*") if p.is_file()}
    for name, path in files.items():
        assert path.read_bytes() == (tmp_path / "own" / name).read_bytes(), name
    (tmp_path / "own" / "map.tif").unlink()
    (tmp_path / "own" / "front" / "00001.jpg").write_bytes(b"half")
    again = generate_table(tmp_path / "own", jobs=1, **SMALL)
    assert again.rendered == 2
    for name, path in files.items():
        assert path.read_bytes() == (tmp_path / "own" / name).read_bytes(), name
    assert generate_table(tmp_path / "own", jobs=1, **SMALL).rendered == 0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"panoramas": 0}, "panoramas is 0; it must be at least 1"),
        ({"panorama_size": (100, 60)}, "panorama_size is 100x60; it must be twice as wide as high"),
        ({"image_size": (8, 48)}, "image_size is 8x48; it must be 16 or more"),
    ],
)
def test_settings_out_of_range(tmp_path, change, said):
    with pytest.raises(SynthError, match=said):
        generate_table(tmp_path, **SMALL | change)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_of_another_data_set_is_refused(tree):
    with pytest.raises(SynthError, match="holds another generated data set"):
        generate_table(tree, **SMALL | {"seed": 4})
    assert json.loads((tree / "synth.json").read_text())["seed"] == 3


def test_the_map_s_north_is_off_true_north():
    """Against UTM's closed form, (longitude off the meridian) times the sine of the latitude."""
    ground = Ground.around(40.0, -73.0, 50.0, 0.1)
    assert ground.crs == "EPSG:32618"
    (off,) = ground.convergence_deg(np.zeros((1, 2)))
    assert off == pytest.approx(2.0 * np.sin(np.radians(40.0)), abs=1e-3)
    lat, lon = ground.on_globe(np.zeros((1, 2)))
    np.testing.assert_allclose([lat[0], lon[0]], [40.0, -73.0], atol=1e-5)
