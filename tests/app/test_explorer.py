"""The page without a run, in a real browser."""

from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from slicemask import open_bank

pytestmark = pytest.mark.slow


def _png(pixels):
    file = BytesIO()
    Image.fromarray(pixels).save(file, "PNG")
    return {"name": "mine.png", "mimeType": "image/png", "buffer": file.getvalue()}


def _tile(colour, shape=(64, 64)):
    return _png(np.full((*shape, 3), colour, dtype=np.uint8))


def _colour(looker, u, v):
    """The colour of a place of the tile on the screen."""
    looker.tile.scroll_into_view_if_needed()
    picture = Image.open(BytesIO(looker.page.screenshot())).convert("RGB")
    return np.array(picture.getpixel(tuple(map(int, looker.at(u, v)))))


def test_the_camera_is_dragged_and_turned_and_its_code_makes_what_is_shown(explorer, look):
    looker = look(explorer)
    looker.drag((0.5, 0.5), (0.4, 0.3), (0.25, 0.5))
    u, v, _ = looker.wait_for_pose(0.25, 0.5, 315)
    # The grip is 0.13 of the tile's side ahead; it is pulled round to the east.
    looker.drag((u - 0.092, v - 0.092), (u, v - 0.2), (u + 0.3, v))
    looker.wait_for_pose(0.25, 0.5, 90)
    assert int(looker.tile.get_attribute("data-answered")) > 5

    pose = looker.pose()
    code = looker.page.locator("pre").first.inner_text()
    names = {}
    exec(code, names)
    assert names["masks"].shape == (16, 32, 32)
    assert f"[[{', '.join(f'{value:.10g}' for value in pose)}]]" in code
    row, column = 5, 20
    looker.page.mouse.move(*looker.at((column + 0.5) / 32, (row + 0.5) / 32))
    looker.page.get_by_text(f"row {row}, column {column}").wait_for()
    shown = looker.page.get_by_text(f"row {row}, column {column}").inner_text()
    n = names["masks"][:, row, column].argmax()
    assert f"slice {n}: {names['masks'][n, row, column]:.4f}" in shown
    looker.keep("explorer")


def test_sliders_change_what_is_seen(explorer, look):
    looker = look(explorer)
    looker.page.get_by_role("button", name="pinhole").click()
    ranges = looker.page.get_by_label("Where bands end")
    ranges.fill("0.1,0.2,0.4")
    ranges.press("Enter")
    code = looker.page.locator("pre").first
    code.filter(has_text='Frustum(90, 16, "pinhole", bands=(0.1, 0.2, 0.4))').wait_for()
    looker.keep("explorer_pinhole")
    ranges.fill("0.4,0.2")
    ranges.press("Enter")
    looker.page.get_by_text("they must be increasing ranges").wait_for()
    ranges.fill("")
    ranges.press("Enter")
    code.filter(has_text='Frustum(90, 16, "pinhole")').wait_for()
    assert looker.page.locator(".fault").count() == 0


def test_a_page_is_used_by_keyboard_alone(explorer, look):
    looker = look(explorer)
    for _ in range(40):
        looker.page.keyboard.press("Tab")
        if looker.tile.evaluate("element => element.matches(':focus')"):
            break
    u, v, heading_deg = looker.pose()
    for key in ("ArrowRight", "ArrowRight", "ArrowUp", "e", "e", "e", "Shift+E"):
        looker.page.keyboard.press(key)
    looker.wait_for_pose(u + 0.02, v - 0.01, heading_deg + 13, tolerance=0.001)
    looker.page.keyboard.press("Tab")
    assert not looker.tile.evaluate("element => element.matches(':focus')")


def test_a_tile_is_uploaded_and_a_wrong_file_is_refused_in_words(explorer, look):
    looker = look(explorer)
    before = _colour(looker, 0.02, 0.98)
    looker.page.locator("input[type=file]").set_input_files(
        {"name": "notes.png", "mimeType": "image/png", "buffer": b"no image at all"}
    )
    alert = looker.page.locator(".fault")
    alert.filter(has_text="notes.png").wait_for()
    assert "/tmp" not in alert.inner_text()
    looker.page.locator("input[type=file]").set_input_files(_tile(9, (64, 32)))
    alert.filter(has_text="must be square").wait_for()
    assert (_colour(looker, 0.02, 0.98) == before).all()
    looker.keep("explorer_wrong_file")
    looker.page.locator("input[type=file]").set_input_files(_tile((0, 0, 0)))
    alert.wait_for(state="detached")
    looker.page.wait_for_timeout(500)
    assert _colour(looker, 0.02, 0.98).sum() < before.sum()


def test_two_sessions_share_nothing(explorer, look):
    one, other = look(explorer), look(explorer)
    other_colour = _colour(other, 0.02, 0.98)
    one.drag((0.5, 0.5), (0.2, 0.2))
    one.page.locator("input[type=file]").set_input_files(_tile((0, 0, 0)))
    one.wait_for_pose(0.2, 0.2, 315)
    other.drag((0.5, 0.5), (0.8, 0.7))
    other.wait_for_pose(0.8, 0.7, 315)
    one.wait_for_pose(0.2, 0.2, 315)
    other.drag((0.5, 0.5), (0.66, 0.64))  # back to where it began
    other.wait_for_pose(0.66, 0.64, 315)
    assert np.abs(_colour(other, 0.02, 0.98) - other_colour).max() <= 8


def test_pictures_and_the_bank_are_given_away(explorer, look, tmp_path):
    looker = look(explorer)
    looker.drag((0.5, 0.5), (0.3, 0.6))
    for label, begins in (("PNG", b"\x89PNG"), ("SVG", b"<?xml")):
        with looker.page.expect_download() as download:
            looker.page.get_by_text(label, exact=True).click()
        assert download.value.path().read_bytes().startswith(begins)
    grid = looker.page.get_by_label("Grid of the bank")
    grid.fill("3x4x16")
    grid.press("Enter")
    looker.page.get_by_text("--grid 3x4x16").wait_for()
    with looker.page.expect_download() as download:
        looker.page.get_by_text("Bank", exact=True).click()
    download.value.save_as(tmp_path / "bank.h5")
    with open_bank(tmp_path / "bank.h5") as bank:
        assert len(bank) == 3 * 4 * 16
    grid.fill("900x900x64")
    grid.press("Enter")
    looker.page.get_by_text("--grid 900x900x64").wait_for()
    looker.page.get_by_text("Bank", exact=True).click()
    looker.page.locator(".fault").filter(has_text="use the command").wait_for()


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("phone", {"viewport": {"width": 390, "height": 844}, "has_touch": True}),
        ("dark", {"color_scheme": "dark"}),
    ],
)
def test_it_fits_a_telephone_and_the_dark(explorer, look, name, options):
    looker = look(explorer, **options)
    width = options.get("viewport", {"width": 1280})["width"]
    assert looker.page.evaluate("document.documentElement.scrollWidth") <= width
    paper = looker.page.evaluate("getComputedStyle(document.body).backgroundColor")
    red = int(paper.split("(")[1].split(",")[0])
    assert red < 60 if name == "dark" else red > 200
    if name == "phone":
        looker.page.touchscreen.tap(*looker.at(0.3, 0.7))
    else:
        looker.drag((0.5, 0.5), (0.3, 0.7))
    looker.wait_for_pose(0.3, 0.7, 315)
    looker.keep(f"explorer_{name}")
