"""The one reader of images: each way in which a file can be wrong names its path."""

import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from slicemask.errors import ImageError
from slicemask.images import MAX_PIXELS, read_image


def noise(side=64):
    return np.random.default_rng(0).integers(0, 256, (side, side, 3), dtype=np.uint8)


def png_chunk(kind, data):
    body = kind + data
    return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))


def test_missing(tmp_path):
    with pytest.raises(ImageError, match=r"gone\.png: there is no such image"):
        read_image(tmp_path / "gone.png")


def test_name_too_long_for_the_file_system(tmp_path):
    with pytest.raises(ImageError, match=r"is unreadable \(File name too long\)"):
        read_image(tmp_path / ("x" * 5000 + ".png"))


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("keep", [0, 20, 0.5, 0.95], ids=["empty", "header", "half", "nearly all"])
def test_cut_short(tmp_path, suffix, keep):
    path = tmp_path / f"cut{suffix}"
    Image.fromarray(noise()).save(path)
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data)) if keep < 1 else keep])
    with pytest.raises(ImageError, match=rf"cut\{suffix}: is unreadable as an image"):
        read_image(path)


def test_corrupt(tmp_path):
    path = tmp_path / "corrupt.png"
    Image.fromarray(noise()).save(path)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(ImageError, match=r"corrupt\.png: is unreadable as an image"):
        read_image(path)


def test_another_kind_of_file(tmp_path):
    path = tmp_path / "page.jpg"
    path.write_text("%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10 10\n")
    with pytest.raises(ImageError, match=r"page\.jpg: is a PostScript file, which is not read"):
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
