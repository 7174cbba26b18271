"""Many photographs on one map: answers, files, and what becomes of those that cannot be located."""

import json
import shutil
import subprocess
import sys

import numpy as np
import pandas
import pytest
from click.testing import CliRunner
from PIL import Image
from slicematch.data.errors import DatasetError, MapError
from slicematch.data.lattice import lattice_point
from slicematch.data.maps import AerialMap
from slicematch.errors import ConfigError, RunError
from slicematch.localization.geodesy import offset_m, offset_position
from slicematch.localization.locate import Located, locate, partition
from slicematch.localization.photos import Photo, Priors, find_photos

from slicemask.cli.main import main
from slicemask.errors import ImageError

pytest.importorskip("rasterio")
geopandas = pytest.importorskip("geopandas")


@pytest.fixture
def find(run, cache, mapped, tmp_path):
    """Locate photographs with the tiny run; by default all of them, as CSV."""

    def call(photos=None, out="answers.csv", **options):
        photos = [mapped.folder] if photos is None else photos
        options = {"cache": cache, "device": "cpu", "aerial_map": mapped.map} | options
        return locate(run, photos, out=tmp_path / out, **options)

    return call


def test_an_answer_is_what_the_localizer_finds_in_the_tile(find, mapped, localizer):
    located = find()
    assert located.answers["id"].tolist() == [
        str(mapped.folder / name) for name in sorted(mapped.poses)
    ]
    assert located.answers["error"].isna().all()
    opened = AerialMap.open(mapped.map)
    for row in located.answers.itertuples():
        side_m = localizer.tile_side_m
        tile = opened.cut(row.tile_lat, row.tile_lon, side_m, localizer.config.aerial_size)
        expected = localizer.localize(row.ground, tile.image, metres_per_pixel=side_m / 64)
        lat, lon = offset_position((tile.lat, tile.lon), *expected.offset_m(side_m / 64))
        assert (row.lat, row.lon) == pytest.approx((lat, lon), abs=1e-8)
        assert row.heading_deg == pytest.approx(expected.pose[2], abs=1e-3)
        assert row.probability == pytest.approx(expected.modes[0].probability, abs=1e-5)
        x, y = opened.to_map([row.lat], [row.lon])
        assert (row.x, row.y) == pytest.approx((x[0], y[0]), abs=2e-3)
        # The tile lies around the place, but for the lattice that neighbours share.
        away = offset_m((tile.lat, tile.lon), (row.prior_lat, row.prior_lon))
        assert np.hypot(*away) <= side_m / 16 * 0.71


@pytest.mark.parametrize("suffix", ["csv", "parquet", "geojson", "gpkg"])
def test_answers_are_written_by_the_suffix(find, suffix):
    located = find(out=f"answers.{suffix}")
    path = located.out
    if suffix == "csv":
        written = pandas.read_csv(path)
    elif suffix == "parquet":
        written = geopandas.read_parquet(path)
    elif suffix == "gpkg":
        written = geopandas.read_file(path, layer="answers")
    else:
        written = geopandas.read_file(path)
        kinds = written["kind"].value_counts().to_dict()
        assert kinds == {"estimate": 6, "uncertainty": 6}
        written = written[written["kind"] == "estimate"]
    for name in ("id", "lat", "lon", "heading_deg", "x", "y"):
        assert written[name].tolist() == located.answers[name].tolist()
    if suffix in ("parquet", "gpkg"):
        assert written.crs == "EPSG:32631"
        np.testing.assert_allclose(written.geometry.x, located.answers["x"])
        degrees = written.geometry.to_crs("EPSG:4326")
        np.testing.assert_allclose(degrees.y, located.answers["lat"], atol=1e-7)
    if suffix == "gpkg":
        ellipses = geopandas.read_file(path, layer="ellipses")
        assert ellipses.crs == "EPSG:32631"
        area = np.pi * ellipses["ellipse_major_m"] * ellipses["ellipse_minor_m"]
        np.testing.assert_allclose(ellipses.area, area, rtol=0.01)
    assert sorted(one.name for one in path.parent.iterdir()) == [path.name]


def test_priors_bound_the_answers(find, mapped, localizer):
    located = find(priors=Priors(within_m=20.0, heading_deg=90.0, heading_half_width_deg=50.0))
    for row in located.answers.itertuples():
        away = offset_m((row.prior_lat, row.prior_lon), (row.lat, row.lon))
        assert np.hypot(*away) <= 20.01
        assert abs(row.heading_deg - 90.0) <= 50.001
    assert (located.answers["prior_heading_half_width_deg"] == 50).all()


def test_a_table_says_what_the_photographs_do_not(find, mapped, tmp_path):
    names = sorted(mapped.poses)[:3]
    shutil.copytree(mapped.folder, tmp_path / "shots")
    table = pandas.DataFrame(
        {
            "id": ["a", "b", "c"],
            "ground": [f"shots/{name}" for name in names],
            "lat": [mapped.poses[name][0] for name in names],
            "lon": [mapped.poses[name][1] for name in names],
            "accuracy_m": [10.0, None, 1.0],
            "heading_deg": [mapped.poses[names[0]][2], None, None],
        }
    )
    table.to_csv(tmp_path / "photos.csv", index=False)
    answers = find([tmp_path / "photos.csv"]).answers
    assert answers["id"].tolist() == ["a", "b", "c"]
    # Three times the accuracy, and never so little that no candidate is left.
    assert answers["prior_within_m"].fillna(0).tolist() == pytest.approx([30.0, 0.0, 8.9], abs=0.1)
    assert answers["prior_heading_half_width_deg"].fillna(0).tolist() == [30.0, 0.0, 0.0]
    table.to_parquet(tmp_path / "photos.parquet")
    again = find([tmp_path / "photos.parquet"], out="again.csv").answers
    pandas.testing.assert_frame_equal(answers, again)


def test_what_cannot_be_located_is_listed_and_the_rest_goes_on(find, mapped, tmp_path):
    folder = tmp_path / "mixed"
    shutil.copytree(mapped.folder, folder)
    names = sorted(mapped.poses)
    Image.new("RGB", (128, 64)).save(folder / "no_gps.jpg")
    data = (folder / names[0]).read_bytes()
    (folder / names[0]).write_bytes(data[: len(data) // 2])
    (folder / "text.png").write_text("no image")
    table = pandas.DataFrame({"ground": [f"mixed/{name}" for name in [*names, "no_gps.jpg"]]})
    table["lat"], table["lon"] = 51.9990, 4.3735
    table.loc[1, ["lat", "lon"]] = 4.3735, 51.9990
    table.loc[2, ["lat", "lon"]] = 48.85, 2.35
    table.loc[3, ["lat", "lon"]] = 89.5, 4.0
    table.loc[4, "ground"] = "mixed/missing.jpg"
    table.to_csv(tmp_path / "photos.csv", index=False)
    located = find([tmp_path / "photos.csv"], out="answers.geojson")
    errors = located.answers["error"].fillna("").tolist()
    assert [bool(error) for error in errors] == [True] * 5 + [False] * 2
    assert "cut short" in errors[0] or "corrupt" in errors[0]
    assert "if the two are swapped, give 51.999000,4.373500" in errors[1]
    assert "does not show 48.85" in errors[2]
    assert "its place is 89.5,4" in errors[3]
    assert "there is no such image" in errors[4]
    assert located.summary()["located"] == 2
    assert "2 of 7 photographs located" in located.report()
    assert "does not show 48.85" in located.report()
    collection = json.loads(located.out.read_text())
    nowhere = [one for one in collection["features"] if one["geometry"] is None]
    assert [one["properties"]["error"] for one in nowhere] == errors[:5]
    errors = find([folder]).answers["error"].dropna().tolist()
    assert "says nothing of where it was taken" in errors[0]
    assert len(errors) == 3


def test_files_with_rows_that_failed_can_be_read(find, mapped, tmp_path):
    Image.new("RGB", (128, 64)).save(tmp_path / "no_gps.jpg")
    photos = [tmp_path / "no_gps.jpg", *sorted(mapped.folder.iterdir())[:2]]
    for suffix in ("gpkg", "parquet"):
        path = find(photos, out=f"a.{suffix}").out
        read = geopandas.read_file if suffix == "gpkg" else geopandas.read_parquet
        written = read(path)
        assert written.geometry.isna().tolist() == [True, False, False]
        assert written["error"].notna().tolist() == [True, False, False]


def test_a_picture_shows_the_map_with_the_answers(find, tmp_path):
    located = find(picture=tmp_path / "map.png")
    picture = np.asarray(Image.open(located.picture).convert("RGB"))
    assert picture.std() > 20
    assert located.report().splitlines()[-1] == str(tmp_path / "map.png")


def test_stopped_and_repeated_it_goes_on(find, mapped, tmp_path, monkeypatch):
    whole = find(out="whole.csv").out.read_bytes()
    calls = []

    def stop(done, total):
        calls.append(done)
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        find(progress=stop)
    assert calls == [0, 1, 2, 3]
    parts = tmp_path / "answers.csv.parts"
    assert len(list(parts.glob("*.parquet"))) == 3
    assert not (tmp_path / "answers.csv").exists()
    with pytest.raises(RunError, match="parts of another request, with priors"):
        find(priors=Priors(within_m=10.0))
    calls.clear()
    located = find(progress=lambda done, total: calls.append(done))
    assert calls == [3, 4, 5, 6]
    assert located.out.read_bytes() == whole
    assert not parts.exists()
    with pytest.raises(RunError, match="is there already; replace it with --overwrite"):
        find()
    assert find(overwrite=True).out.read_bytes() == whole


def test_another_request_s_parts_go_with_overwrite(find, tmp_path):
    def stop(done, total):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        find(progress=stop)
    located = find(priors=Priors(within_m=10.0), overwrite=True)
    assert (located.answers["prior_within_m"] == 10.0).all()


def test_photographs_near_each_other_share_a_tile():
    photos = [
        Photo(n, str(n), "a.jpg", *offset_position((52.0, 4.36), 3.0 * n, 0.0)) for n in range(50)
    ]
    keys = {lattice_point(photo.lat, photo.lon, 5.0) for photo in photos}
    assert 28 <= len(keys) <= 32
    assert len({lattice_point(photo.lat, photo.lon, 0.0) for photo in photos}) == 50
    parts = partition(photos, 5.0)
    assert sorted(photo.row for part in parts for photo in part) == list(range(50))
    assert partition(photos[::-1], 5.0) != []
    away = [np.hypot(*offset_m(lattice_point(p.lat, p.lon, 5.0), (p.lat, p.lon))) for p in photos]
    assert max(away) <= 5.0 * 0.71


def test_shared_tiles_are_encoded_once(find, mapped, monkeypatch):
    from slicematch.localization.localizer import Localizer

    encoded = []
    encode = Localizer.encode_aerial
    monkeypatch.setattr(
        Localizer, "encode_aerial", lambda *args, **kw: encoded.append(1) or encode(*args, **kw)
    )
    find(priors=Priors(near=(51.9990, 4.3735)))
    assert len(encoded) == 1


@pytest.mark.parametrize(
    ("options", "error", "said"),
    [
        ({"photos": ["none.jpg"]}, DatasetError, "there is no such file or folder"),
        ({"photos": ["no*.jpg"]}, DatasetError, "no file has such a name"),
        ({"aerial_map": "none.tif"}, MapError, "there is no such file"),
        ({"out": "answers.txt"}, OSError, "its suffix is .txt"),
        ({"side_m": -1.0}, ConfigError, "the tiles' side is -1 m"),
        ({"shared_m": 50.0}, ConfigError, "must be from 0 to half"),
        ({"dask": "many"}, ConfigError, "dask is 'many'"),
    ],
)
def test_requests_that_are_refused(find, tmp_path, options, error, said):
    with pytest.raises(error) as raised:
        find(**options)
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)
    assert not (tmp_path / "answers.csv").exists()


def test_photographs_that_come_twice(mapped, tmp_path):
    photo = sorted(mapped.folder.iterdir())[0]
    with pytest.raises(DatasetError, match=r"photographs 1 and 7 are both '.*photo_000.jpg'"):
        find_photos([mapped.folder, photo])
    table = tmp_path / "t.csv"
    table.write_text(f"ground,lat,lon\n{photo},1,2\n{photo},1,2\n")
    with pytest.raises(DatasetError, match="each needs an id of its own"):
        find_photos([table])
    table.write_text(f"id,ground,lat,lon\na,{photo},1,2\nb,{photo},1,2\n")
    assert [one.id for one in find_photos([table])] == ["a", "b"]


def test_what_a_table_says_of_the_cameras_counts(mapped, run, tmp_path):
    from slicematch.data.panoramas import level, read_panorama
    from slicematch.runs.folder import RunFolder

    photo = sorted(mapped.folder.iterdir())[0]
    config = RunFolder(run).load_config()
    table = tmp_path / "t.csv"
    table.write_text(f"id,ground,lat,lon,pitch_deg\na,{photo},1,2,0\nb,{photo},1,2,20\n")
    straight, tilted = find_photos([table])
    assert straight.image(config) == str(photo)
    expected = level(read_panorama(photo).image, 20.0, 0.0)
    assert (np.asarray(tilted.image(config)) == np.asarray(expected)).all()
    (tmp_path / "cameras.yaml").write_text(
        "front: {projection: pinhole, hfov_deg: 90, width: 128, height: 64}\n"
    )
    (front, _) = find_photos([table])
    with pytest.raises(ImageError, match="its camera is pinhole, and the run was trained with eq"):
        front.image(config)


def test_the_command(run, cache, mapped, tmp_path):
    def call(*arguments):
        arguments = ["locate", run, mapped.folder / "*.jpg", "--map", mapped.map, *arguments]
        arguments += ["--cache", cache, "--device", "cpu"]
        return CliRunner().invoke(main, [str(argument) for argument in arguments])

    out = tmp_path / "answers.gpkg"
    result = call("--out", out, "--within", "0.02km", "--heading", "90±60", "--json")
    assert result.exit_code == 0, result.output
    content = json.loads(result.stdout)
    assert (content["photographs"], content["located"], content["crs"]) == (6, 6, "EPSG:32631")
    written = geopandas.read_file(out, layer="answers")
    assert (written["prior_within_m"] == 20.0).all()
    result = call("--out", tmp_path / "none.csv", "--near", "48.8,2.3")
    assert result.exit_code == 1
    assert "none was located" in result.stderr
    assert (tmp_path / "none.csv").exists()
    for wrong, said in (
        (["--within", "near"], "'near' is no length"),
        (["--heading", "east"], "'east' is no heading"),
        (["--near", "5"], "'5' is not lat,lon"),
    ):
        result = call("--out", tmp_path / "x.csv", *wrong)
        assert result.exit_code == 2
        assert said in result.output


def test_the_result_is_a_located():
    # What a notebook shows of it is the report.
    frame = pandas.DataFrame({"id": ["a"], "error": ["broken"], "tile_padded": [None]})
    assert "0 of 1 photographs located" in Located(frame, "EPSG:4326", False).report()


@pytest.mark.slow
def test_killed_and_repeated_it_goes_on(run, cache, mapped, tmp_path):
    out = tmp_path / "answers.csv"
    code = (
        "import os, signal, sys\n"
        "from slicematch import locate\n"
        "def progress(done, total):\n"
        "    if done == 2: os.kill(os.getpid(), signal.SIGKILL)\n"
        f"locate({str(run)!r}, [{str(mapped.folder)!r}], {str(mapped.map)!r}, {str(out)!r},\n"
        f"       cache={str(cache)!r}, device='cpu', progress=progress)\n"
    )
    root = main.callback.__code__.co_filename.rsplit("/slicemask/", 1)[0]
    env = {"PYTHONPATH": f"{root}:{root}/model", "PATH": "/usr/bin:/bin"}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True)
    assert done.returncode == -9, done.stderr
    assert not out.exists()
    seen = []
    located = locate(
        run, [mapped.folder], mapped.map, out, cache=cache, device="cpu",
        progress=lambda done, total: seen.append(done),
    )  # fmt: skip
    assert seen[0] == 2
    assert len(located.answers) == 6


@pytest.mark.slow
def test_on_dask_the_answers_are_the_same_bytes(find, one_thread):
    pytest.importorskip("distributed")
    alone, together = find(out="a.parquet"), find(out="b.parquet", dask="2")
    assert alone.out.read_bytes() == together.out.read_bytes()
    assert together.answers["error"].isna().all()
