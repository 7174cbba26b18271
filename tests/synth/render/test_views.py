"""Both views look at one scene: what a ground ray meets lies where geometry puts it from above."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from slicematch.data.panoramas import turn_panorama

from slicemask import Frustum, slice_masks
from slicemask.synth.layout.elements import Kind, Landmark
from slicemask.synth.render.cameras import SKY_M, Aerial, Panorama, Pinhole
from slicemask.synth.render.grade import Grade
from slicemask.synth.render.light import Light
from slicemask.synth.render.render import render
from slicemask.synth.render.scene import SceneBuilder, add_landmark, build_scene

METRES_PER_PIXEL, PIXELS = 0.11, 640
NOON = Light(180.0, 60.0, 0.8, 0.6, (0.4, 0.6, 0.8), (0.9, 0.9, 0.9), 0.0, 1e5)


def ground_cameras(place):
    x, y = place
    return [
        Panorama((x, y, 2.5), (128, 256)),
        Pinhole((x, y, 1.65), 217.0, (125, 414), 240.5, 57.6),
    ]


def test_ground_rays_meet_what_the_aerial_image_shows_there(ground_scene, cameras):
    """Seen from above, the point itself shows, or something higher that covers it."""
    rng = np.random.default_rng(1)
    visible = covered = 0
    for place in cameras[:6]:
        aerial = Aerial.centred(*place, METRES_PER_PIXEL, PIXELS)
        for camera in ground_cameras(place):
            rows, columns = camera.shape
            row, column = rng.uniform(0, rows, 400), rng.uniform(0, columns, 400)
            origins, directions = camera.rays(row, column)
            hits = ground_scene.trace(origins, directions)
            seen = (hits.face >= 0) & (hits.distance_m < 40)
            points = (origins + hits.distance_m[:, None] * directions)[seen]
            # The camera's own projection leads back to the pixel.
            back_row, back_column = camera.project(points)
            assert back_row == pytest.approx(row[seen], abs=1e-2)
            assert back_column == pytest.approx(column[seen], abs=1e-2)
            # So does the aerial's: a ray down through that pixel meets the point or what covers it.
            # Points on walls are taken a centimetre into them, where the roof is above.
            level = np.abs(ground_scene.normals[hits.face[seen], 2]) > 0.9
            inside = points + 0.01 * directions[seen] * ~level[:, None]
            down = ground_scene.trace(*aerial.rays(*aerial.project(inside)))
            height = SKY_M - down.distance_m
            assert (height > inside[:, 2] - 5e-3)[level].all()
            assert (height > inside[:, 2] - 5e-3).mean() > 0.99  # but for rays that graze an edge
            same = np.abs(height - points[:, 2]) < 5e-3
            visible += (same & level).sum()
            cover = ground_scene.surfaces.kind[ground_scene.surface[down.face[level & ~same]]]
            covered += len(cover)
            # Only what overhangs covers ground that can be seen from the street.
            assert np.isin(
                cover, [Kind.LEAVES, Kind.PLAIN, Kind.TILES, Kind.PAINT, Kind.GLASS]
            ).all()
    assert visible > 500
    assert visible > 10 * covered


def test_place_in_the_aerial_image_is_the_azimuth_and_range_of_the_ray(ground_scene, cameras):
    place = cameras[0]
    panorama = Panorama((*place, 2.5), (128, 256))
    aerial = Aerial.centred(*place, METRES_PER_PIXEL, PIXELS)
    row, column = (part.ravel() + 0.5 for part in np.mgrid[70:128, :256])
    origins, directions = panorama.rays(row, column)
    hits = ground_scene.trace(origins, directions)
    points = origins + hits.distance_m[:, None] * directions
    v, u = (part / PIXELS for part in aerial.project(points))
    azimuth_deg = 360 * (column / 256 - 0.5)
    range_m = hits.distance_m * np.cos(np.pi * (0.5 - row / 128))
    share = range_m / (METRES_PER_PIXEL * PIXELS)
    assert u == pytest.approx(0.5 + share * np.sin(np.radians(azimuth_deg)), abs=1e-5)
    assert v == pytest.approx(0.5 - share * np.cos(np.radians(azimuth_deg)), abs=1e-5)


def magenta(image):
    """Rows and columns of magenta pixels of uint8 [H, W, 3]."""
    red, green, blue = np.moveaxis(image.astype(int), -1, 0)
    bright = np.minimum(red, blue)
    return np.nonzero((bright > 40) & (green < 0.6 * bright) & (abs(red - blue) < 0.3 * bright))


def views_with_landmark(city, place, azimuth_deg, camera, range_m=4.0):
    """Ground and aerial image of the city with a magenta column near a camera."""
    x, y = place + range_m * np.array(
        [np.sin(np.radians(azimuth_deg)), np.cos(np.radians(azimuth_deg))]
    )
    landmark = Landmark(float(x), float(y), "column", 3.0, 0.4, (0.6, 0.02, 0.6))
    # Nothing else may be magenta, or hide the column from above.
    nothing = dict.fromkeys(("buildings", "trees", "lamps", "cars_ground", "cars_aerial"), ())
    placed = replace(city, landmarks=(landmark,), **nothing)
    grade = Grade((1.0, 1.0, 1.0), 1.0, 1.0, 0.0)
    rng = np.random.default_rng(0)
    # The tile's centre is off the camera, as in the data sets.
    aerial = Aerial.centred(place[0] + 5.0, place[1] - 8.0, 0.22, 320)
    tile = grade.apply(render(build_scene(placed, "aerial"), aerial, NOON), rng)
    ground = grade.apply(render(build_scene(placed, "ground"), camera, NOON), rng)
    v, u = (part / 320 for part in aerial.project(np.array(place)))
    return ground, tile, (float(u), float(v))


def slice_that_holds(masks, tile_pixels):
    """The slice that covers most of the tile's pixels (rows, columns)."""
    cells = masks.shape[-1]
    rows, columns = (np.asarray(part) * cells // 320 for part in tile_pixels)
    return int(np.argmax(masks[:, rows, columns].sum(axis=1)))


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 337.5])
@pytest.mark.parametrize("azimuth_deg", [12.0, 192.0])
def test_landmark_shows_in_its_column_and_slice_of_a_rolled_panorama(
    city, cameras, azimuth_deg, heading_deg
):
    place = cameras[1]
    camera = Panorama((*place, 2.5), (256, 512))
    ground, tile, (u, v) = views_with_landmark(city, place, azimuth_deg, camera)
    turned = np.asarray(turn_panorama(Image.fromarray(ground), heading_deg, (256, 512)))
    _, columns = magenta(turned)
    assert len(columns) > 100
    offset_deg = (azimuth_deg - heading_deg + 180) % 360 - 180
    expected = 512 * (offset_deg / 360 + 0.5)
    assert np.mean(columns + 0.5) == pytest.approx(expected, abs=1.5)

    frustum = Frustum(360.0, 16)
    masks = slice_masks([(u, v, heading_deg)], frustum, 64)[0]
    assert slice_that_holds(masks, magenta(tile)) == int(expected // 32)


@pytest.mark.parametrize(("heading_deg", "offset_deg"), [(0.0, -28.0), (75.0, 5.5), (290.0, 36.5)])
def test_landmark_shows_in_its_column_and_slice_of_a_pinhole_image(
    city, cameras, heading_deg, offset_deg
):
    place = cameras[2]
    camera = Pinhole((*place, 1.65), heading_deg, (125, 414), 721.5377 / 3, 57.6)
    ground, tile, (u, v) = views_with_landmark(
        city, place, heading_deg + offset_deg, camera, range_m=4.5
    )
    _, columns = magenta(ground)
    expected = 207 + 721.5377 / 3 * np.tan(np.radians(offset_deg))
    assert len(columns) > 100
    assert np.median(columns + 0.5) == pytest.approx(expected, abs=3.0)

    hfov_deg = float(np.degrees(2 * np.arctan(207 / (721.5377 / 3))))
    frustum = Frustum(hfov_deg, 8, "pinhole")
    masks = slice_masks([(u, v, heading_deg)], frustum, 64)[0]
    assert slice_that_holds(masks, magenta(tile)) == int(expected // (414 / 8))


def test_parked_cars_agree_between_the_views_and_a_few_do_not(city):
    aerial = {(car.x, car.y, car.colour) for car in city.cars_aerial}
    ground = {(car.x, car.y, car.colour) for car in city.cars_ground}
    assert 0.4 < len(aerial & ground) / len(aerial) < 0.95


def test_each_view_shows_its_own_cars(city, aerial_scene):
    ground_scene = build_scene(city, "ground")
    only_above = set(city.cars_aerial) - set(city.cars_ground)
    above = np.array([(car.x, car.y, SKY_M) for car in only_above])
    painted = []
    for scene in (aerial_scene, ground_scene):
        hits = scene.trace(above, np.broadcast_to([0.0, 0.0, -1.0], above.shape))
        kinds = scene.surfaces.kind[scene.surface[hits.face]]
        painted.append(np.isin(kinds, [Kind.PAINT, Kind.GLASS]).mean())
    assert painted[0] > 0.6  # the others stand under trees
    assert painted[1] < 0.4


def test_light_and_colours_differ_from_draw_to_draw():
    rng = np.random.default_rng(0)
    lights = [Light.draw(rng) for _ in range(20)]
    assert len({light.sun_azimuth_deg for light in lights}) == 20
    assert {light.sun < 0.3 for light in lights} == {True, False}
    gains = np.array([Grade.draw(rng).gains for _ in range(50)])
    assert (gains.std(axis=0) > 0.02).all()


def test_sun_casts_a_shadow_away_from_it():
    builder = SceneBuilder()
    a, b, c, d = (-20, -20, 0), (20, -20, 0), (20, 20, 0), (-20, 20, 0)
    builder.add(np.array([[a, b, c], [a, c, d]], float), np.zeros(2, int), (Kind.PLAIN,),
                ((0.5, 0.5, 0.5),))  # fmt: skip
    add_landmark(builder, Landmark(0, 0, "column", 4.0, 1.0, (0.5, 0.5, 0.5)))
    aerial = Aerial.centred(0.0, 0.0, 0.25, 80)
    image = render(builder.build(), aerial, NOON).mean(axis=-1)  # the sun stands in the south
    north = image[40 - 8, 40]  # 2 m north of the middle, beyond the foot
    south = image[40 + 8, 40]
    assert north < 0.8 * south
