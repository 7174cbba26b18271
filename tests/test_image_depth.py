"""Images of 16 bits a channel: every way of storing them shows what its 8-bit counterpart shows."""

import logging
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from slicemask import image_depth
from slicemask.errors import ImageError
from slicemask.images import read_aerial, read_image

AWKWARD = Path(__file__).parents[2] / "shared" / "data" / "awkward"


@pytest.fixture(autouse=True)
def nothing_said_yet():
    image_depth._first_image.cache_clear()


def picture(bits=11, shape=(8, 16, 3)):
    """Random values that use the given number of bits, the highest one among them."""
    values = np.random.default_rng(bits).integers(0, 2**bits, shape, dtype=np.uint16)
    values.flat[0] = 2**bits - 1
    return values


def write_png(path, values, interlaced=False):
    """A PNG of uint16 [height, width, bands], each row unfiltered."""
    height, width, bands = values.shape
    rows = values.astype(">u2").reshape(height, -1)
    data = b"".join(b"\0" + row.tobytes() for row in rows)

    def chunk(kind, body):
        body = kind + body
        return struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))

    colour = {1: 0, 3: 2, 2: 4, 4: 6}[bands]
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 16, colour, 0, 0, 0))
        + chunk(b"IDAT", zlib.compress(data))
        + chunk(b"IEND", b"")
    )
    return path


def write_tiff(path, values, order="<", deflated=False, planar=False, extra=2, orientation=1):
    """A TIFF of uint16 [height, width, bands]; a fourth band is alpha (2), premultiplied (1)..."""
    height, width, bands = values.shape
    strips = [values[..., band] for band in range(bands)] if planar else [values]
    strips = [strip.astype(f"{order}u2").tobytes() for strip in strips]
    if deflated:
        strips = [zlib.compress(strip) for strip in strips]
    offsets = np.cumsum([8, *map(len, strips)])
    tags = [
        (256, "H", [width]),
        (257, "H", [height]),
        (258, "H", [16] * bands),
        (259, "H", [8 if deflated else 1]),
        (262, "H", [1 if bands < 3 else 2]),
        (273, "I", offsets[:-1].tolist()),
        (274, "H", [orientation]),
        (277, "H", [bands]),
        (278, "H", [height]),
        (279, "I", [len(strip) for strip in strips]),
        (284, "H", [2 if planar else 1]),
        *([(338, "H", [extra])] if bands in (2, 4) else []),
    ]
    start = int(offsets[-1]) + 2 + 12 * len(tags) + 4
    entries, outside = b"", b""
    for tag, form, numbers in tags:
        content = struct.pack(f"{order}{len(numbers)}{form}", *numbers)
        if len(content) > 4:
            content, outside = struct.pack(f"{order}I", start + len(outside)), outside + content
        kind = {"H": 3, "I": 4}[form]
        entries += struct.pack(f"{order}HHI", tag, kind, len(numbers)) + content.ljust(4, b"\0")
    path.write_bytes(
        (b"II" if order == "<" else b"MM")
        + struct.pack(f"{order}HI", 42, int(offsets[-1]))
        + b"".join(strips)
        + struct.pack(f"{order}H", len(tags))
        + entries
        + struct.pack(f"{order}I", 0)
        + outside
    )
    return path


def with_alpha(values, alpha=65535):
    return np.dstack([values, np.full(values.shape[:2], alpha, np.uint16)])


FILES = {
    "png": lambda path, values: write_png(path, values),
    "png alpha": lambda path, values: write_png(path, with_alpha(values)),
    "png no alpha": lambda path, values: write_png(path, with_alpha(values, 300)),
    "tiff": lambda path, values: write_tiff(path, values),
    "tiff big-endian": lambda path, values: write_tiff(path, values, ">"),
    "tiff deflated": lambda path, values: write_tiff(path, values, deflated=True),
    "tiff deflated big-endian": lambda path, values: write_tiff(path, values, ">", deflated=True),
    "tiff alpha": lambda path, values: write_tiff(path, with_alpha(values), ">"),
    "tiff premultiplied": lambda path, values: write_tiff(path, with_alpha(values), extra=1),
    "tiff infrared": lambda path, values: write_tiff(path, with_alpha(values, 77), extra=0),
}
GREY_FILES = {
    "png": lambda path, values: write_png(path, values),
    "png alpha": lambda path, values: write_png(path, with_alpha(values)),
    "tiff": lambda path, values: write_tiff(path, values),
    "tiff big-endian": lambda path, values: write_tiff(path, values, ">"),
    "tiff deflated": lambda path, values: write_tiff(path, values, deflated=True),
}
SOURCES = {
    "path": lambda path: path,
    "opened": Image.open,
    "decoded": lambda path: (image := Image.open(path), image.load())[0],
}


def suffixed(folder, kind):
    return folder / f"image.{kind[:4].strip().replace('tiff', 'tif')}"


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("kind", FILES)
def test_colours_keep_their_eight_highest_bits(tmp_path, kind, source):
    values = picture(11)
    path = FILES[kind](suffixed(tmp_path, kind), values)
    assert np.array_equal(read_image(SOURCES[source](path)), values >> 3)


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("kind", GREY_FILES)
def test_grey_keeps_its_eight_highest_bits(tmp_path, kind, source):
    values = picture(12, (8, 16, 1))
    path = GREY_FILES[kind](suffixed(tmp_path, kind), values)
    assert np.array_equal(read_image(SOURCES[source](path)), np.repeat(values >> 4, 3, axis=2))


@pytest.mark.parametrize("bits", [8, 9, 11, 12, 14, 16])
def test_the_bits_that_are_used_count(tmp_path, bits):
    values = picture(bits)
    assert np.array_equal(read_image(write_png(tmp_path / "a.png", values)), values >> (bits - 8))
    assert np.array_equal(read_image(values), values >> (bits - 8))


@pytest.mark.parametrize("kind", [">u2", "<u2"])
def test_arrays_of_either_byte_order(kind):
    values = picture(11)
    assert np.array_equal(read_image(values.astype(kind)), values >> 3)
    assert np.array_equal(read_image(with_alpha(values).astype(kind)), values >> 3)
    grey = np.repeat(values[..., :1] >> 3, 3, axis=2)
    assert np.array_equal(read_image(values[..., 0].astype(kind)), grey)
    assert np.array_equal(read_image(values[..., :1].astype(kind)), grey)


def test_pixels_without_data_do_not_darken_the_rest():
    values = picture(11)
    values[:4] = 65535
    shown = np.asarray(read_image(values))
    assert np.array_equal(shown[4:], values[4:] >> 3)
    assert (shown[:4] == 255).all()


def test_a_few_bright_pixels_do_not_darken_the_rest():
    values = picture(9, (64, 64, 3))
    values[0, 0] = 60000
    shown = np.asarray(read_image(values), dtype=float)
    low, high = np.percentile(values, (2, 98))
    expected = np.clip((values - low) / (high - low), 0, 1) * 255
    assert np.abs(shown - expected).max() <= 0.5


def test_a_decoded_image_that_was_changed_is_not_read_from_its_file(tmp_path, caplog):
    """Its low bytes are gone, which shows, and is said."""
    image = Image.open(write_png(tmp_path / "image.png", picture(11)))
    image.paste((1, 2, 3), (0, 0, 4, 4))
    shown = np.asarray(read_image(image))
    assert (shown[:4, :4] == [1, 2, 3]).all()
    assert "nearly black" in caplog.text


@pytest.mark.parametrize("side", [lambda a: a, Image.fromarray], ids=["array", "PIL"])
def test_high_bytes_alone_are_warned_about(caplog, side):
    high = (picture(12) >> 8).astype(np.uint8)
    read_image(side(high))
    assert "no value exceeds 15 of 255" in caplog.text
    caplog.clear()
    read_image(side((picture(12) >> 4).astype(np.uint8)))
    read_image(side(np.zeros((4, 4, 3), np.uint8)))
    assert not caplog.messages


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("deflated", [False, True])
@pytest.mark.parametrize("source", SOURCES)
def test_bands_one_after_another_are_refused(tmp_path, order, deflated, source):
    """Pillow decodes them to noise."""
    path = write_tiff(tmp_path / "planar.tif", picture(), order, deflated, planar=True)
    with pytest.raises(ImageError, match=r"is stored band by band, .*INTERLEAVE=PIXEL"):
        read_image(SOURCES[source](path))


@pytest.mark.parametrize("bands", [1, 3])
def test_sixteen_bits_are_turned_upright_too(tmp_path, bands):
    values = picture(11, (8, 16, bands))
    path = write_tiff(tmp_path / "turned.tif", values, orientation=6)
    turned = np.rot90(values, -1)
    assert np.array_equal(read_image(path), np.broadcast_to(turned >> 3, (16, 8, 3)))


def test_scaling_is_said_once(tmp_path, caplog):
    caplog.set_level(logging.WARNING)
    for number in range(3):
        read_image(write_png(tmp_path / f"{number}.png", picture(11)))
    assert len(caplog.messages) == 1
    assert "0.png: has 16 bits a channel; scaled to 8 bits as values of 11 bits" in caplog.text


def test_a_real_orthophoto_s_depth():
    if not AWKWARD.is_dir():
        pytest.skip("the awkward inputs are not here")
    deep = read_aerial(AWKWARD / "tile_rgb16_11bit.png")
    shallow = read_aerial(AWKWARD / "tile_127.png")
    assert np.array_equal(deep.resize(shallow.size), shallow)
