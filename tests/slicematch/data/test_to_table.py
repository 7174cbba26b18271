"""slicemask table: tables from VIGOR, KITTI and folders of photographs, as a user types it."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational
from slicematch.data.cameras import load_cameras
from slicematch.data.dataset import PoseDataset
from slicematch.data.images import denormalise
from slicematch.data.photographs import read_photographs
from slicematch.data.table import TableConfig
from slicematch.data.vigor import VigorConfig

from slicemask.cli.main import main

SIZES = {"ground_size": (32, 128), "aerial_size": 64, "validation_fraction": 0.0}


def run(*arguments):
    return CliRunner().invoke(main, ["table", *map(str, arguments)])


def test_vigor_s_pairs_are_vigor_s_samples(vigor, tmp_path):
    out = tmp_path / "photos.csv"
    done = run("from-vigor", vigor.root, "--cities", "Chicago", "--out", out, "--json")
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout) == {
        "table": str(out), "rows": 10, "cameras": None, "left_out": {},
    }  # fmt: skip
    ours = PoseDataset(VigorConfig(root=vigor.root, cities=("Chicago",), **SIZES), "train")
    own = PoseDataset(TableConfig(root=out, **SIZES), "train")
    assert own.names == ours.names
    np.testing.assert_allclose(own.poses(), ours.poses(), atol=1e-12)
    assert (own[0]["ground"] == ours[0]["ground"]).all()
    assert len(PoseDataset(TableConfig(root=out, **SIZES), "test")) == 5


def test_a_table_that_is_there_is_kept(vigor, tmp_path):
    out = tmp_path / "photos.csv"
    out.write_text("mine")
    arguments = "from-vigor", vigor.root, "--cities", "Chicago", "--out", out
    done = run(*arguments)
    assert done.exit_code == 1
    assert done.output.startswith(f"Error: {out}: is there already; replace it with --overwrite")
    assert out.read_text() == "mine"
    done = run(*arguments, "--overwrite")
    assert (done.exit_code, done.output) == (0, f"{out}: 10 photographs\n")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["from-vigor", "none"], "none: there is no such folder; name the root of the data tree"),
        (["from-kitti", "none"], "the split file is missing"),
        (["from-exif", "none"], "none: there is no such folder; name that of the photographs"),
        (["from-exif", ".", "--hfov", "200"], "hfov is 200; of a pinhole camera it is from 0"),
    ],
)
def test_what_is_not_there_is_said(tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    done = run(*arguments, "--out", "photos.csv")
    assert done.exit_code == 1
    assert said in done.output
    assert "Traceback" not in done.output
    assert list(tmp_path.iterdir()) == []


def test_kitti_s_frames_have_a_camera_and_their_place(make_kitti_tree, sample_view, tmp_path):
    tree = make_kitti_tree(tmp_path, pairs=3, tile_pixels=640, blocks=12)
    out = tmp_path / "photos.csv"
    lost = tree.frames[2]
    (tmp_path / "satmap" / lost).unlink()
    done = run("from-kitti", tree.root, "--out", out)
    assert done.exit_code == 0, done.output
    assert (
        f"{out}: 4 photographs\n{tmp_path}/cameras.yaml: their cameras\n1 left out:" in done.output
    )
    (camera,) = load_cameras(tmp_path / "cameras.yaml").values()
    assert (camera.fx, camera.cx, camera.cy) == (721.5377, 609.5593, 172.854)
    assert (camera.width, camera.height) == (1242, 375)
    config = TableConfig(root=out, side_m=80.0, shift_m=10.0, **SIZES | {"aerial_size": 160})
    assert config.hfov_deg == pytest.approx(81.42, abs=0.1)
    dataset = PoseDataset(config, "train")
    assert dataset.names == tree.frames[:2]
    for sample in dataset:
        u, v, heading_deg = sample["pose"].tolist()
        # The ground image again, as tile and pose have it; its rows reach from 40 m to 0.
        columns = ((np.arange(128) + 0.5) / 128 * 1242 - 621.0) / 721.5377
        azimuth_deg = heading_deg + np.degrees(np.arctan(columns))
        ranges = 40.0 / 80.0 * (1 - (np.arange(32) + 0.5) / 32)
        seen = sample_view(denormalise(sample["aerial"]), (u, v), azimuth_deg, ranges)[16:]
        off = np.abs(seen.astype(int) - denormalise(sample["ground"])[16:])
        assert np.median(off) < 12


def photograph(
    path, size=(80, 60), *, place=None, focal=None, model=None, orientation=None, xmp=None
):
    exif = Image.Exif()
    if model:
        exif[ExifTags.Base.Model] = model
    if orientation:
        exif[ExifTags.Base.Orientation] = orientation
    if focal:
        exif[ExifTags.IFD.Exif] = {ExifTags.Base.FocalLengthIn35mmFilm: focal}
    if place:
        lat, lon, heading = place
        exif[ExifTags.IFD.GPSInfo] = {
            1: "N", 2: (lat, 0.0, 0.0), 3: "W", 4: (-lon, 0.0, 0.0),
            ExifTags.GPS.GPSHPositioningError: IFDRational(45, 10),
            **({} if heading is None else {ExifTags.GPS.GPSImgDirection: IFDRational(heading, 1)}),
        }  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", size).save(path, exif=exif, **({"xmp": xmp} if xmp else {}))


GPANO = (
    b'<x:xmpmeta xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" '
    b'GPano:ProjectionType="equirectangular" GPano:PoseHeadingDegrees="350.5"/>'
)


def test_photographs_say_where_they_were_taken_and_by_what(tmp_path):
    folder = tmp_path / "photos"
    photograph(folder / "a.jpg", place=(40, -74, 90), focal=27, model="Phone 7")
    photograph(folder / "b" / "c.jpg", (60, 80), place=(41, -74, None), focal=27, model="Phone 7")
    photograph(folder / "d.jpg", place=(42, -74, 5), focal=27, model="Phone 7", orientation=6)
    photograph(folder / "pano,43.25000,-74.50000,.jpg", (80, 40))
    photograph(folder / "e.jpg", (80, 40), place=(44, -74, 10), xmp=GPANO)
    photograph(folder / "no_place.jpg", focal=27)
    photograph(folder / "no_camera.jpg", place=(45, -74, 20))
    (folder / "broken.jpg").write_bytes(b"\xff\xd8\xff")
    (folder / "notes.txt").write_text("mine")
    out = tmp_path / "photos.geojson"
    done = run("from-exif", folder, "--out", out, "--json")
    assert done.exit_code == 0, done.output
    content = json.loads(done.stdout)
    assert content["rows"] == 5
    reasons = {path.rsplit("/", 1)[1]: text for path, text in content["left_out"].items()}
    assert sorted(reasons) == ["broken.jpg", "no_camera.jpg", "no_place.jpg"]
    assert "says nothing of where it was taken" in reasons["no_place.jpg"]
    assert "says nothing of its field of view" in reasons["no_camera.jpg"]
    assert "cannot be read as an image" in reasons["broken.jpg"]
    found = read_photographs(out)
    assert found.ids == [
        "photos/a.jpg", "photos/b/c.jpg", "photos/d.jpg", "photos/e.jpg",
        "photos/pano,43.25000,-74.50000,.jpg",
    ]  # fmt: skip
    assert found.numbers["lat"].tolist() == [40.0, 41.0, 42.0, 44.0, 43.25]
    assert found.numbers["lon"].tolist() == [-74.0, -74.0, -74.0, -74.0, -74.5]
    np.testing.assert_array_equal(found.numbers["heading_deg"], [90.0, np.nan, 5.0, 350.5, np.nan])
    np.testing.assert_array_equal(found.numbers["accuracy_m"], [4.5, 4.5, 4.5, 4.5, np.nan])
    upright, on_its_side = "phone-7_80x60_27mm", "phone-7_60x80_27mm"
    assert found.camera == [upright, on_its_side, on_its_side, "panorama", "panorama"]
    cameras = load_cameras(tmp_path / "cameras.yaml")
    assert set(cameras) == {upright, on_its_side, "panorama"}
    # 27 mm of film's diagonal of 43.27 mm.
    assert cameras[upright].fx == cameras[on_its_side].fx == pytest.approx(27 * 100 / 43.2666, 1e-4)
    with_hfov = run("from-exif", folder, "--out", out, "--json", "--hfov", 60, "--overwrite")
    assert json.loads(with_hfov.stdout)["rows"] == 6


def test_panoramas_alone_need_no_cameras(tmp_path):
    photograph(tmp_path / "photos" / "a.jpg", (80, 40), place=(40, -74, 90))
    done = run("from-exif", tmp_path / "photos", "--out", tmp_path / "photos.csv")
    assert done.output == f"{tmp_path}/photos.csv: 1 photographs\n"
    assert "camera" not in read_photographs(tmp_path).file.columns
    assert not (tmp_path / "cameras.yaml").exists()


def test_other_cameras_beside_the_table_are_kept(tmp_path):
    (tmp_path / "cameras.yaml").write_text("roof: {projection: equirectangular}\n")
    photograph(tmp_path / "photos" / "a.jpg", place=(40, -74, 90), focal=27)
    done = run("from-exif", tmp_path / "photos", "--out", tmp_path / "photos.csv")
    assert done.exit_code == 1
    assert "cameras.yaml: holds other cameras; replace it with --overwrite" in done.output
    assert not (tmp_path / "photos.csv").exists()


def test_a_folder_in_which_no_photograph_says_anything(tmp_path):
    photograph(tmp_path / "photos" / "a.jpg")
    done = run("from-exif", tmp_path / "photos", "--out", tmp_path / "photos.csv")
    assert done.exit_code == 1
    assert "none of its 1 photographs says where and by what camera it was taken" in done.output
