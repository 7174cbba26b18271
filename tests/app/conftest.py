"""A served page, and a browser to look at it: Debian's Chromium, driven by Playwright."""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("panel")

ROOT = Path(__file__).parents[2]
# Kept for people to look at; git ignores it.
SCREENSHOTS = ROOT / "build" / "screenshots"
RUN = ROOT / "tests" / "slicematch" / "runs" / "data" / "vigor_run_v1"
CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
WAIT_MS = 60_000


def start(*arguments, env=None):
    """Serve a page by the command; its process, its address, and what it has said so far."""
    paths = os.pathsep.join([str(ROOT), str(ROOT / "model")])
    process = subprocess.Popen(
        [sys.executable, "-m", "slicemask", "app", *arguments, "--no-browser", "--port", "0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "PYTHONPATH": paths, "PYTHONUNBUFFERED": "1", **(env or {})},
    )
    said = ""
    while not (found := re.search(r"http://\S+", said)):
        line = process.stdout.readline()
        assert line, f"the command ended: {said}"
        said += line
    return process, found[0]


@pytest.fixture(scope="session")
def serve():
    """The function that serves a page by the command, until the tests have ended."""
    running = []

    def serve(*arguments, env=None):
        process, url = start(*arguments, env=env)
        running.append(process)
        return url

    yield serve
    for process in running:
        process.terminate()
        said = process.communicate(timeout=30)[0]
        # Tornado complains of browsers that close in the middle of an answer.
        assert not re.search(r'File ".*/(slicemask|slicematch)/', said), said


@pytest.fixture(scope="session")
def finder(serve, tree_writers, tmp_path_factory):
    """The address of the page with a tiny run, whose answers are as good as any to look at."""
    pytest.importorskip("torch")
    tree = tmp_path_factory.mktemp("data") / "vigor"
    tree_writers.write_vigor_tree(
        tree, 3, cities=("NewYork",), panorama_size=(128, 256), tile_pixels=160
    )
    cache = {"SLICEMASK_CACHE": str(tmp_path_factory.mktemp("banks"))}
    return serve(str(RUN), "--data", str(tree), env=cache)


@pytest.fixture(scope="session")
def tree_writers():
    """The functions that write small data trees and maps, of the tests of the model."""
    pytest.importorskip("torch")
    path = ROOT / "tests" / "slicematch" / "conftest.py"
    spec = importlib.util.spec_from_file_location("small_data_trees", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where its dataclasses look
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def explorer(serve):
    """The address of the page without a run."""
    return serve()


@pytest.fixture(scope="session")
def chromium():
    """The browser."""
    api = pytest.importorskip("playwright.sync_api")
    if CHROMIUM is None:
        pytest.skip("the page needs Chromium to be looked at: apt-get install chromium")
    with api.sync_playwright() as playwright:
        # Pages of the tests come from this computer; containers run them as root.
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


class Looker:
    """A page in the browser, and what a user does on it."""

    def __init__(self, browser, url, **options):
        self.context = browser.new_context(**{"viewport": {"width": 1280, "height": 900}} | options)
        self.page = self.context.new_page()
        self.page.set_default_timeout(WAIT_MS)
        self.faults, self.url = [], url
        self.page.on("console", self._said)
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        self.page.on("request", self._asked)
        self.page.goto(url)
        self.tile = self.page.locator("[data-ready=true]")
        self.tile.wait_for()

    def _said(self, message):
        if message.type in ("error", "warning"):
            self.faults.append(f"{message.type}: {message.text}")

    def _asked(self, request):
        own = (self.url.split("?")[0], self.url.replace("http", "ws"), "data:", "blob:")
        if not request.url.startswith(own):
            self.faults.append(f"asked for {request.url}")

    def at(self, u, v):
        """Where a place of the tile is on the screen."""
        box = self.tile.bounding_box()
        return box["x"] + u * box["width"], box["y"] + v * box["height"]

    def drag(self, *places, steps=4):
        """Press at the first place of the tile, and move over the others."""
        self.tile.scroll_into_view_if_needed()
        self.page.mouse.move(*self.at(*places[0]))
        self.page.mouse.down()
        for place in places[1:]:
            self.page.mouse.move(*self.at(*place), steps=steps)
        self.page.mouse.up()

    def pose(self):
        """The numbers of the pose."""
        return [
            float(self.page.get_by_label(name).input_value())
            for name in ("u (east)", "v (south)", "heading (degrees)")
        ]

    def wait_for_pose(self, *expected, tolerance=0.011):
        """Wait until the numbers of the pose are these; None for any."""

        def close():
            return all(
                want is None or abs(have - want) <= tolerance * (1 if number < 2 else 100)
                for number, (have, want) in enumerate(zip(self.pose(), expected, strict=True))
            )

        self.wait_until(close, lambda: f"the pose is {self.pose()}, not {expected}")
        return self.pose()

    def wait_until(self, holds, otherwise=lambda: "it did not happen"):
        """Wait until something holds."""
        for _ in range(WAIT_MS // 100):
            if holds():
                return
            self.page.wait_for_timeout(100)
        raise AssertionError(otherwise())

    def keep(self, name):
        """Keep a picture of the whole page."""
        SCREENSHOTS.mkdir(parents=True, exist_ok=True)
        self.page.screenshot(path=SCREENSHOTS / f"{name}.png", full_page=True)


@pytest.fixture
def look(chromium):
    """The function that opens a page; at the end, no page may have said anything was wrong."""
    opened = []

    def look(url, **options):
        opened.append(Looker(chromium, url, **options))
        return opened[-1]

    yield look
    faults = [fault for looker in opened for fault in looker.faults]
    for looker in opened:
        looker.context.close()
    assert faults == []
