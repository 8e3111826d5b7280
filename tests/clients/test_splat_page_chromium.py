"""The page of `gf-usd report --splats` in a browser: what it draws, and that it fetches nothing.

Skipped only where no Chromium is installed; CI installs it.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from played_splats import Splats, shell

from gf_usd.core.radiance import basis
from gf_usd.view.report.splats import Limits, build_splat_page

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        CHROMIUM is None, reason="no Chromium is installed: apt-get install chromium"
    ),
]
UPS = [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
# draws now, and reads the color (premultiplied by its alpha) at a place of the page's frame
PIXEL = """([place]) => {
  const v = player.viewer;
  v.drawNow();
  const [gl, o] = [v.gl, v.orbit];
  const m = o.matrix(v.canvas.width / v.canvas.height);
  const q = [0, 1, 2, 3].map((r) =>
    m[r] * place[0] + m[4 + r] * place[1] + m[8 + r] * place[2] + m[12 + r]);
  const out = new Uint8Array(4);
  gl.readPixels(Math.floor((0.5 + 0.5 * q[0] / q[3]) * v.canvas.width),
    Math.floor((0.5 + 0.5 * q[1] / q[3]) * v.canvas.height), 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, out);
  return Array.from(out);
}"""


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    flags = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    if os.name == "posix" and os.geteuid() == 0:
        flags.append("--no-sandbox")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=flags)
        yield browser
        browser.close()


class Page:
    """A page of splats with its messages and requests."""

    def __init__(self, chromium: Any, folder: Path, *sources: Splats) -> None:
        self.sources = sources
        file = folder / "page.html"
        file.write_text(build_splat_page(sources, Limits()), encoding="utf-8")
        self.uri = file.as_uri()
        self.page = chromium.new_page(viewport={"width": 800, "height": 600})
        self.page.set_default_timeout(180_000)
        self.messages: list[str] = []
        self.requests: list[str] = []
        self.page.on("console", lambda message: self.messages.append(message.text))
        self.page.on("pageerror", lambda error: self.messages.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(f"{self.uri}#paused")
        self.page.evaluate("report.ready.then((player) => { window.player = player; })")

    def close(self) -> None:
        """Whatever a test did: nothing was fetched, and nothing went wrong."""
        assert [url for url in self.requests if url.split("#")[0] != self.uri] == []
        assert self.messages == []
        self.page.close()

    def stand(self, place: np.ndarray) -> list[float]:
        """A place [m] of the world in the page's frame."""
        return self.page.evaluate("([p]) => player.viewer.stand(p)", [place.tolist()])

    def pixel(self, place: np.ndarray) -> np.ndarray:
        """Color and alpha in 0..1 where a place of the world is drawn."""
        return np.array(self.page.evaluate(PIXEL, [self.stand(place)])) / 255.0

    def look(self, azimuth: float, elevation: float = 0.0) -> None:
        self.page.evaluate(
            f"Object.assign(player.viewer.orbit, {{azimuth: {azimuth}, elevation: {elevation}}})"
        )

    def eye(self) -> np.ndarray:
        """In the page's frame."""
        return np.array(self.page.evaluate("player.viewer.orbit.eye"))


def wait_until(page: Any, condition: str) -> None:
    """Wait for a condition of a page that draws.

    Each screenshot makes the browser draw: without a GPU, on busy cores, it had requested no frame
    in two minutes.
    """
    for _ in range(300):
        if page.evaluate(condition):
            return
        page.screenshot()
        page.wait_for_timeout(50)
    raise AssertionError(f"{condition}: {page.evaluate('document.visibilityState')}")


@pytest.fixture
def opened(chromium: Any, tmp_path: Path) -> Iterator[Any]:
    pages: list[Page] = []

    def call(*sources: Splats) -> Page:
        pages.append(Page(chromium, tmp_path, *sources))
        return pages[-1]

    yield call
    for page in pages:
        page.close()


def test_it_plays_scrubs_and_steps(opened) -> None:
    page = opened(shell(200)).page
    assert page.inner_text("#counter") == "1 / 5"
    page.keyboard.press("Space")
    assert page.evaluate("player.playing")
    wait_until(page, "player.frame >= 2")
    page.click("#play")
    stopped = page.evaluate("player.frame")
    page.wait_for_timeout(400)
    assert page.evaluate("player.frame") == stopped
    page.fill("#slider", "2")  # playback wraps around: it may have stopped at any frame
    before = page.evaluate("player.viewer.moving[0]")
    page.fill("#slider", "0")
    assert page.inner_text("#counter") == "1 / 5"
    wait_until(page, f"player.viewer.moving[0] !== {before!r}")
    page.fill("#slider", "3")
    page.keyboard.press("Home")
    assert page.evaluate("player.frame") == 0


def test_the_pointer_turns_the_view(opened) -> None:
    opened_page = opened(shell(200))
    before = opened_page.eye()
    box = opened_page.page.locator("#canvas").bounding_box()
    mouse = opened_page.page.mouse
    mouse.move(box["x"] + 200, box["y"] + 100)
    mouse.down()
    mouse.move(box["x"] + 300, box["y"] + 130)
    mouse.up()
    assert np.linalg.norm(opened_page.eye() - before) > 0.1
    opened_page.page.click("#reset")
    np.testing.assert_allclose(opened_page.eye(), before, atol=1e-6)


def test_the_farthest_are_drawn_first(opened) -> None:
    page = opened(shell(500))
    for azimuth in (0.0, 2.0):
        page.look(azimuth)
        page.page.evaluate("player.viewer.drawNow()")
        sorted_, places = page.page.evaluate(
            "[Array.from(player.viewer.sorted), Array.from(player.viewer.moving)]"
        )
        assert sorted(sorted_) == list(range(500))
        at = np.array(places).reshape(-1, 16)[:500, :3]
        far = np.linalg.norm(at - page.eye(), axis=1)[sorted_]
        assert np.diff(far).max() <= np.ptp(far) / 65535 + 1e-6  # the steps that it counts in


@pytest.mark.parametrize("up", UPS)
def test_what_is_in_front_covers_what_is_behind(opened, up: tuple[float, float, float]) -> None:
    toward = np.array([0.0, 0.0, 1.0]) if up[1] else np.array([0.0, -1.0, 0.0])  # azimuth 0
    page = opened(Splats([toward, -toward], np.full((2, 3), 0.5), [(1, 0, 0), (0, 0, 1)], up=up))
    page.look(0.0)
    assert page.pixel(np.zeros(3)) == pytest.approx((1, 0, 0, 1), abs=0.02)
    page.look(np.pi)
    assert page.pixel(np.zeros(3)) == pytest.approx((0, 0, 1, 1), abs=0.02)


@pytest.mark.parametrize("up", UPS)
@pytest.mark.parametrize("frame", [0, 4])
def test_a_splat_is_the_projected_gaussian(opened, up: tuple, frame: int) -> None:
    """At k standard deviations along an axis across the view its alpha is o exp(-k^2 / 2)."""
    scales = np.array([0.3, 0.2, 0.1]) if up[1] else np.array([0.3, 0.1, 0.2])
    source = Splats(
        [(0, 0, 0), (1, 1, 1), (-1, -1, -1)], [scales, *np.full((2, 3), 0.01)],
        np.full((3, 3), 1.0), opacities=[0.8, 0.5, 0.5], up=up,
    )  # fmt: skip
    page = opened(source)
    page.look(0.0)
    page.page.evaluate(f"player.seek({frame})")
    axes = source.rotation(frame) * scales
    toward = np.array([0.0, 0.0, 1.0]) if up[1] else np.array([0.0, -1.0, 0.0])
    across = [k for k in range(3) if abs(axes[:, k] @ toward) < 1e-9]
    assert len(across) == 2
    # the middle of a pixel is up to 0.7 pixels off, of some twelve in a deviation of 0.1: at a
    # slope of 0.8 exp(-1/2) at most
    near = 0.03
    assert page.pixel(np.zeros(3))[3] == pytest.approx(0.8, abs=near)
    for k in across:
        for deviations in (0.5, 1.0, 2.0):
            alpha = page.pixel(deviations * axes[:, k])[3]
            assert alpha == pytest.approx(0.8 * np.exp(-(deviations**2) / 2), abs=near)


@pytest.mark.parametrize("up", UPS)
def test_light_turns_with_the_body(opened, up: tuple) -> None:
    rng = np.random.default_rng(2)
    light = 0.08 * rng.normal(size=(1, 15, 3))
    source = Splats([(0, 0, 0)], [(0.3, 0.3, 0.3)], [(0.5, 0.45, 0.55)], light=light, up=up)
    source.positions = np.concatenate([source.positions, [(3, 3, 3), (-3, -3, -3)]])
    source.scales = np.concatenate([source.scales, np.full((2, 3), 0.01)])
    source.colors = np.concatenate([source.colors, np.full((2, 3), 0.5)])
    source.opacities, source.light = np.ones(3), np.concatenate([light, np.zeros((2, 15, 3))])
    page = opened(source)
    for frame, azimuth, elevation in ((0, 0.3, 0.2), (4, 0.3, 0.2), (2, 2.5, -0.3)):
        page.page.evaluate(f"player.seek({frame})")
        page.look(azimuth, elevation)
        at = page.page.evaluate("Array.from(player.viewer.moving.slice(0, 3))")
        d = np.array(at) - page.eye()
        d /= np.linalg.norm(d)
        world = d if up[1] else d @ np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
        Y = basis((source.rotation(frame).T @ world)[None])[0, 1:]
        color = source.colors[0] + Y @ light[0]
        # 8 bits of colors, coefficients and orientations
        assert page.pixel(np.zeros(3))[:3] == pytest.approx(np.clip(color, 0, 1), abs=0.02)


@pytest.mark.acceptance
def test_variants_are_switched_between(opened) -> None:
    page = opened(shell(100), Splats([(0, 0, 0), (1, 1, 1)], np.full((2, 3), 0.1),
                                     np.full((2, 3), 0.5), variant="jelly")).page  # fmt: skip
    assert page.evaluate("player.viewer.count") == 100
    page.click("text=jelly")
    for _ in range(400):
        if page.evaluate("player.viewer.count") == 2:
            break
        page.wait_for_timeout(50)
    assert page.evaluate("player.viewer.count") == 2
