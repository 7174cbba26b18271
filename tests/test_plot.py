"""Pictures: what they show, and that they are written whole or refused in one sentence."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image
from PIL.ImageColor import getrgb

from slicemask import Frustum, SlicemaskError, slice_masks
from slicemask.cli.main import main
from slicemask.errors import ImageError, PlotError, PoseError, SpecError
from slicemask.plot import (
    animate_heading,
    draw_pose,
    draw_slices,
    edge_ends,
    read_aerial,
    save_figure,
    slice_colours,
)
from slicemask.plot.colours import PAPER

QUARTERS = Frustum(hfov_deg=360.0, slices=4)
# North-west, north-east, south-east and south-west quadrants are slices 1, 2, 3 and 0.
CENTRE = (0.5, 0.5, 0.0)


def figure_of(pose, frustum, cells=8, **options):
    return draw_pose(slice_masks([pose], frustum, cells)[0], pose, frustum, **options)


def pixels_on_tile(figure, dpi=100):
    """Colours of the drawn figure at places of the tile: a function of (u, v)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure.set_dpi(dpi)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    picture = np.asarray(canvas.buffer_rgba())[..., :3] / 255.0
    to_pixels = figure.axes[0].transData

    def at(u, v):
        x, y = to_pixels.transform((u, v))
        return picture[picture.shape[0] - 1 - int(y), int(x)]

    return at


@pytest.mark.parametrize("slices", [1, 2, 3, 4, 8, 9, 16, 17, 32, 33, 64])
def test_neighbouring_slices_have_distinct_colours(slices):
    colours = slice_colours(slices)
    assert colours.shape == (slices, 3)
    assert colours.min() >= 0.0
    assert colours.max() <= 1.0
    if slices > 1:
        assert np.linalg.norm(colours - np.roll(colours, 1, axis=0), axis=1).min() > 0.1
        assert len(np.unique(colours.round(4), axis=0)) == slices


@pytest.mark.parametrize(
    ("pose", "azimuths_deg", "ends"),
    [
        (CENTRE, [0, 45, 90, 135, 225], [[0.5, 0], [1, 0], [1, 0.5], [1, 1], [0, 1]]),
        ((0.25, 0.75, 10.0), [45.0, -90.0, 450.0], [[1, 0], [0, 0.75], [1, 0.75]]),
        ((0.0, 0.5, 0.0), [270.0, 0.0, 180.0, 90.0], [[0, 0.5], [0, 0], [0, 1], [1, 0.5]]),
        ((1.0, 1.0, 0.0), [0.0, 90.0, 270.0, 315.0], [[1, 0], [1, 1], [0, 1], [0, 0]]),
    ],
    ids=["centre", "inside", "edge", "corner"],
)
def test_edges_end_on_the_border(pose, azimuths_deg, ends):
    np.testing.assert_array_equal(edge_ends(pose, azimuths_deg), ends)


def test_edges_lie_on_their_azimuths():
    rng = np.random.default_rng(0)
    for u, v in rng.uniform(0.01, 0.99, (50, 2)):
        azimuth_deg = rng.uniform(0.0, 360.0, 20)
        ends = edge_ends((u, v, 0.0), azimuth_deg)
        np.testing.assert_allclose(np.abs(ends - 0.5).max(axis=1), 0.5, rtol=1e-14)
        back_deg = np.degrees(np.arctan2(ends[:, 0] - u, v - ends[:, 1])) % 360.0
        np.testing.assert_allclose(back_deg, azimuth_deg, atol=1e-9)


def test_a_cell_within_a_slice_has_its_colour():
    at = pixels_on_tile(figure_of(CENTRE, QUARTERS))
    colours = slice_colours(4)
    for n, place in {0: (0.2, 0.8), 1: (0.2, 0.2), 2: (0.8, 0.2), 3: (0.8, 0.8)}.items():
        np.testing.assert_allclose(at(*place), colours[n], atol=0.01)


def test_colour_fades_with_the_fraction():
    # One cell, of which the slice covers a quarter.
    frustum = Frustum(hfov_deg=90.0, slices=1)
    at = pixels_on_tile(figure_of((0.5, 0.5, 45.0), frustum, cells=1))
    paper = np.array([0xF1, 0xF3, 0xF5]) / 255.0
    np.testing.assert_allclose(at(0.2, 0.8), 0.75 * paper + 0.25 * slice_colours(1)[0], atol=0.01)


def test_a_shared_cell_mixes_its_slices_colours():
    at = pixels_on_tile(figure_of(CENTRE, QUARTERS, cells=1))
    np.testing.assert_allclose(at(0.2, 0.7), slice_colours(4).mean(axis=0), atol=0.01)


@pytest.mark.parametrize("kind", ["picture", "bytes", "floats"])
def test_the_tile_shows_through(kind):
    tile = np.zeros((40, 40, 3), dtype=np.uint8)
    tile[:, :20] = (200, 40, 40)
    aerial = {"picture": Image.fromarray(tile), "bytes": tile, "floats": tile / 255.0}[kind]
    frustum = Frustum(hfov_deg=90.0, slices=1)  # the north-east quadrant
    at = pixels_on_tile(figure_of((0.5, 0.5, 45.0), frustum, cells=4, aerial=aerial))
    np.testing.assert_allclose(at(0.2, 0.8), np.array([200, 40, 40]) / 255.0, atol=0.01)
    np.testing.assert_allclose(at(0.8, 0.8), 0.0, atol=0.01)
    np.testing.assert_allclose(at(0.8, 0.2), 0.47 * slice_colours(1)[0], atol=0.01)


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif"])
def test_a_tile_is_drawn_the_way_up_that_its_file_says(tmp_path, suffix):
    stored = np.zeros((40, 40, 3), dtype=np.uint8)
    stored[:, :20] = (200, 40, 40)
    exif = Image.Exif()
    exif[0x0112] = 6  # a quarter turn: left becomes up
    path = tmp_path / f"tile{suffix}"
    Image.fromarray(stored).save(path, exif=exif, quality=95)
    frustum = Frustum(hfov_deg=90.0, slices=1)  # the south-east quadrant
    at = pixels_on_tile(figure_of((0.5, 0.5, 135.0), frustum, cells=4, aerial=path))
    np.testing.assert_allclose(at(0.2, 0.2), np.array([200, 40, 40]) / 255.0, atol=0.03)
    np.testing.assert_allclose(at(0.8, 0.2), np.array([200, 40, 40]) / 255.0, atol=0.03)
    np.testing.assert_allclose(at(0.2, 0.8), 0.0, atol=0.03)


@pytest.mark.parametrize("slices", [1, 2, 5, 16, 33, 64])
def test_every_slice_has_a_panel_and_a_number(slices):
    figure = figure_of((0.4, 0.6, 10.0), Frustum(hfov_deg=200.0, slices=slices))
    panels = figure.axes[1 : 1 + slices]
    assert [panel.get_title(loc="left") for panel in panels] == [str(n) for n in range(slices)]
    assert len(figure.axes) == slices + 2  # the tile and the colour bar
    # Nothing is cut off, and no two panels overlap.
    boxes = [axes.get_position() for axes in figure.axes]
    assert all(box.x0 > 0 and box.y0 > 0 and box.x1 < 1 and box.y1 < 1 for box in boxes)
    for first in range(len(boxes)):
        for other in boxes[first + 1 :]:
            box = boxes[first]
            assert (
                box.x1 <= other.x0
                or other.x1 <= box.x0
                or box.y1 <= other.y0
                or (other.y1 <= box.y0)
            )


@pytest.mark.parametrize("slices", [16, 64])
@pytest.mark.parametrize("pose", [(0.5, 0.5, 0.0), (0.9, 0.03, 77.0), (0.0, 1.0, 45.0)])
def test_numbers_around_the_tile_do_not_overlap(slices, pose):
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure = figure_of(pose, Frustum(slices=slices))
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    numbers = [text for text in figure.axes[0].texts if text.get_text().isdigit()]
    assert len(numbers) >= 4
    boxes = [text.get_window_extent() for text in numbers]
    for first in range(len(boxes)):
        assert not any(boxes[first].overlaps(other) for other in boxes[first + 1 :])


def test_the_figure_says_what_it_shows():
    figure = figure_of((0.25, 0.75, 382.5), Frustum(81.5, 4, "pinhole"), title="A $5 title")
    texts = [text.get_text() for text in figure.texts]
    assert texts[0] == "A $5 title"
    for part in ("u = 0.25", "v = 0.75", "heading 22.5°", "81.5°", "pinhole", "N = 4", "8 x 8"):
        assert part in texts[1]
    assert figure.axes[0].get_xlabel() == "u (east)"
    assert figure.axes[0].get_ylabel() == "v (south)"
    bottom, top = figure.axes[0].get_ylim()
    assert bottom > top  # v grows downwards
    assert figure.axes[-1].get_ylabel() == "fraction of the cell covered"


def test_a_slice_that_misses_the_tile_is_called_empty():
    figure = figure_of((0.0, 0.5, 270.0), Frustum(hfov_deg=90.0, slices=2))
    assert [[text.get_text() for text in axes.texts] for axes in figure.axes[1:3]] == [
        ["empty"],
        ["empty"],
    ]
    assert not [text for text in figure.axes[0].texts if text.get_text().isdigit()]


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf", ".PNG"])
def test_figures_are_written_by_suffix(tmp_path, suffix):
    path = tmp_path / f"figure{suffix}"
    heads = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}
    path.write_bytes(b"an older file")
    save_figure(figure_of(CENTRE, QUARTERS), path)
    content = path.read_bytes()
    assert content.startswith(heads[suffix.lower()])
    assert len(content) > 5000
    assert os.listdir(tmp_path) == [path.name]
    save_figure(figure_of(CENTRE, QUARTERS), path)
    assert path.read_bytes() == content


def test_png_reads_back(tmp_path):
    save_figure(figure_of(CENTRE, QUARTERS), tmp_path / "figure.png")
    with Image.open(tmp_path / "figure.png") as picture:
        colours = {colour for _, colour in picture.convert("RGB").getcolors(1 << 24)}
    for colour in np.round(slice_colours(4) * 255).astype(int):
        assert any(np.abs(np.array(other) - colour).max() <= 1 for other in colours)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("figure.bmp", r"suffix is \.bmp; name a file that ends in \.png or \.svg or \.pdf"),
        ("figure", "suffix is missing"),
        ("missing/figure.png", "missing: there is no such folder"),
        ("folder.png", "is a folder"),
        (f"{'long' * 70}.png", "is invalid: File name too long"),
    ],
)
def test_a_target_that_is_invalid_is_refused(tmp_path, name, message):
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(PlotError, match=message):
        save_figure(figure_of(CENTRE, QUARTERS), tmp_path / name)
    assert os.listdir(tmp_path) == ["folder.png"]


def test_a_full_disk_leaves_nothing_behind(tmp_path):
    # /dev/full stands in for a full disk: the link is where the unfinished file would go.
    if not Path("/dev/full").exists():
        pytest.skip("this system has no /dev/full")
    target = tmp_path / "figure.png"
    (tmp_path / f".figure.png.{os.getpid()}.partial").symlink_to("/dev/full")
    with pytest.raises(PlotError, match=r"figure\.png: cannot be written: No space left"):
        save_figure(figure_of(CENTRE, QUARTERS), target)
    assert os.listdir(tmp_path) == []


def test_an_animation_turns_the_camera(tmp_path):
    path = tmp_path / "turn.gif"
    steps = []
    animate_heading(
        (0.5, 0.5, 350.0),
        Frustum(hfov_deg=90.0, slices=4),
        8,
        path,
        frames=6,
        progress=lambda done, total: steps.append((done, total)),
    )
    assert steps == [(done, 6) for done in range(1, 7)]
    assert os.listdir(tmp_path) == ["turn.gif"]
    with Image.open(path) as gif:
        assert gif.n_frames == 6
        assert gif.info["loop"] == 0
        frames = []
        for number in range(6):
            gif.seek(number)
            frames.append(np.asarray(gif.convert("RGB")).astype(int))
    assert len({frame.tobytes() for frame in frames}) == 6
    for frame in frames[1:]:  # the axes below stand still, and the ground stays white
        np.testing.assert_array_equal(frame[-45:], frames[0][-45:])
    assert (frames[0][0, 0] == 255).all()
    # Three quarters of the tile are empty, in the colour that stills have for it; lines cross them.
    empty = (frames[0] == getrgb(PAPER)).all(axis=2)
    assert 0.5 * 370**2 < empty.sum() < 0.75 * 370**2


def test_frames_show_their_own_headings(tmp_path):
    """Each quarter turn moves the one slice by a quadrant."""
    path = tmp_path / "turn.gif"
    animate_heading((0.5, 0.5, 45.0), Frustum(90.0, 1), 8, path, frames=4)
    blue = slice_colours(1)[0] * 255
    quadrants = []
    with Image.open(path) as gif:
        for number in range(4):
            gif.seek(number)
            frame = np.asarray(gif.convert("RGB")).astype(float)
            v, u = np.nonzero(np.abs(frame - blue).max(axis=2) < 12)
            quadrants.append((u.mean() - 235, v.mean() - 260))  # from the middle of the tile
    signs = [(int(np.sign(u)), int(np.sign(v))) for u, v in quadrants]
    assert signs == [(1, -1), (1, 1), (-1, 1), (-1, -1)]


@pytest.mark.slow
def test_an_animation_on_a_busy_tile_stays_small(tmp_path):
    rng = np.random.default_rng(0)
    aerial = rng.integers(0, 255, (256, 256, 3)).astype(np.uint8)
    path = tmp_path / "turn.gif"
    animate_heading((0.47, 0.56, 0.0), Frustum(), 32, path, aerial=aerial)
    assert path.stat().st_size < 3_000_000


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"path": "turn.png"}, PlotError, r"suffix is \.png; name a file that ends in \.gif"),
        ({"frames": 1}, SpecError, "frames is 1; it must be a whole number from 2 to 360"),
        ({"frames": 2.5}, SpecError, "frames is 2.5"),
        ({"cells": 0}, SpecError, "cells is 0"),
        ({"pose": (1.5, 0.5, 0.0)}, PoseError, "outside the tile"),
        ({"engine": "guess"}, SpecError, "engine is 'guess'"),
    ],
)
def test_an_animation_that_is_invalid_is_refused(tmp_path, change, error, message):
    options = {"pose": CENTRE, "frustum": QUARTERS, "cells": 4, "path": "turn.gif", "frames": 3}
    options |= change
    options["path"] = tmp_path / options["path"]
    with pytest.raises(error, match=message):
        animate_heading(**options)
    assert os.listdir(tmp_path) == []


def test_an_interrupted_animation_leaves_nothing_behind(tmp_path):
    def interrupt(done, total):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        animate_heading(CENTRE, QUARTERS, 4, tmp_path / "turn.gif", frames=4, progress=interrupt)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("mode", ["RGB", "L", "RGBA", "P"])
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_tiles_are_read_as_rgb(tmp_path, mode, suffix):
    Image.new("RGB", (30, 30), (102, 102, 102)).convert(mode).save(tmp_path / f"tile{suffix}")
    tile = read_aerial(tmp_path / f"tile{suffix}")
    assert tile.mode == "RGB"
    assert tile.getpixel((3, 3)) == (102, 102, 102)


def _broken_tiles(folder):
    picture = Image.fromarray(np.arange(30 * 30 * 3, dtype=np.uint8).reshape(30, 30, 3))
    picture.save(folder / "whole.png")
    whole = (folder / "whole.png").read_bytes()
    (folder / "cut.png").write_bytes(whole[: len(whole) // 2])
    (folder / "bent.png").write_bytes(whole[:60] + bytes(40) + whole[100:])
    (folder / "text.png").write_text("no picture")
    (folder / "nothing.png").write_bytes(b"")
    (folder / "folder").mkdir()
    picture.resize((30, 20)).save(folder / "wide.png")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("absent.png", "there is no such image"),
        ("cut.png", "is unreadable as an image"),
        ("bent.png", "is unreadable as an image"),
        ("text.png", "is unreadable as an image"),
        ("nothing.png", "is unreadable as an image"),
        ("folder", "is a folder"),
        ("wide.png", "30x20 pixels; an aerial tile must be square"),
    ],
)
def test_an_invalid_tile_is_refused(tmp_path, name, message):
    _broken_tiles(tmp_path)
    with pytest.raises(ImageError, match=message) as caught:
        read_aerial(tmp_path / name)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, SlicemaskError)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"masks": np.zeros((3, 4, 4))}, SpecError, r"\[3, 4, 4\].*N = 4"),
        ({"masks": np.zeros((4, 4, 5))}, SpecError, r"\[4, 4, 5\]"),
        ({"pose": (0.5, np.nan, 0.0)}, PoseError, "not finite"),
        ({"pose": (0.5, 0.5)}, PoseError, "u, v, heading_deg"),
        ({"aerial": np.zeros((8, 9, 3), np.uint8)}, ImageError, "9x8 pixels"),
        ({"aerial": np.zeros((8, 8, 2), np.uint8)}, ImageError, r"\[8, 8, 2\]"),
    ],
)
def test_a_drawing_that_is_invalid_is_refused(change, error, message):
    options = {"masks": np.zeros((4, 4, 4)), "pose": CENTRE, "frustum": QUARTERS} | change
    with pytest.raises(error, match=message):
        draw_pose(**options)


def test_slices_are_drawn_on_axes_of_ones_own():
    from matplotlib.figure import Figure

    axes = Figure().add_subplot()
    draw_slices(axes, slice_masks([CENTRE], QUARTERS, 8)[0], CENTRE, QUARTERS)
    lines = [line.get_xydata() for line in axes.lines]
    corners = {tuple(line[-1]) for line in lines if len(line) == 2}
    assert {(0.5, 1.0), (0.0, 0.5), (0.5, 0.0), (1.0, 0.5)} <= corners


def test_matplotlib_is_loaded_on_use_only():
    code = "import slicemask, slicemask.plot, sys; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("projection", ["equirectangular", "pinhole"])
def test_bands_are_drawn_in_shades_with_their_edges(projection):
    from matplotlib.figure import Figure

    banded = Frustum(80.0, 4, projection, (0.125, 0.25))
    plain = Frustum(80.0, 4, projection)
    axes, plain_axes = Figure().add_subplot(), Figure().add_subplot()
    draw_slices(axes, slice_masks([CENTRE], banded, 8)[0], CENTRE, banded)
    draw_slices(plain_axes, slice_masks([CENTRE], plain, 8)[0], CENTRE, plain)
    cells, plain_cells = (shown.images[-1].get_array() for shown in (axes, plain_axes))
    assert np.allclose(cells[..., 3], plain_cells[..., 3], rtol=0, atol=1e-6)
    # The colours of a cell are weighted by its fractions, with each band lighter than the last.
    masks = slice_masks([CENTRE], banded, 8)[0]
    colours = slice_colours(4)[:, None]
    shades = colours + np.array([[0.0], [0.3], [0.6]]) * (1.0 - colours)
    sums = np.einsum("nbij,nbc->ijc", masks, shades)
    seen = masks.sum(axis=(0, 1)) > 0
    expected = sums[seen] / masks.sum(axis=(0, 1))[seen][:, None]
    assert np.allclose(cells[seen][:, :3], expected, rtol=0, atol=1e-6)

    known = {line.get_xydata().tobytes() for line in plain_axes.lines}
    borders = [line.get_xydata() for line in axes.lines]
    borders = [border - CENTRE[:2] for border in borders if border.tobytes() not in known]
    assert len(borders) == 2
    heading = np.radians(CENTRE[2])
    ahead = np.array([np.sin(heading), -np.cos(heading)])
    for border, band_range in zip(borders, banded.bands, strict=True):
        pinhole = projection == "pinhole"
        reached = border @ ahead if pinhole else np.linalg.norm(border, axis=1)
        assert np.allclose(reached, band_range, rtol=0, atol=1e-12)


def test_the_masks_of_bands_are_a_sheet_of_slices_and_bands():
    banded = Frustum(360.0, 4, bands=(0.1, 0.3))
    masks = slice_masks([CENTRE], banded, 8)[0]
    figure = draw_pose(masks, CENTRE, banded)
    shown = [
        axes for axes in figure.axes[1:] if axes.images and axes.images[0].get_array().ndim == 2
    ]
    sheet = [axes.images[0].get_array() for axes in shown]
    assert np.array_equal(np.array(sheet), masks.reshape(12, 8, 8))
    corners = [axes.get_position().bounds[:2] for axes in shown]
    assert len({round(left, 6) for left, _ in corners}) == 3
    assert len({round(bottom, 6) for _, bottom in corners}) == 4


@pytest.mark.parametrize("shape", [(4, 8, 8), (4, 3, 8, 8), (3, 2, 8, 8), (4, 2, 8, 7)])
def test_masks_that_do_not_fit_the_bands_are_refused(shape):
    banded = Frustum(360.0, 4, bands=(0.1,))
    with pytest.raises(SpecError, match=r"\[N, B, L, L\] with the frustum's N = 4 .* B = 2 bands"):
        draw_pose(np.zeros(shape), CENTRE, banded)


def test_banded_banks_and_poses_are_drawn_by_the_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = CliRunner().invoke
    bank = ["build", "--grid", "2x2x2", "--slices", "4", "--cells", "8", "--bands", "0.1,0.3"]
    assert run(main, [*bank, "--cache", "banks"]).exit_code == 0
    for options in (
        ["--cache", "banks", "--out", "bank.png"],
        ["--at", "0.5,0.5,10", "--bands", "0.1,0.3", "--out", "at.svg"],
        ["--at", "0.5,0.5,10", "--bands", "0.1,0.3", "--slices", "4", "--cells", "8"],
    ):
        done = run(main, ["visualize", *options])
        assert done.exit_code == 0, done.output
    assert {path.name for path in tmp_path.iterdir() if path.is_file()} == {
        "bank.png",
        "at.svg",
        "at_0.5-0.5-10_hfov360_equirectangular_n4_bands0.1-0.3_l8.png",
    }
