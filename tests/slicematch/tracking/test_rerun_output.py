"""A track for the Rerun viewer: its recording read back, and what is said without the extra."""

import subprocess
import sys

import numpy as np
import pytest
from slicematch.data.maps import AerialMap
from slicematch.tracking.outputs import Track
from slicematch.tracking.rerun_output import check_rerun_target, save_rerun
from slicematch.tracking.track_estimate import TrackEstimate, TrackMode

from slicemask.errors import OutputError


@pytest.fixture
def track(mapped):
    """Three poses to the east; the last one in doubt."""
    south, west, north, east = AerialMap.open(mapped.map).bounds()
    lat, lon = (south + north) / 2, (west + east) / 2
    estimates = []
    for k in range(3):
        covariance = np.diag([4.0, 1.0, 9.0])
        modes = [TrackMode(lat, lon, 90.0, covariance, 1.0, 5.0 * k, 0.0)]
        if k == 2:
            modes.append(TrackMode(lat, lon, 270.0, covariance, 0.3, 30.0, 8.0))
        estimates.append(TrackEstimate(float(k), tuple(modes), True, ("a note",) * (k == 1)))
    return Track([7.0, 8.0, 9.0], estimates, (lat, lon))


def test_a_recording_holds_the_map_the_belief_and_the_images(track, mapped, tmp_path):
    pytest.importorskip("rerun")
    photo = sorted(mapped.folder.iterdir())[0]
    images = [str(photo), None, np.zeros((8, 16, 3), np.uint8)]
    truths = [(*track.origin, 90.0), None, None]
    path = tmp_path / "track.rrd"
    save_rerun(AerialMap.open(mapped.map), track, images, truths, path)
    assert [file.name for file in tmp_path.iterdir()] == ["track.rrd"]
    command = [sys.executable, "-m", "rerun", "rrd", "print", "-v", str(path)]
    found = subprocess.run(command, capture_output=True, text=True, check=True)
    said = found.stdout + found.stderr
    for entity in ("map", "map/track", "map/modes", "map/ellipses", "map/truth", "image",
                   "belief/probability", "belief/ellipse_m", "belief/notes"):  # fmt: skip
        assert f"/{entity}" in said, entity


def test_without_the_extra_it_is_one_sentence(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(OutputError, match=r"track.rrd: needs Rerun.*pip install 'slicemask\[rerun"):
        check_rerun_target(tmp_path / "track.rrd")
    with pytest.raises(OutputError, match=r"its suffix is \.txt"):
        check_rerun_target(tmp_path / "track.txt")
