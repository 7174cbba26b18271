"""Panoramas: whole spheres, turned to a heading."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from slicematch.data import panoramas
from slicematch.data.panoramas import cut_hfov, level, read_panorama, turn_panorama

from slicemask.errors import ImageError


def marked_panorama(width, azimuth_deg):
    """A grey panorama, north at the centre, brightest at an azimuth and fading to both sides."""
    azimuth = np.radians(360 * ((np.arange(width) + 0.5) / width - 0.5) - azimuth_deg)
    row = 127 + 127 * np.cos(azimuth)
    return Image.fromarray(
        np.rint(row * np.ones((width // 2, 1)))[..., None].repeat(3, 2).astype("u1")
    )


def brightest_azimuth_deg(image):
    """Where the one wave along the columns peaks, clockwise from the centre of the image."""
    rows = np.asarray(image, dtype=float)[..., 0]
    width = rows.shape[1]
    angle = 2 * np.pi * ((np.arange(width) + 0.5) / width - 0.5)
    return np.degrees(np.angle((rows.mean(axis=0) * np.exp(1j * angle)).sum()))


@pytest.mark.parametrize(("azimuth_deg", "column"), [(-90, 0.25), (0, 0.5), (90, 0.75)])
def test_west_north_and_east_of_a_panorama(azimuth_deg, column):
    row = np.asarray(marked_panorama(512, azimuth_deg))[0, :, 0]
    assert abs(int(row.argmax()) - 512 * column) <= 8  # the peak is flat for some columns


@pytest.mark.parametrize("width", [2048, 640, 514])
@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 360 * 700 / 2048, 200.3, 359.9])
def test_turning_brings_the_heading_to_the_centre(width, heading_deg):
    turned = turn_panorama(marked_panorama(width, heading_deg), heading_deg, (32, 64))
    assert turned.size == (64, 32)
    # A tenth of a column of 640; eight bits a pixel allow no finer reading.
    assert brightest_azimuth_deg(turned) == pytest.approx(0, abs=0.056)


def test_whole_columns_are_rolled_left_and_nothing_else(paint_texture):
    pixels = paint_texture(np.random.default_rng(1), 256)[:128]
    column = 75
    turned = turn_panorama(Image.fromarray(pixels), 360 * column / 256, (128, 256))
    assert np.array_equal(np.asarray(turned), np.roll(pixels, -column, axis=1))


def test_both_edges_of_a_turned_panorama_wrap_round(paint_texture):
    image = Image.fromarray(paint_texture(np.random.default_rng(2), 512)[:256])
    straight = np.asarray(turn_panorama(image, 0.0, (64, 128)), dtype=int)
    half = np.asarray(turn_panorama(image, 180.0, (64, 128)), dtype=int)
    assert np.abs(np.roll(half, 64, axis=1) - straight).max() <= 1


FIELDS = {
    "FullPanoWidthPixels": 64,
    "FullPanoHeightPixels": 32,
    "CroppedAreaImageWidthPixels": 40,
    "CroppedAreaImageHeightPixels": 20,
    "CroppedAreaLeftPixels": 8,
    "CroppedAreaTopPixels": 4,
}


def packet(fields, style="attributes", prefix="GPano"):
    if style == "attributes":
        inside = " ".join(f'{prefix}:{key}="{value}"' for key, value in fields.items()) + "/>"
    else:
        elements = (f"<{prefix}:{key}> {value}\n</{prefix}:{key}>" for key, value in fields.items())
        inside = f">{''.join(elements)}</rdf:Description>"
    return (
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF '
        'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description '
        f'xmlns:{prefix}="http://ns.google.com/photos/1.0/panorama/" {inside}'
        "</rdf:RDF></x:xmpmeta>"
    ).encode()


def tagged(pixels, fields, **style):
    image = Image.fromarray(pixels)
    image.info["xmp"] = packet(fields, **style)
    return image


def part(width=40, height=20):
    return np.random.default_rng(3).integers(1, 256, (height, width, 3), dtype=np.uint8)


@pytest.mark.parametrize("style", ["attributes", "elements"])
@pytest.mark.parametrize("prefix", ["GPano", "pano"])
def test_a_part_of_a_sphere_is_pasted_where_it_belongs(style, prefix):
    pixels = part()
    sphere = np.asarray(read_panorama(tagged(pixels, FIELDS, style=style, prefix=prefix)).image)
    expected = np.zeros((32, 64, 3), np.uint8)
    expected[4:24, 8:48] = pixels
    assert np.array_equal(sphere, expected)


def test_a_part_may_reach_across_the_seam():
    pixels = part()
    fields = FIELDS | {"CroppedAreaLeftPixels": 50}
    sphere = np.asarray(read_panorama(tagged(pixels, fields)).image)
    assert np.array_equal(sphere[4:24, 50:], pixels[:, :14])
    assert np.array_equal(sphere[4:24, :26], pixels[:, 14:])
    assert not sphere[4:24, 26:50].any()


def test_a_part_that_was_made_smaller_keeps_its_proportions():
    sphere = read_panorama(tagged(part(20, 10), FIELDS)).image
    assert sphere.size == (32, 16)
    assert np.array_equal(np.asarray(sphere)[2:12, 4:24], part(20, 10))


@pytest.mark.parametrize("suffix", ["jpg", "png", "webp", "tif"])
def test_every_format_carries_the_data(tmp_path, suffix):
    path = tmp_path / f"part.{suffix}"
    content = packet(FIELDS)
    info = PngInfo()
    info.add_itxt("XML:com.adobe.xmp", content.decode())
    options = {
        "jpg": {"quality": 100},
        "png": {"pnginfo": info},
        "webp": {"xmp": content, "lossless": True},
        "tif": {"tiffinfo": {700: content}},
    }
    Image.fromarray(part()).save(path, **options[suffix])
    if suffix == "jpg":  # by hand, since older versions of Pillow write none
        segment = b"http://ns.adobe.com/xap/1.0/\0" + content
        data = path.read_bytes()
        head = b"\xff\xe1" + (len(segment) + 2).to_bytes(2, "big")
        path.write_bytes(data[:2] + head + segment + data[2:])
    for source in (path, Image.open(path)):
        sphere = np.asarray(read_panorama(source).image)
        assert sphere.shape == (32, 64, 3)
        assert sphere[4:24, 8:48].any(axis=(0, 2)).all()
        assert not sphere[26:].any()


def test_the_heading_is_handed_on():
    whole = part(64, 32)
    assert read_panorama(Image.fromarray(whole)).heading_deg is None
    for written, heading_deg in (("90.5", 90.5), ("-90", 270.0), ("360", 0.0)):
        panorama = read_panorama(tagged(whole, {"PoseHeadingDegrees": written}))
        assert panorama.heading_deg == heading_deg
        assert np.array_equal(panorama.image, whole)


def test_what_the_data_say_is_logged_once_of_each_kind(caplog, monkeypatch):
    monkeypatch.setattr(panoramas, "_said", set())
    for _ in range(2):
        read_panorama(tagged(part(), FIELDS | {"PoseHeadingDegrees": 30}))
    assert sorted(text.partition(": ")[2] for text in caplog.messages) == [
        "is a part of a sphere, as its GPano data say; the rest is black",
        "its GPano data say that it faces 30 degrees",
    ]


def directions(height):
    """Right, ahead and up [height, 2 height, 3] of the pixels of a sphere."""
    azimuth = 2 * np.pi * ((np.arange(2 * height) + 0.5) / (2 * height) - 0.5)
    elevation = (np.pi * (0.5 - (np.arange(height) + 0.5) / height))[:, None]
    level = np.cos(elevation)
    parts = level * np.sin(azimuth), level * np.cos(azimuth), np.sin(elevation) + 0 * azimuth
    return np.stack(parts, axis=-1)


def seen_along(rays):
    """The colours of a smooth world around a camera: uint8 of directions [..., 3]."""
    waves = np.stack(
        [np.sin(3 * rays[..., 0] + rays[..., 2]), rays[..., 1], np.cos(4 * rays[..., 2])], axis=-1
    )
    return np.rint(127 + 120 * waves).astype(np.uint8)


def tilted(height, pitch_deg, roll_deg):
    """What a camera sees of that world that was pitched up and then rolled clockwise."""
    pitch, roll = np.radians(pitch_deg), np.radians(roll_deg)
    ahead = np.array([0, np.cos(pitch), np.sin(pitch)])
    pitched_up = np.array([0, -np.sin(pitch), np.cos(pitch)])
    right = np.cos(roll) * np.array([1, 0, 0]) - np.sin(roll) * pitched_up
    up = np.sin(roll) * np.array([1, 0, 0]) + np.cos(roll) * pitched_up
    rays = directions(height) @ np.stack([right, ahead, up])
    return Image.fromarray(seen_along(rays))


@settings(max_examples=20, deadline=None)
@given(st.floats(-90, 90), st.floats(-180, 180))
@example(30.0, 0.0)
@example(0.0, 90.0)
@example(-90.0, 45.0)
def test_a_levelled_panorama_is_what_a_level_camera_sees(pitch_deg, roll_deg):
    height = 96
    expected = seen_along(directions(height)).astype(int)
    found = np.asarray(level(tilted(height, pitch_deg, roll_deg), pitch_deg, roll_deg))
    assert np.abs(found - expected).max() <= 3


@pytest.mark.parametrize(
    ("pitch_deg", "roll_deg", "shown_at", "belongs_at"),
    [
        # Pixels of a sphere 36 high, in units of 5 degrees: row 18 is just below the horizon.
        (30, 0, (18, 36), (12, 36)),  # looking up: the centre shows what is 30 degrees up
        (-30, 0, (18, 36), (24, 36)),
        (0, 90, (18, 54), (35, None)),  # its right side down: what is to the right is below
        (0, -90, (18, 54), (0, None)),
        (0, 30, (18, 54), (24, 54)),
    ],
)
def test_the_signs_of_pitch_and_roll(pitch_deg, roll_deg, shown_at, belongs_at):
    pixels = np.zeros((36, 72, 3), np.uint8)
    row, column = shown_at
    pixels[row - 1 : row + 1, column - 1 : column + 1] = 255  # around a corner of pixels
    found = np.asarray(level(Image.fromarray(pixels), pitch_deg, roll_deg), dtype=float)[..., 0]
    rows, columns = np.indices(found.shape) + 0.5
    row, column = belongs_at
    assert (rows * found).sum() / found.sum() == pytest.approx(row, abs=1.0)
    if column is not None:
        assert (columns * found).sum() / found.sum() == pytest.approx(column, abs=1.0)


@pytest.mark.parametrize("key", ["PosePitchDegrees", "PoseRollDegrees"])
def test_tilted_panoramas_are_levelled(key, caplog, monkeypatch):
    monkeypatch.setattr(panoramas, "_said", set())
    pixels = part(64, 32)
    for tilt in (0, 1.9, -1.9, 359):
        assert np.array_equal(read_panorama(tagged(pixels, {key: tilt})).image, pixels)
    for tilt in (2.1, -30, 180):
        fields = {key: tilt, "PoseHeadingDegrees": 40}
        found = read_panorama(tagged(pixels, fields))
        pitch_roll = (tilt, 0) if key == "PosePitchDegrees" else (0, tilt)
        expected = np.asarray(level(Image.fromarray(pixels), *pitch_roll))
        assert np.array_equal(found.image, expected)
        assert found.heading_deg == 40
        # It is level now, and still says where it faces.
        again = read_panorama(found.image)
        assert np.array_equal(again.image, expected)
        assert again.heading_deg == 40
    assert sum("is levelled" in text for text in caplog.messages) == 1


def test_a_strip_around_the_horizon_is_pasted_or_resized(caplog, monkeypatch):
    monkeypatch.setattr(panoramas, "_said", set())
    pixels = part(64, 16)
    sphere = np.asarray(read_panorama(pixels).image)
    assert sphere.shape == (32, 64, 3)
    assert np.array_equal(sphere[8:24], pixels)
    assert not sphere[:8].any()
    assert "strip of a panorama" in caplog.text
    resized = np.asarray(read_panorama(pixels, "resize").image)
    assert resized.shape == (32, 64, 3)
    assert resized.any(axis=(1, 2)).all()


def test_an_image_that_shows_more_than_a_sphere_is_refused_unless_resized():
    with pytest.raises(ImageError, match=r"64x48 pixels; .* at least 2 times as wide as high"):
        read_panorama(part(64, 48))
    assert read_panorama(part(64, 48), "resize").image.size == (64, 32)


def test_an_image_of_the_field_of_view_alone_is_the_middle_of_a_sphere():
    pixels = part(32, 32)
    sphere = np.asarray(read_panorama(pixels, hfov_deg=180.0).image)
    assert np.array_equal(sphere[:, 16:48], pixels)
    assert not sphere[:, :16].any()


@pytest.mark.parametrize("hfov_deg", [360.0, 180.0, 90.0, 70.0])
def test_a_field_of_view_is_cut_around_the_heading(hfov_deg):
    width = 720
    azimuth_deg = 360 * ((np.arange(width) + 0.5) / width - 0.5)
    wave = np.rint(127 + 127 * np.cos(np.radians(azimuth_deg))).astype(np.uint8)
    image = Image.fromarray(np.broadcast_to(wave[None, :, None], (360, width, 3)).copy())
    columns = int(hfov_deg / 2)
    turned = np.asarray(turn_panorama(image, 50.0, (20, columns), hfov_deg))[0, :, 0].astype(int)
    seen_deg = 50.0 + hfov_deg * ((np.arange(columns) + 0.5) / columns - 0.5)
    expected = 127 + 127 * np.cos(np.radians(seen_deg))
    assert np.abs(turned - expected).max() <= 2
    assert cut_hfov(image, hfov_deg).size == (2 * hfov_deg, 360)
    assert np.array_equal(
        np.asarray(cut_hfov(image, hfov_deg))[0, 0], np.asarray(image)[0, int(360 - hfov_deg)]
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ProjectionType": "cylindrical"}, "projection is 'cylindrical'.*must be equirectangular"),
        ({"FullPanoWidthPixels": "wide"}, "say FullPanoWidthPixels 'wide'; expected a number"),
        ({"PoseHeadingDegrees": "nan"}, "say PoseHeadingDegrees 'nan'; expected a number"),
        ({"CroppedAreaTopPixels": 20}, "40x20 pixels do not fit its GPano data .*TopPixels 20"),
        ({"CroppedAreaTopPixels": -1}, "do not fit its GPano data"),
        ({"CroppedAreaLeftPixels": 64}, "do not fit its GPano data"),
        ({"CroppedAreaImageHeightPixels": 28}, "do not fit its GPano data"),
        ({"CroppedAreaImageWidthPixels": -40}, "do not fit its GPano data"),
        ({"FullPanoHeightPixels": 40}, "64x40 pixels; a panorama must be at least 2"),
    ],
)
def test_data_that_do_not_fit_are_refused(change, message):
    with pytest.raises(ImageError, match=message):
        read_panorama(tagged(part(), FIELDS | change))


@pytest.mark.parametrize(
    ("name", "size", "row", "column"), [("crop", (256, 128), 14, 0), ("half", (512, 256), 64, 128)]
)
def test_parts_as_cameras_write_them(name, size, row, column):
    path = Path(__file__).parents[4] / "shared" / "data" / "awkward" / f"pano_gpano_{name}.jpg"
    if not path.is_file():
        pytest.skip("the awkward inputs are not here")
    sphere = read_panorama(path).image
    assert sphere.size == size
    pixels = np.asarray(Image.open(path))
    height, width, _ = pixels.shape
    found = np.asarray(sphere)
    assert np.array_equal(found[row : row + height, column : column + width], pixels)
    assert found.astype(int).sum() == pixels.astype(int).sum()


def test_a_small_part_of_a_huge_sphere_is_refused():
    """Pasted, it would fill the memory."""
    fields = {
        "FullPanoWidthPixels": 2_000_000,
        "FullPanoHeightPixels": 1_000_000,
        "CroppedAreaImageWidthPixels": 40,
        "CroppedAreaImageHeightPixels": 20,
    }
    with pytest.raises(ImageError, match="a sphere of 2000000x1000000 pixels, more than the 80,"):
        read_panorama(tagged(part(), fields))
