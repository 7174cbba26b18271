"""Reading images: each way in which a file can be wrong names its path."""

import struct
import zlib

import numpy as np
import pytest
from PIL import Image
from slicematch.data import ImageError, denormalise, normalise, read_image
from slicematch.data.images import MAX_PIXELS, turn_panorama


def png_chunk(kind, data):
    body = kind + data
    return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))


def test_missing(tmp_path):
    with pytest.raises(ImageError, match=r"gone\.png: no such image"):
        read_image(tmp_path / "gone.png")


def test_name_too_long_for_the_file_system(tmp_path):
    with pytest.raises(ImageError, match="cannot be read as an image"):
        read_image(tmp_path / ("x" * 5000 + ".png"))


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("keep", [0, 20, 0.5, 0.95], ids=["empty", "header", "half", "nearly all"])
def test_cut_short(tmp_path, paint_texture, suffix, keep):
    path = tmp_path / f"cut{suffix}"
    Image.fromarray(paint_texture(np.random.default_rng(0), 64)).save(path)
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data)) if keep < 1 else keep])
    with pytest.raises(ImageError, match=rf"cut\{suffix}: cannot be read as an image"):
        read_image(path)


def test_corrupt(tmp_path, paint_texture):
    path = tmp_path / "corrupt.png"
    Image.fromarray(paint_texture(np.random.default_rng(0), 64)).save(path)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(ImageError, match=r"corrupt\.png: cannot be read as an image"):
        read_image(path)


def test_another_kind_of_file(tmp_path):
    path = tmp_path / "page.jpg"
    path.write_text("%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10 10\n")
    with pytest.raises(ImageError, match=r"page\.jpg: cannot be read as an image"):
        read_image(path)


@pytest.mark.parametrize("side", [int(MAX_PIXELS**0.5) + 1, 10_000, 60_000])
def test_a_small_file_that_claims_a_huge_image(tmp_path, side):
    path = tmp_path / "bomb.png"
    header = struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + png_chunk(b"IHDR", header)
        + png_chunk(b"IDAT", zlib.compress(bytes(1000)))
        + png_chunk(b"IEND", b"")
    )
    with pytest.raises(ImageError, match=r"bomb\.png: .*(pixels|bomb)"):
        read_image(path)


def test_sixteen_bits_are_refused_rather_than_clipped(tmp_path):
    path = tmp_path / "deep.png"
    Image.fromarray(np.full((4, 4), 40_000, dtype=np.uint16)).save(path)
    with pytest.raises(ImageError, match=r"deep\.png: its pixels are of mode I;16"):
        read_image(path)


@pytest.mark.parametrize("mode", ["L", "RGBA", "P", "1"])
def test_other_modes_become_rgb(tmp_path, mode):
    path = tmp_path / "image.png"
    Image.new("RGB", (4, 2), (255, 255, 255)).convert(mode).save(path)
    image = read_image(path)
    assert image.mode == "RGB"
    assert np.asarray(image).tolist() == np.full((2, 4, 3), 255).tolist()


def test_a_photograph_taken_upright_is_turned_upright(tmp_path):
    path = tmp_path / "phone.jpg"
    exif = Image.Exif()
    exif[0x0112] = 6  # stored lying on its side
    Image.new("RGB", (40, 20)).save(path, exif=exif)
    assert read_image(path).size == (20, 40)


def test_normalise_takes_imagenet_mean_and_deviation_out():
    image = Image.new("RGB", (2, 1), (0, 128, 255))
    pixels = normalise(image)
    assert tuple(pixels.shape) == (3, 1, 2)
    expected = [(0 - 0.485) / 0.229, (128 / 255 - 0.456) / 0.224, (1 - 0.406) / 0.225]
    assert pixels[:, 0, 1].tolist() == pytest.approx(expected, abs=1e-6)
    assert denormalise(pixels).tolist() == np.asarray(image).tolist()


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
