"""The page with a run, in a real browser."""

import re
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

pytestmark = pytest.mark.slow
RUN = Path(__file__).parents[1] / "slicematch" / "runs" / "data" / "vigor_run_v1"


def _image(rows, columns, name):
    pixels = np.random.default_rng(0).integers(0, 256, (rows, columns, 3), dtype=np.uint8)
    file = BytesIO()
    Image.fromarray(pixels).save(file, "PNG")
    return {"name": name, "mimeType": "image/png", "buffer": file.getvalue()}


def _score(looker):
    """The candidate's score, and how far it is from the answer's."""
    text = looker.page.get_by_text("Candidate: score").inner_text()
    score, gap = re.search(r"score (-?[\d.]+), ([\d.]+)", text).groups()
    return float(score), float(gap)


def _open_example(look, finder):
    looker = look(finder)
    looker.page.get_by_role("button", name="Example 1").click()
    looker.page.get_by_text("From the truth").wait_for()
    looker.page.get_by_text("Candidate: score").wait_for()
    looker.wait_until(lambda: any(looker.pose()))  # the numbers follow the camera at rest
    return looker


def test_an_example_is_answered_and_a_candidate_is_dragged_off_the_answer(look, finder):
    looker = _open_example(look, finder)
    score, gap = _score(looker)
    assert gap < 5e-4 * max(1.0, abs(score))
    assert looker.page.get_by_role("button", name="Mode 1").count() == 1
    answer = looker.pose()
    looker.drag((0.5, 0.5), (0.9, 0.1))
    looker.wait_for_pose(0.9, 0.1, None)
    moved, gap = _score(looker)
    assert moved != score
    assert gap == pytest.approx(abs(moved - score), abs=2e-4)
    looker.page.get_by_role("button", name="difference to the answer").click()
    looker.keep("finder")
    looker.page.get_by_role("button", name="Mode 1").click()
    looker.wait_for_pose(*answer)


def test_a_prior_is_drawn_and_the_answer_keeps_to_it(look, finder):
    looker = _open_example(look, finder)
    looker.page.get_by_role("button", name="draw a circle").click()
    looker.drag((0.2, 0.2), (0.2, 0.45))
    looker.page.get_by_text("place within 0.250 of u 0.200, v 0.200").wait_for()
    looker.wait_until(lambda: np.hypot(*np.subtract(looker.pose()[:2], 0.2)) <= 0.251)
    u, v, _ = looker.pose()
    looker.page.get_by_role("button", name="draw an arc").click()
    looker.drag((u, v - 0.1), (u + 0.3, v))
    looker.page.get_by_text("heading within").wait_for()
    looker.keep("finder_priors")
    looker.page.get_by_role("button", name="Clear priors").click()
    looker.page.get_by_text("Priors: none").wait_for()


def test_own_images_are_dropped_and_wrong_ones_are_refused(look, finder):
    looker = look(finder, viewport={"width": 390, "height": 844})
    ground, tile = looker.page.locator("input[type=file]").all()
    fault = looker.page.locator(".fault")
    tile.set_input_files(_image(64, 96, "wide.png"))
    fault.filter(has_text="wide.png").wait_for()
    ground.set_input_files(_image(64, 64, "square.png"))
    fault.filter(has_text="square.png").wait_for()
    ground.set_input_files(_image(64, 128, "panorama.png"))
    tile.set_input_files(_image(64, 64, "tile.png"))
    looker.page.get_by_text("Answer:").wait_for()
    looker.page.get_by_text("Candidate: score").wait_for()
    assert looker.page.get_by_text("From the truth").count() == 0
    assert looker.page.evaluate("document.documentElement.scrollWidth") <= 390
    looker.keep("finder_phone")


def test_the_run_that_ships_comes_with_examples(look, serve, tmp_path):
    """They are answered where its own data tree is not."""
    looker = look(serve("generated-city", env={"SLICEMASK_CACHE": str(tmp_path)}))
    assert looker.page.get_by_role("button", name=re.compile("Example")).count() == 3
    looker.page.get_by_role("button", name="Example 3").click()
    text = looker.page.get_by_text("From the truth")
    text.wait_for()
    metres = float(re.search(r"([\d.]+) m", text.inner_text())[1])
    assert metres < 5.0
    looker.wait_until(lambda: any(looker.pose()))
    looker.keep("generated-city")


def test_a_tile_is_cut_from_a_map_around_a_place(look, serve, tmp_path):
    rasterio = pytest.importorskip("rasterio")
    pixels = np.random.default_rng(0).integers(0, 256, (3, 400, 400), dtype=np.uint8)
    profile = {
        "driver": "GTiff", "dtype": "uint8", "count": 3, "width": 400, "height": 400,
        "crs": "EPSG:32631", "transform": rasterio.transform.from_origin(594000, 5762000, 0.5, 0.5),
    }  # fmt: skip
    with rasterio.open(tmp_path / "ortho.tif", "w", **profile) as file:
        file.write(pixels)
    url = serve(
        *(str(RUN), "--map", str(tmp_path / "ortho.tif"), "--tile-side", "70m"),
        env={"SLICEMASK_CACHE": str(tmp_path)},
    )
    looker = look(url)
    looker.page.locator("input[type=file]").first.set_input_files(_image(128, 256, "pano.png"))
    place = looker.page.get_by_label("Place on the map")
    for wrong, sentence in (
        ("here", "'here' is no place; expected latitude and longitude in degrees"),
        ("10.0, 10.0", "the map"),
    ):
        place.fill(wrong)
        place.press("Enter")
        looker.page.get_by_text(sentence).wait_for()
    place.fill(place.get_attribute("placeholder"))
    place.press("Enter")
    answer = looker.page.get_by_text(re.compile(r"; latitude \d"))
    answer.wait_for()
    lat, lon = map(
        float, re.search(r"latitude ([\d.]+), longitude ([\d.]+)", answer.inner_text()).groups()
    )
    assert (lat, lon) == pytest.approx(
        tuple(map(float, place.get_attribute("placeholder").split(","))), abs=0.001
    )
