"""Pictures of estimates."""

import io

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text
from PIL import Image
from PIL.ImageColor import getrgb
from slicematch.evaluation.drawing import _ESTIMATE, draw_estimate
from slicematch.localization.estimate import Estimate
from slicematch.localization.modes import Mode

from slicemask import Frustum, PoseGrid


def picture(pose):
    grey = np.full((64, 64, 3), 128, dtype=np.uint8)
    figure = draw_estimate(grey, np.zeros((5, 5)), PoseGrid(5, 5, 4), pose, Frustum(360, 4))
    file = io.BytesIO()
    figure.savefig(file, format="png")
    return np.asarray(Image.open(file).convert("RGB")).astype(int)


def pixels_of_the_camera(pose):
    return int((np.abs(picture(pose) - getrgb(_ESTIMATE)).max(axis=2) < 8).sum())


@pytest.mark.parametrize("pose", [(0.97, 0.5, 90.0), (0.5, 0.03, 0.0), (0.02, 0.98, 225.0)])
def test_a_camera_that_looks_out_of_the_tile_has_its_arrow(pose):
    u, v, heading_deg = pose
    out, into = pixels_of_the_camera(pose), pixels_of_the_camera((u, v, heading_deg + 180.0))
    assert 0.55 * into < out < into


GRID = PoseGrid(5, 5, 4)
POSE = (0.3, 0.3, 90.0)


def some_estimate(pose=POSE, others=((0.7, 0.7, 180.0, 0.2), (0.1, 0.9, 0.0, 0.001))):
    scores = np.zeros(GRID.shape, np.float32)
    scores[1, 1, 1] = 0.8
    modes = [Mode(np.array(pose), 0.8, 0.7)]
    modes += [Mode(np.array(other[:3]), 0.1, other[3]) for other in others]
    return Estimate(tuple(modes), scores, GRID, 640, 0.2)


def drawn(pose=POSE, frustum=None, ground=(32, 64), **options):
    photograph = np.full((64, 64, 3), (40, 90, 160), np.uint8)
    return draw_estimate(
        photograph, some_estimate(pose).heat_map, GRID, pose, frustum or Frustum(360, 4),
        ground=np.zeros((*ground, 3), np.uint8), **options,
    )  # fmt: skip


def texts(figure):
    figure.canvas.draw()
    return [text.get_text() for text in figure.findobj(Text) if text.get_text()]


def test_the_photograph_is_seen_under_the_heat_map():
    figure = drawn(frustum=Frustum(360, 1))
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    axes = figure.axes[0]
    pixels = np.asarray(canvas.buffer_rgba())[..., :3].astype(int)

    def at(u, v):
        x, y = axes.transData.transform((u, v))
        return pixels[round(len(pixels) - y), round(x)]

    assert np.abs(at(0.9, 0.3) - (40, 90, 160)).max() <= 2  # a low score hides nothing
    assert np.abs(at(0.23, 0.37) - (40, 90, 160)).max() > 60  # a high one is plain to see


@pytest.mark.parametrize("ground", [(32, 64), (10, 60), (3, 4)])
def test_the_ground_image_is_as_wide_as_the_tile(ground):
    figure = drawn(ground=ground)
    tile, below = figure.axes[0], figure.axes[-1]
    figure.canvas.draw()
    boxes = [axes.get_window_extent() for axes in (tile, below)]
    assert boxes[0].x0 == pytest.approx(boxes[1].x0)
    assert boxes[0].x1 == pytest.approx(boxes[1].x1, abs=0.5)
    assert boxes[0].width == pytest.approx(boxes[0].height)
    assert boxes[1].y1 < boxes[0].y0


def test_an_estimate_brings_its_figures_and_modes():
    figure = drawn(estimate=some_estimate(), tile_metres=72.0, title="one\ntwo")
    said = texts(figure)
    assert "score 0.800, probability 70.0%" in " ".join(said)
    assert {"one", "two", "N", "10 m", "20%", "estimate", "other modes", "95% ellipse"} <= {*said}
    assert "0%" not in said  # what is next to impossible is not drawn
    plain = texts(drawn(north_up=False))
    assert not {"N", "10 m", "other modes", "95% ellipse"} & {*plain}


@pytest.mark.parametrize(
    ("metres", "said"), [(72.5, "10 m"), (101.6, "10 m"), (130.0, "20 m"), (3.1, "0.5 m")]
)
def test_the_scale_bar_is_of_a_round_length(metres, said):
    figure = drawn(tile_metres=metres)
    assert said in texts(figure)
    bars = [line.get_xdata() for line in figure.axes[0].lines if max(line.get_ydata()) > 1]
    ((left, right),) = bars
    assert (right - left) * metres == pytest.approx(float(said.split()[0]))


def test_a_single_slice_all_around_has_no_edge():
    def edges(frustum, pose=POSE):
        lines = drawn(pose, frustum).axes[0].lines
        return [line for line in lines if line.get_color() == "white"]

    assert edges(Frustum(360, 1)) == []
    assert len(edges(Frustum(90, 1))) == 2
    assert len(edges(Frustum(360, 4))) == 5
    # At the tile's edge, those that leave it at once are not drawn.
    assert len(edges(Frustum(360, 4), (1.0, 0.5, 90.0))) < 5


@pytest.mark.parametrize("title", ["W" * 300, "word " * 60, "cost $5 and $x_1^2 \\frac", ""])
def test_titles_of_any_kind_stay_in_the_picture(title):
    figure = drawn(title=title)
    figure.canvas.draw()
    width, height = figure.canvas.get_width_height()
    for text in figure.texts:
        box = text.get_window_extent()
        assert 0 <= box.x0 < box.x1 <= width
        assert 0 < box.y1 <= height
    assert "".join(text.get_text() for text in figure.texts).replace(" ", "") == title.replace(
        " ", ""
    )
