"""Cameras and imagery that differ: where things show, and what is left of the picture."""

import numpy as np
import pytest

from slicemask.synth.render.cameras import Aerial, Panorama
from slicemask.synth.render.patterns import as_float32
from slicemask.synth.vary import camera as cameras
from slicemask.synth.vary import imagery
from slicemask.synth.vary.artefacts import blur, compress, resample, sharpen
from slicemask.synth.vary.exposure import Exposure
from slicemask.synth.vary.light import draw_weather

SCENE = np.random.default_rng(0).integers(0, 256, (64, 128, 3)).astype(np.uint8)


def mounted(count=40):
    level = Panorama((3.0, -2.0, 2.5), (128, 256))
    return [cameras.mount(level, np.random.default_rng(seed)) for seed in range(count)]


def test_cameras_stand_where_they_stood_at_other_heights_and_not_level():
    found = mounted()
    heights = np.array([camera.position[2] for camera in found])
    assert {camera.position[:2] for camera in found} == {(3.0, -2.0)}
    assert 1.5 <= heights.min() < 1.8
    assert 2.9 < heights.max() <= 3.2
    tilts = np.array([(camera.pitch_deg, camera.roll_deg) for camera in found])
    assert 1.5 < np.abs(tilts).max() <= 3.0


def test_tilted_panoramas_project_back_and_keep_the_azimuth():
    rng = np.random.default_rng(1)
    for camera in mounted(8):
        row, column = rng.uniform(10, 118, 50), rng.uniform(1, 255, 50)
        origins, rays = camera.rays(row, column)
        assert np.linalg.norm(rays, axis=1) == pytest.approx(1.0)
        back = camera.project(origins + 7.0 * rays)
        assert back[0] == pytest.approx(row, abs=1e-6)
        assert back[1] == pytest.approx(column, abs=1e-6)
        # On the horizon a tilt of three degrees moves azimuths by less than a tenth of one.
        _, rays = camera.rays(np.full(50, 64.0), column)
        azimuth = np.degrees(np.arctan2(rays[:, 0], rays[:, 1]))
        off = (azimuth - 360 * (column / 256 - 0.5) + 180) % 360 - 180
        assert np.abs(off).max() < 0.1


def test_a_positive_pitch_shows_the_north_lower_and_a_roll_the_east_higher():
    north, east = np.array([[0.0, 9.0, 2.0]]), np.array([[9.0, 0.0, 2.0]])
    level = Panorama((0.0, 0.0, 2.0), (128, 256))
    pitched = Panorama((0.0, 0.0, 2.0), (128, 256), pitch_deg=3.0)
    rolled = Panorama((0.0, 0.0, 2.0), (128, 256), roll_deg=3.0)
    pixels = 3.0 / 180 * 128
    assert pitched.project(north)[0] - level.project(north)[0] == pytest.approx(pixels)
    assert pitched.project(east)[0] == pytest.approx(level.project(east)[0])
    assert level.project(east)[0] - rolled.project(east)[0] == pytest.approx(pixels)


def test_leaning_tiles_keep_the_ground_and_move_what_is_high():
    straight = Aerial.centred(10.0, 20.0, 0.2, 320)
    ground, roof = np.array([[14.0, 25.0, 0.0]]), np.array([[14.0, 25.0, 30.0]])
    moved = []
    for seed in range(30):
        leaning = imagery.lean(straight, np.random.default_rng(seed))
        assert np.ravel(leaning.project(ground)) == pytest.approx(
            np.ravel(straight.project(ground))
        )
        off = np.subtract(leaning.project(roof), straight.project(roof)) * 0.2
        moved.append(float(np.hypot(*off)[0]))
        # The ray through the pixel meets the roof.
        origins, rays = leaning.rays(*leaning.project(roof))
        met = origins + rays * ((30.0 - origins[:, 2:]) / rays[:, 2:])
        assert met == pytest.approx(roof)
    assert max(moved) <= 30 * np.tan(np.radians(10.0)) + 1e-6
    assert max(moved) > 4
    assert min(moved) < 2


def test_cropped_panoramas_keep_a_band_of_elevations():
    bands, grey = [], np.full((180, 360, 3), 90, dtype=np.uint8)
    for seed in range(30):
        found = cameras.crop_elevations(grey, 0.0, np.random.default_rng(seed))
        rows = np.flatnonzero((found == 90).all(axis=(1, 2)))
        assert (np.diff(rows) == 1).all()
        bands.append((90.5 - rows[0] - 1, 90.5 - rows[-1] - 1))
    assert (39.5 - 0.5, -25.5) in bands or (38.5, -25.5) in bands
    assert any((cameras.crop_elevations(SCENE, 0.0, np.random.default_rng(seed))[0] == 0).all()
               for seed in range(9))  # fmt: skip


def test_pictures_keep_their_shape_whatever_befalls_them():
    for seed in range(25):
        rng = np.random.default_rng(seed)
        for found in (cameras.develop(SCENE, 70.0, rng), imagery.develop(SCENE, 0.2, rng)):
            assert found.shape == SCENE.shape
            assert found.dtype == np.uint8


def test_coarse_imagery_has_lost_detail_and_jpeg_leaves_blocks():
    detail = np.abs(np.diff(SCENE.astype(int), axis=1)).mean()
    for found in (resample(SCENE, 0.3), blur(SCENE, 1.0)):
        assert np.abs(np.diff(found.astype(int), axis=1)).mean() < 0.5 * detail
    soft = blur(SCENE, 1.0)
    assert (np.abs(np.diff(sharpen(soft, 150).astype(int), axis=1)).mean()
            > np.abs(np.diff(soft.astype(int), axis=1)).mean())  # fmt: skip
    assert 1 < np.abs(compress(soft, 20).astype(int) - soft).mean() < 20


def test_exposure_brings_pictures_to_its_brightness():
    image = as_float32(np.random.default_rng(1).uniform(0.2, 0.6, (40, 80, 3)))
    means = []
    for seed in range(30):
        exposure = Exposure.draw(np.random.default_rng(seed), aerial=bool(seed % 2))
        found = exposure.apply(image)
        expected = exposure.black + (1 - exposure.black) * exposure.brightness
        assert found.mean() == pytest.approx(expected, rel=0.06)
        means.append(found.mean())
    assert max(means) > 2 * min(means)


def test_weather_is_of_any_hour_and_its_sky_brightest_at_the_sun():
    drawn = [draw_weather(np.random.default_rng(seed)) for seed in range(60)]
    azimuths = np.array([weather.sun_azimuth_deg for weather in drawn])
    elevations = np.array([weather.sun_elevation_deg for weather in drawn])
    assert (np.histogram(azimuths, bins=4, range=(0, 360))[0] > 5).all()
    assert elevations.min() < 20
    assert elevations.max() > 60
    clear = next(weather for weather in drawn if weather.sun > 0.6 and weather.clouds < 0.3)
    towards = clear.towards_sun
    away = as_float32([-towards[0], -towards[1], towards[2]])
    at_sun, opposite = clear.sky(np.stack([towards, away])).mean(axis=1)
    assert at_sun > opposite + 0.3
