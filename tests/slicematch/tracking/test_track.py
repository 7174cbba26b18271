"""Whole drives with a tiny run: what is written, and what becomes of a drive that lacks things."""

import csv
import json
import math

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image
from slicematch.data.maps import AerialMap
from slicematch.data.positions import Fix
from slicematch.errors import ConfigError
from slicematch.localization.geodesy import offset_position
from slicematch.localization.on_map import PlaceOnGlobe
from slicematch.tracking.drive import open_drive
from slicematch.tracking.elsewhere import Elsewhere
from slicematch.tracking.hypotheses import Hypothesis
from slicematch.tracking.odometry import Odometry
from slicematch.tracking.track_settings import TrackSettings
from slicematch.tracking.tracker import Tracker

from slicemask.cli.main import main

pytest.importorskip("rasterio")
FRAMES, STEP_S, SPEED_MPS = 12, 0.5, 8.0
SETTINGS = TrackSettings(particles=50, other_particles=20)


def places(mapped):
    """A straight way north through the map's middle."""
    south, west, north, east = AerialMap.open(mapped.map).bounds()
    centre = (south + north) / 2, (west + east) / 2
    return [offset_position(centre, 0.001, SPEED_MPS * STEP_S * k - 24.0) for k in range(FRAMES)]


@pytest.fixture(scope="module")
def drive(mapped, tmp_path_factory):
    """A table of frames, with one image missing, one clock that stuck and one broken sensor."""
    folder = tmp_path_factory.mktemp("drive")
    photos = sorted(mapped.folder.iterdir())
    lines = ["time_s,ground,speed_mps,yaw_rate_dps,gnss_lat,gnss_lon,lat,lon,heading_deg"]
    for k, (lat, lon) in enumerate(places(mapped)):
        image = "missing.jpg" if k == 4 else photos[k % len(photos)]
        time_s = STEP_S * (k - 1 if k == 6 else k)
        speed = "nan" if k in (8, 9) else SPEED_MPS
        fix = f"{lat},{lon}" if k == 0 else ","
        lines.append(f"{time_s},{image},{speed},0,{fix},{lat},{lon},0")
    (folder / "drive.csv").write_text("\n".join(lines) + "\n")
    return folder / "drive.csv"


@pytest.fixture
def track(run, cache, mapped, drive, tmp_path):
    """Run the command; give its result."""

    def call(*arguments, out="track.csv", drive=drive):
        options = ["--drive", drive, "--map", mapped.map, "--out", tmp_path / out]
        options += ["--cache", cache, "--device", "cpu", *arguments]
        return CliRunner().invoke(main, ["track", str(run), *map(str, options)])

    return call


def test_a_drive_goes_on_whatever_it_lacks_and_says_so(track, tmp_path):
    found = track("--json", "--picture", tmp_path / "track.png", "--animation", tmp_path / "a.gif")
    assert found.exit_code == 0, found.output
    content = json.loads(found.stdout)
    rows = list(csv.DictReader((tmp_path / "track.csv").open()))
    assert len(rows) == content["frames"] == FRAMES
    assert content["seen"] == FRAMES - 1
    assert "the image is missing" in rows[4]["notes"]
    assert "the clock went on by 0 s" in rows[6]["notes"]
    assert "odometry" in rows[9]["notes"]
    assert rows[1]["notes"] == ""
    assert set(content["errors"]) >= {"place_median_m", "wrong_street", "inside_ellipse"}
    assert all(math.isfinite(float(row["cov_ee"])) for row in rows)
    for name in ("track.png", "a.gif"):
        assert np.asarray(Image.open(tmp_path / name).convert("L")).std() > 5


def test_the_same_drive_gives_the_same_track_and_smoothing_another(track, tmp_path):
    assert track(out="a.tum").exit_code == 0
    assert track(out="b.tum").exit_code == 0
    assert (tmp_path / "a.tum").read_bytes() == (tmp_path / "b.tum").read_bytes()
    smoothed = track("--smooth", "--json", out="c.tum")
    assert smoothed.exit_code == 0, smoothed.output
    assert json.loads(smoothed.stdout)["smoothed"]
    assert (tmp_path / "c.tum").read_bytes() != (tmp_path / "a.tum").read_bytes()


def test_a_drive_without_a_fix_needs_its_place(track, drive, mapped, tmp_path):
    lines = drive.read_text().splitlines()
    kept = [line.split(",") for line in lines]
    bare = tmp_path / "bare.csv"
    bare.write_text("\n".join(",".join(cells[:4]) for cells in kept) + "\n")
    found = track(drive=bare)
    assert found.exit_code != 0
    assert "holds no fix, so that nobody knows where it begins" in found.output
    assert not (tmp_path / "track.csv").exists()
    lat, lon = places(mapped)[0]
    assert track("--near", f"{lat},{lon}", drive=bare).exit_code == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--out", "track.xyz"], "its suffix is .xyz"),
        (["--picture", "track.bmp"], "its suffix is .bmp"),
        (["--animation", "track.mp4"], "its suffix is .mp4"),
        (["--map", "none.tif"], "none.tif: there is no such file"),
        (["--drive", "none.csv"], "none.csv: there is no such file"),
    ],
)
def test_what_cannot_be_is_one_sentence(track, arguments, said):
    found = track(*arguments)
    assert found.exit_code != 0
    assert said in found.output
    assert "Traceback" not in found.output


def test_where_the_map_ends_odometry_goes_on(localizer, cache, mapped):
    opened = AerialMap.open(mapped.map)
    north = opened.bounds()[2]
    lon = places(mapped)[0][1]
    with Tracker(
        localizer, opened, PlaceOnGlobe(north, lon, 5.0), (0.0, 5.0), settings=SETTINGS, cache=cache
    ) as tracker:
        photo = sorted(mapped.folder.iterdir())[0]
        start = tracker.step(photo)
        for _ in range(10):
            last = tracker.step(photo, Odometry(20.0), 1.0)
    assert "the map ends here, so that the belief goes on by odometry alone" in last.notes
    assert last.modes[0].north_m - start.modes[0].north_m > 100.0
    assert last.covariance[1, 1] > start.covariance[1, 1]


def test_without_images_the_belief_grows_and_without_time_it_stays(localizer, cache, mapped):
    opened = AerialMap.open(mapped.map)
    start = PlaceOnGlobe(*places(mapped)[0], 5.0)
    with Tracker(localizer, opened, start, (0.0, 5.0), settings=SETTINGS, cache=cache) as tracker:
        tracker.step(None)
        near = tracker.step(None, Odometry(10.0), 1.0)
        same = tracker.step(None, Odometry(10.0), -1.0)
        far = tracker.step(None, Odometry(10.0), 8.0)
    assert not near.seen
    np.testing.assert_allclose(same.covariance, near.covariance, rtol=0.3)
    assert "the clock went on by -1 s" in same.notes[0]
    assert far.covariance[0, 0] > near.covariance[0, 0]


def test_fixes_along_the_way_hold_a_belief_that_no_image_does(localizer, cache, mapped):
    opened = AerialMap.open(mapped.map)
    start = PlaceOnGlobe(*places(mapped)[0], 20.0)
    north, south = (offset_position(places(mapped)[0], 0.0, metres) for metres in (12.0, -12.0))

    def after(*fixes):
        with Tracker(localizer, opened, start, settings=SETTINGS, cache=cache) as tracker:
            tracker.step(None)
            for fix in fixes:
                found = tracker.step(None, Odometry(0.0), 10.0, fix=fix)
        return found

    without = after(None, None)
    towards, away = (after(*[Fix(*place, 5.0)] * 2) for place in (north, south))
    assert towards.modes[0].north_m > without.modes[0].north_m > away.modes[0].north_m
    assert towards.covariance[1, 1] < without.covariance[1, 1]
    broken = after(Fix(math.nan, 0.0, 5.0), Fix(*north, math.nan))
    assert any("the fix is not finite" in note for note in after(Fix(math.nan, 0.0)).notes)
    assert np.isfinite(broken.covariance).all()


def test_fixes_along_the_way_can_be_left_out(track, drive, mapped, tmp_path):
    """Fixes 15 m east of the way draw the track there, unless they are not used."""
    header, *rows = drive.read_text().splitlines()
    lines = [header]
    for k, (row, place) in enumerate(zip(rows, places(mapped), strict=True)):
        cells = row.split(",")
        cells[4:6] = map(str, offset_position(place, 15.0 if k else 0.0, 0.0))
        lines.append(",".join(cells))
    fixed = tmp_path / "fixed.csv"
    fixed.write_text("\n".join(lines) + "\n")
    for out, arguments in (("with.tum", []), ("without.tum", ["--no-fixes"])):
        assert track(*arguments, drive=fixed, out=out).exit_code == 0
    track("--no-fixes", out="first.tum")  # its only fix is the first, where both begin
    assert (tmp_path / "without.tum").read_bytes() == (tmp_path / "first.tum").read_bytes()
    assert (tmp_path / "with.tum").read_bytes() != (tmp_path / "first.tum").read_bytes()


@pytest.mark.parametrize("seen", [True, False])
def test_a_fix_with_the_first_frame_counts_in_full(seen, localizer, cache, mapped):
    """Where the start says little, with an image and without one."""
    opened = AerialMap.open(mapped.map)
    place = places(mapped)[0]
    start = PlaceOnGlobe(*place, 30.0)
    north = Fix(*offset_position(place, 0.0, 15.0), 4.0)
    image = np.zeros((128, 256, 3), np.uint8) if seen else None

    def first(fix):
        with Tracker(localizer, opened, start, settings=SETTINGS, cache=cache) as tracker:
            tracker.step(image, fix=fix)
            mean = sum(one.probability * one.mean()[1] for one in tracker.hypotheses)
            return mean, tracker.step(None, Odometry(0.0), 0.1).notes

    with_it, without = first(north), first(None)
    assert with_it[0] > without[0] + 5.0
    assert with_it[1] == without[1]


@pytest.mark.parametrize(("here", "elsewhere_before"), [(0.5, 0.2), (0.9, 0.2), (0.1, 0.6)])
def test_bayes_rule_says_how_likely_the_camera_is_elsewhere(
    here, elsewhere_before, localizer, cache, mapped, monkeypatch
):
    """Three candidates and a cloud of two particles, by hand."""
    start = PlaceOnGlobe(*places(mapped)[0], 20.0)
    scores, prior = np.array([0.2, 0.5, 0.3]), np.array([0.5, 0.25, 0.25])
    weights, of_cloud = np.array([0.75, 0.25]), np.array([here, 0.3])
    said = []

    class Searched:
        fix_evidence = 1.0

        def hypotheses(self, likelihood, probability, particles):
            said.append(probability)
            return []

    searched = Searched()
    searched.scores, searched.prior = scores, prior
    with Tracker(localizer, AerialMap.open(mapped.map), start, cache=cache) as tracker:
        settings, temperature = tracker.settings, tracker.temperature
        tracker.hypotheses = [Hypothesis(np.zeros((2, 5)), weights, 1.0)]
        tracker.elsewhere.probability = elsewhere_before
        tracker._unsearched_m = 2 * settings.same_sight_m  # an image of its own
        monkeypatch.setattr(tracker.elsewhere, "search", lambda *_: searched)
        tracker._search(None, [(weights, of_cloud)])

    def likelihood(score):
        usual = np.mean(np.exp((scores - scores.max()) / temperature))
        says = np.exp((score - scores.max()) / temperature) / usual
        return 0.9 * says + 0.1  # one image in ten says nothing

    away = elsewhere_before * sum(prior * likelihood(scores))
    at_the_cloud = (1 - elsewhere_before) * sum(weights * likelihood(of_cloud))
    expected = min(max(away / (away + at_the_cloud), 0.05), 0.99)
    assert said == [pytest.approx(expected)]
    assert tracker.hypotheses[0].probability == pytest.approx(1.0)  # of what is followed


def test_a_fix_of_long_ago_says_nothing_of_where_to_search(localizer, cache, mapped, monkeypatch):
    """A drive whose fixes end is searched like one that never had any."""
    asked = []
    search = Elsewhere.search

    def listening(self, ground, hypotheses, fix, fix_share):
        asked.append(fix)
        return search(self, ground, hypotheses, fix, fix_share)

    monkeypatch.setattr(Elsewhere, "search", listening)
    opened, place = AerialMap.open(mapped.map), places(mapped)[0]
    image = np.zeros((128, 256, 3), np.uint8)
    with Tracker(
        localizer, opened, PlaceOnGlobe(*place, 30.0), settings=SETTINGS, cache=cache
    ) as tracker:
        tracker.step(image, fix=Fix(*place, 4.0))
        assert asked[0].deviation_m == pytest.approx(4.0)
        for _ in range(4):
            tracker.step(image, Odometry(SPEED_MPS), 1.0)
        assert len(asked) > 2
        assert asked[-1] is None
        tracker.step(image, Odometry(SPEED_MPS), 1.0, fix=Fix(*place, 4.0))
        assert asked[-1] is not None


@pytest.mark.parametrize("fixes", [True, False])
def test_the_first_fix_does_not_count_twice(fixes, drive, localizer):
    """As the start, and as evidence: where it is the latter, a drive begins anywhere around it."""
    start = open_drive(drive, localizer.config).start(fixes)
    assert start.within_m == (None if fixes else 20.0)


def test_settings_are_checked():
    with pytest.raises(ConfigError, match="there are 5 and 100 particles; each must be 10 or more"):
        TrackSettings(particles=5)
    with pytest.raises(ConfigError, match="search_s is 0; it must be above 0"):
        TrackSettings(search_s=0.0)
    for name in ("standing", "outliers", "says_nothing", "least_elsewhere"):
        for value in (0.0, 1.0, math.nan):
            with pytest.raises(ConfigError, match=f"{name} is .*; it must be between 0 and 1"):
                TrackSettings(**{name: value})


@pytest.mark.slow
def test_a_kitti_raw_drive_is_tracked_from_its_oxts(cache, mapped, tmp_path):
    """From the tree alone: frames as a table, a run of such cameras, the drive on a map."""
    pytest.importorskip("trimesh")
    rasterio = pytest.importorskip("rasterio")
    from slicemask.synth import generate_kitti

    root = tmp_path / "kitti"
    generate_kitti(root, frames=12, seed=2, image_size=(124, 38), tile_size=512, jobs=1)
    drive = max(root.glob("raw_data/*/*_sync"), key=lambda one: len(list(one.glob("oxts/data/*"))))
    records = sorted(drive.glob("oxts/data/*"))
    table = tmp_path / "table.csv"
    (tmp_path / "train.yaml").write_text(
        "encoder: test_resnet\nweights: none\nstride: 8\npyramid: 8\nground_size: [32, 96]\n"
        "aerial_size: 64\nslices: 4\ntrain_grid: 3x3x4\ntest_grid: 4x4x8\nbatch_size: 2\n"
        "epochs: 1\nworkers: 0\n"
    )
    lat, lon = np.array([np.loadtxt(path)[:2] for path in records]).T
    around = lon.min() - 0.003, lat.min() - 0.002, lon.max() + 0.003, lat.max() + 0.002
    pixels = np.random.default_rng(0).integers(0, 255, (3, 400, 400), np.uint8)
    with rasterio.open(
        tmp_path / "map.tif", "w", driver="GTiff", width=400, height=400, count=3, dtype="uint8",
        crs="EPSG:4326", transform=rasterio.transform.from_bounds(*around, 400, 400),
    ) as raster:  # fmt: skip
        raster.write(pixels)

    def slicemask(*arguments):
        found = CliRunner().invoke(main, list(map(str, arguments)))
        assert found.exit_code == 0, found.output
        return found

    slicemask("table", "from-kitti", root, "--out", table)
    slicemask("train", "--config", tmp_path / "train.yaml", "--data", "table", "--root", table,
              "--accelerator", "cpu", "--out", tmp_path / "run", "--cache", cache)  # fmt: skip
    found = slicemask("track", tmp_path / "run", "--drive", drive, "--map", tmp_path / "map.tif",
                      "--out", tmp_path / "track.txt", "--cache", cache, "--json")  # fmt: skip
    content = json.loads(found.stdout)
    poses = np.loadtxt(tmp_path / "track.txt")
    assert len(poses) == content["frames"] == len(records)
    assert content["seen"] == content["frames"]
    assert np.isfinite(poses).all()
    assert {"place_median_m", "inside_ellipse"} <= set(content["errors"])
