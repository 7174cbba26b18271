"""The page that plays a track back, in a real browser; and what it refuses."""

import pytest
from click.testing import CliRunner

from slicemask.cli.main import main

pytest.importorskip("rasterio")
NAMES = (
    "time_s,lat,lon,heading_deg,probability,ellipse_major_m,ellipse_minor_m,ellipse_azimuth_deg,"
    "notes"
)


@pytest.fixture(scope="module")
def recorded(tree_writers, tmp_path_factory):
    """A map, and a track of 21 frames on it that goes north."""
    folder = tmp_path_factory.mktemp("recorded")
    aerial_map = tree_writers.write_mapped_photos(folder, 1).map
    lat, lon = tree_writers.MAP_CENTRE
    rows = [
        f"{0.2 * k},{lat + k * 2e-5},{lon},{0 if k < 20 else 90},{0.4 if k == 20 else 1},"
        f"{6 - 0.2 * k},2,30,{'the image is <missing>' if k == 20 else ''}"
        for k in range(21)
    ]
    (folder / "track.csv").write_text("\n".join([NAMES, *rows]) + "\n")
    return folder / "track.csv", aerial_map


@pytest.mark.slow
def test_a_track_is_played_frame_by_frame(look, serve, recorded):
    track, aerial_map = recorded
    looker = look(serve("--track", str(track), "--map", str(aerial_map)))
    looker.page.get_by_text("95 % within 6.0 m by 2.0 m").wait_for()
    assert looker.page.get_by_text("Frame 1 of 21, 0.00 s").count() == 1
    looker.page.locator("button.play").click()
    looker.page.get_by_text("Frame 21 of 21, 4.00 s").wait_for()
    assert looker.page.get_by_text("the image is <missing>").count() == 1
    assert looker.page.get_by_text("which it is with 40%").count() == 1
    looker.keep("track_player")
    looker.page.get_by_role("checkbox").check()
    looker.page.locator("button.first").click()
    looker.page.get_by_text("Frame 1 of 21").wait_for()
    looker.keep("track_player_follows")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda text: text.replace("probability", "p"), "has no column probability"),
        (lambda text: NAMES + "\n", "holds no pose"),
        (lambda text: text.replace("\n0.2,", "\nnan,"), "row 2: time_s is 'nan'"),
        (lambda text: text.replace(",51.9", ",41.9"), "lies off"),
    ],
)
def test_what_is_no_track_of_the_map_is_one_sentence(recorded, tmp_path, change, said):
    track, aerial_map = recorded
    wrong = tmp_path / "wrong.csv"
    wrong.write_text(change(track.read_text()))
    done = CliRunner().invoke(main, ["app", "--track", str(wrong), "--map", str(aerial_map)])
    assert done.exit_code == 1
    assert said in done.output
    assert "Traceback" not in done.output


def test_a_track_needs_a_map_and_no_run(recorded):
    track, aerial_map = map(str, recorded)
    alone = CliRunner().invoke(main, ["app", "--track", track])
    assert alone.exit_code == 2
    assert "--track is played on a map" in alone.output
    both = CliRunner().invoke(
        main, ["app", "generated-city", "--track", track, "--map", aerial_map]
    )
    assert both.exit_code == 2
    assert "leave out RUN" in both.output
