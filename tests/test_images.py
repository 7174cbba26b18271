"""The one reader of images: each way in which a file can be wrong names its path."""

import errno
import os
import resource
import struct
import subprocess
import sys
import zlib
from contextlib import suppress

import numpy as np
import pytest
from PIL import Image

from slicemask.errors import ImageError
from slicemask.images import MAX_PIXELS, read_aerial, read_image


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


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp", ".tif"])
@pytest.mark.parametrize("mode", ["L", "RGB", "RGBA", "P"])
@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("source", [lambda path: path, Image.open], ids=["path", "PIL"])
def test_every_orientation_of_every_format(tmp_path, suffix, mode, orientation, source):
    """The eight cases, by the corner that the darkest quarter belongs in."""
    stored = np.full((20, 40), 200, np.uint8)
    stored[:10, :20] = 0
    stored[:10, 20:] = 90
    upright = {
        1: stored,
        2: stored[:, ::-1],
        3: stored[::-1, ::-1],
        4: stored[::-1],
        5: stored.T,
        6: np.rot90(stored, -1),
        7: stored[::-1, ::-1].T,
        8: np.rot90(stored),
    }[orientation]
    if suffix == ".jpg" and mode in ("RGBA", "P"):
        mode = "CMYK"
    exif = Image.Exif()
    exif[0x0112] = orientation
    path = tmp_path / f"image{suffix}"
    image = Image.fromarray(stored).convert("RGB")
    image = image.quantize(8) if mode == "P" else image.convert(mode)
    # Older versions of Pillow write no EXIF data to TIFF, which has a tag of its own.
    options = {"tiffinfo": {0x0112: orientation}} if suffix == ".tif" else {"exif": exif}
    image.save(path, **options)
    image = np.asarray(read_image(source(path)), dtype=int)
    assert image.shape == (*upright.shape, 3)
    # Lossy formats blur the edges.
    assert np.abs(image - upright[..., None]).mean() < 4


@pytest.mark.parametrize("size", [(128, 127), (127, 128), (512, 502), (64, 64)])
def test_nearly_square_is_square(size):
    assert read_aerial(Image.new("RGB", size)).size == size


@pytest.mark.parametrize("size", [(128, 120), (100, 50), (64, 66)])
def test_what_is_not_square_is_no_tile(size):
    with pytest.raises(ImageError, match=rf"{size[0]}x{size[1]} pixels; .* must be square"):
        read_aerial(Image.new("RGB", size))


HEADS = {
    "a JPEG 2000 file": b"\0\0\0\x0cjP  \r\n\x87\n",
    "a JPEG XL file": b"\xff\x0a\xfa\x1f",
    "an AVIF file": b"\0\0\0\x20ftypavif",
    "a HEIC file": b"\0\0\0\x18ftypheic",
    "a HEIF file": b"\0\0\0\x18ftypmif1",
    "a GIF file": b"GIF89a",
    "a PPM file": b"P6\n1 1\n255\n",
    "a PFM file": b"PF\n1 1\n-1\n",
    "an OpenEXR file": b"v/1\x01\2\0\0\0",
    "a Photoshop file": b"8BPS\0\1",
    "a PDF file": b"%PDF-1.7",
}


@pytest.mark.parametrize("kind", HEADS)
def test_formats_that_are_not_read_are_named(tmp_path, kind):
    path = tmp_path / "image.png"
    path.write_bytes(HEADS[kind] + bytes(100))
    with pytest.raises(ImageError, match=f"is {kind}, which is not read; convert it to JPEG, PNG"):
        read_image(path)


@pytest.mark.parametrize(("suffix", "kind"), [("jp2", "JPEG2000"), ("gif", "GIF"), ("avif", 0)])
def test_real_files_of_formats_that_are_not_read(tmp_path, suffix, kind):
    path = tmp_path / f"image.{suffix}"
    try:
        Image.fromarray(noise()).save(path, kind or None)
    except (KeyError, OSError, ValueError):
        pytest.skip(f"this Pillow writes no {suffix}")
    with pytest.raises(ImageError, match="file, which is not read; convert it to JPEG, PNG"):
        read_image(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"<!DOCTYPE html><html></html>", "is a web page, not an image; download the image"),
        (b"<HTML><body>", "is a web page, not an image"),
        (b"version https://git-lfs.github.com/spec/v1\n", "is a Git LFS pointer.*git lfs pull"),
        (b"\x93NUMPY\1\0", "is a NumPy array, not an image; save it as PNG"),
        (b"\x89HDF\r\n\x1a\n", "is an HDF5 file, not an image"),
        (b"PK\3\4", "is a ZIP archive, not an image; unpack it"),
        (b"\0\0\0\x18ftypisom", "is a video, not an image; save one frame"),
        (b"II*\0\x08\0\0\0\0\0", "is a TIFF file of a kind that is not read.*floating-point"),
    ],
)
def test_files_that_are_no_images_get_a_remedy_that_fits(tmp_path, content, message):
    path = tmp_path / "image.png"
    path.write_bytes(content + bytes(40))
    with pytest.raises(ImageError, match=message):
        read_image(path)


@pytest.mark.parametrize(("mode", "kind"), [("F", "floating-point numbers"), ("I", "32 bits")])
def test_floats_and_32_bits_are_refused(tmp_path, mode, kind):
    image = Image.new(mode, (8, 8), 3)
    image.save(tmp_path / "image.tif")
    for source in (image, tmp_path / "image.tif"):
        with pytest.raises(ImageError, match=f"of mode {mode}, .*{kind}.*; convert it to 8 or 16"):
            read_image(source)


def test_paths_that_name_no_file(tmp_path):
    Image.fromarray(noise()).save(tmp_path / "a.png")
    with pytest.raises(ImageError, match="is a folder; name one image in it"):
        read_image(tmp_path)
    for pattern in ("*.png", "?.png", "[ab]*.png", "*/a.png"):
        with pytest.raises(ImageError, match="name one image, since patterns are not expanded"):
            read_image(str(tmp_path / pattern))
    for address in ("https://example.org/a.png", "s3://bucket/a.png"):
        with pytest.raises(ImageError, match="addresses are not fetched; download the image"):
            read_image(address)
    with pytest.raises(ImageError, match="is no regular file"):
        read_image(os.devnull)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (None, "of type NoneType; it must be a path, a PIL image or an array"),
        (b"\xff\xd8", "of type bytes"),
        (np.zeros((3, 8, 8), np.uint8), r"shape \[3, 8, 8\]; it must be \[height, width, 3\]"),
        (np.zeros((8, 8, 2), np.uint8), r"must be \[height, width, 3\]"),
        (np.zeros((0, 8, 3), np.uint8), "must hold a pixel"),
        (np.zeros((8, 8, 3), np.int16), "array int16 .* must be uint8, uint16 or floating"),
        (np.full((8, 8, 3), 255.0), r"floating-point values must be in \[0, 1\]"),
        (np.full((8, 8, 3), np.nan), r"floating-point values must be in \[0, 1\]"),
        (Image.new("La", (8, 8)), "a PIL image of mode La, is unreadable .*; convert it to mode"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_is_in_memory_and_is_no_image(source, message):
    with pytest.raises(ImageError, match=message):
        read_image(source)


def test_a_pil_image_of_a_cut_file_is_named(tmp_path):
    path = tmp_path / "cut.png"
    Image.fromarray(noise()).save(path)
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(ImageError, match="the image, a PIL image of mode RGB, is unreadable"):
        read_image(Image.open(path))


def test_running_out_of_open_files_is_no_fault_of_the_image(tmp_path):
    path = tmp_path / "image.png"
    Image.fromarray(noise()).save(path)
    read_image(path)  # its decoder is loaded now
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    held = []
    resource.setrlimit(resource.RLIMIT_NOFILE, (64, hard))
    try:
        with suppress(OSError):
            while True:
                held.append(path.open("rb"))
        with pytest.raises(OSError, match="Too many open files") as caught:
            read_image(path)
        assert not isinstance(caught.value, ImageError)
        assert caught.value.errno == errno.EMFILE
    finally:
        for file in held:
            file.close()
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    read_image(path)


def test_running_out_of_memory_is_no_fault_of_the_image(tmp_path):
    path = tmp_path / "image.png"
    Image.new("RGB", (8000, 8000)).save(path)
    program = f"""
import resource
from slicemask.errors import ImageError
from slicemask.images import read_image
read_image({str(tmp_path / "small.png")!r})
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 2**26, -1))
try:
    read_image({str(path)!r})
except MemoryError:
    print("memory")
"""
    Image.new("RGB", (8, 8)).save(tmp_path / "small.png")
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.stdout, done.returncode) == ("memory\n", 0), done.stderr


@pytest.mark.parametrize(
    ("size", "square"),
    [((128, 127), True), ((100, 98), True), ((98, 100), True), ((100, 97), False)],
)
@pytest.mark.parametrize("kind", ["path", "picture", "array"])
def test_what_is_square_stays_so_when_turned(tmp_path, size, square, kind):
    picture = Image.new("RGB", size, (90, 90, 90))
    picture.save(tmp_path / "tile.png")
    source = {"path": tmp_path / "tile.png", "picture": picture, "array": np.asarray(picture)}[kind]
    if square:
        assert read_aerial(source).size == size
    else:
        with pytest.raises(ImageError, match="100x97 pixels; an aerial tile must be square"):
            read_aerial(source)
