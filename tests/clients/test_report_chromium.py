"""The page of `gf-usd report` in a browser: it plays, scrubs, and fetches nothing.

Skipped only where no Chromium is installed; CI installs it.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from recordings import FRAMES, FallingBox, MeltingBox, report_of

from gf_usd.view.report.report import Limits, build_report

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        CHROMIUM is None, reason="no Chromium is installed: apt-get install chromium"
    ),
]
NASTY = "<script>document.title='owned'</script>"


class Browser:
    """A page in Chromium, with its messages and requests."""

    def __init__(self, page: Any, file: Path) -> None:
        self.page, self.messages, self.requests = page, [], []
        page.set_default_timeout(180_000)  # Chromium without a graphics card on a busy machine
        page.on("console", lambda message: self.messages.append(message.text))
        page.on("pageerror", lambda error: self.messages.append(str(error)))
        page.on("request", lambda request: self.requests.append(request.url))
        page.goto(f"{file.as_uri()}#paused")
        page.evaluate("report.ready.then((player) => { window.player = player; })")

    def frame(self) -> int:
        return self.page.evaluate("player.frame")

    def mesh(self) -> list[float]:
        """Places of the mesh's vertices on the graphics card."""
        return self.page.evaluate("Array.from(player.viewer.places)")

    def until(self, condition: str) -> None:
        """Wait, at least 20 s; the page's policy forbids the eval that playwright would wait with.

        Each screenshot makes the browser draw, which it may put off for minutes on busy cores.
        """
        for _ in range(400):
            if self.page.evaluate(condition):
                return
            self.page.screenshot()
            self.page.wait_for_timeout(50)
        raise AssertionError(f"never: {condition}")

    def picture(self) -> bytes:
        self.page.evaluate("new Promise((done) => requestAnimationFrame(() => done()))")
        return self.page.locator("#canvas").screenshot()


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page of two variants whose texts try to be HTML."""
    report = report_of(command=f"gf-usd bake {NASTY}.usda")
    report["bakes"] += report_of(look="jelly")["bakes"]
    report["notes"] = [NASTY, "</script><img src=x onerror=document.title='owned'>"]
    sources = [
        FallingBox(name=NASTY, flows=True),
        FallingBox(name=NASTY, variant="jelly", notes=(NASTY,)),
    ]
    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_text(build_report(sources, report, "", Limits()), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def opened(file: Path) -> Iterator[Browser]:
    """The page, opened once: Chromium takes seconds to draw it without a graphics card."""
    from playwright.sync_api import sync_playwright

    # as root, as in most containers, Chromium refuses its sandbox; without a graphics card it
    # draws WebGL by software only when required
    flags = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    if os.name == "posix" and os.geteuid() == 0:
        flags.append("--no-sandbox")
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=flags)
        yield Browser(chromium.new_page(viewport={"width": 1100, "height": 700}), file)
        chromium.close()


@pytest.fixture
def browser(opened: Browser, file: Path) -> Iterator[Browser]:
    """The page as at its start."""
    page = opened.page
    page.evaluate("player.pause(); player.viewer.orbit.reset()")
    page.evaluate("player.open(0).then(() => player.seek(0))")
    page.click("[data-show=mesh]")
    page.select_option("#mode", "color")
    yield opened
    # whatever a test did: nothing was fetched, and nothing went wrong
    assert [url for url in opened.requests if url.split("#")[0] != file.as_uri()] == []
    assert opened.messages == []
    assert page.title() == f"{NASTY}: rubber and jelly"


def test_it_plays_and_pauses(browser: Browser) -> None:
    page = browser.page
    assert page.inner_text("#counter") == f"1 / {FRAMES}"
    page.keyboard.press("Space")
    browser.until("player.frame >= 2")
    assert page.inner_text("#counter") != f"1 / {FRAMES}"
    page.click("#play")
    stopped = browser.frame()
    page.wait_for_timeout(400)
    assert browser.frame() == stopped
    # after the last frame it starts again
    page.evaluate(f"player.seek({FRAMES - 1})")
    page.click("#play")
    browser.until(f"player.frame < {FRAMES - 1}")


def test_the_slider_moves_the_mesh_and_the_picture(browser: Browser) -> None:
    first, drawn = browser.mesh(), browser.picture()
    browser.page.fill("#slider", "3")
    moved = browser.mesh()
    assert browser.frame() == 3
    # lengths of the page are in parts of the motion's diagonal; the box fell 0.5 m of it
    height = [max(places[1::3]) - min(places[1::3]) for places in (first, moved)]
    assert min(moved[1::3]) < min(first[1::3]) - 0.3
    assert height[1] / height[0] == pytest.approx(0.5, abs=1e-3)  # codes of 16 bits
    assert browser.picture() != drawn


def test_keys_step_and_jump(browser: Browser) -> None:
    for key, frame in (("ArrowRight", 1), ("ArrowRight", 2), ("ArrowLeft", 1), ("End", FRAMES - 1)):
        browser.page.keyboard.press(key)
        assert browser.frame() == frame


def test_mesh_gaussians_and_both_are_three_pictures(browser: Browser) -> None:
    page = browser.page
    pictures = []
    for show in ("mesh", "gaussians", "both"):
        page.click(f"[data-show={show}]")
        pictures.append(browser.picture())
    assert len(set(pictures)) == 3
    page.click("[data-show=mesh]")
    assert browser.picture() == pictures[0]


def test_strain_has_colors_and_a_legend(browser: Browser) -> None:
    page = browser.page
    page.fill("#slider", "3")
    plain = browser.picture()
    assert not page.is_visible("#legend")
    page.select_option("#mode", "strain")
    assert page.is_visible("#legend")
    assert "stretch" in page.inner_text("#legend")
    assert browser.picture() != plain
    reaches = page.evaluate("['stretch', 'ratio'].map(n => player.variant.arrays[n].reach)")
    for show, reach in (("mesh", reaches[0]), ("gaussians", reaches[1]), ("both", max(reaches))):
        page.click(f"[data-show={show}]")
        assert page.inner_text("#legend-high") == f"≥ {2**reach:.2g}"


def test_elastic_and_plastic_strain_are_colors_of_the_gaussians(browser: Browser) -> None:
    page = browser.page
    page.fill("#slider", "3")  # where the box is squashed
    page.click("[data-show=gaussians]")
    pictures = [browser.picture()]
    for mode in ("elastic", "plastic"):
        assert not page.evaluate(f"document.querySelector('#mode [value={mode}]').hidden")
        page.select_option("#mode", mode)
        assert f"{mode} strain of the Gaussians" in page.inner_text("#legend")
        pictures.append(browser.picture())
    assert len(set(pictures)) == 3
    # Of a bake that wrote none there is nothing to choose, and what was chosen goes back.
    page.click("text=jelly")
    browser.until("player.number === 1")
    assert page.evaluate("document.querySelector('#mode [value=plastic]').hidden")
    assert page.input_value("#mode") == "color"


def test_a_picture_and_a_plot_jump_to_their_frame(browser: Browser) -> None:
    page = browser.page
    page.click("[data-variant='0'] [data-frame='3']")
    assert browser.frame() == 3
    cursor = page.evaluate("document.querySelector('.plot .js-plotly-plot').layout.shapes[0].x0")
    assert cursor == pytest.approx(3 / 24, rel=1e-5)
    assert page.locator(".plot").count() == 5


def test_another_variant_keeps_the_camera_and_the_frame(browser: Browser) -> None:
    page = browser.page
    page.fill("#slider", "4")
    box = page.locator("#canvas").bounding_box()
    page.mouse.move(box["x"] + 200, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 300, box["y"] + 120)
    page.mouse.up()
    before = page.evaluate("[player.viewer.orbit.azimuth, player.viewer.orbit.elevation]")
    assert before[0] != pytest.approx(page.evaluate("player.viewer.orbit.home.azimuth"))
    page.click("text=jelly")
    browser.until("player.number === 1")
    assert browser.frame() == 4
    assert page.evaluate("[player.viewer.orbit.azimuth, player.viewer.orbit.elevation]") == before
    assert page.locator("[data-variant='1']").first.is_visible()
    assert not page.locator("[data-variant='0']").first.is_visible()


@pytest.mark.slow
@pytest.mark.acceptance
def test_a_surface_whose_faces_change_plays(opened: Browser, tmp_path: Path) -> None:
    file = tmp_path / "flow.html"
    file.write_text(build_report([MeltingBox()], report_of(), "", Limits()), encoding="utf-8")
    page = opened.page.context.browser.new_page(viewport={"width": 700, "height": 500})
    browser = Browser(page, file)
    drawn = []
    for frame, triangles in ((0, 11), (3, 12)):
        page.evaluate(f"player.seek({frame})")
        assert page.evaluate("player.viewer.flowCorners") == 3 * triangles
        drawn.append(browser.picture())
    assert drawn[0] != drawn[1]
    page.click("[data-show=gaussians]")
    assert browser.picture() != drawn[1]
    assert browser.messages == []
    page.close()
