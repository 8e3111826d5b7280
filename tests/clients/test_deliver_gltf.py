"""Khronos' validator and three.js judge and play the glTF files that are delivered."""

from __future__ import annotations

import functools
import json
import os
import shutil
import threading
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from client_assets import Baked, time_codes, world_points
from client_runs import INTO, PROBES, needs, run
from PIL import Image

from gf_usd.core.neighbors import kd_tree
from gf_usd.delivery.deliver import deliver

pytestmark = [pytest.mark.clients, needs("gltf")]

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
MODULES = INTO / "gltf" / "node_modules"
ERROR = 0.02
NEAR = 1e-6  # of the size of the scene: single precision


@pytest.mark.parametrize("kind", ["joints", "shapes"])
@pytest.mark.parametrize("asset", ["duck", "blocks", "obj"])
def test_the_validator_finds_nothing(
    asset: str, kind: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    baked: Baked = request.getfixturevalue(asset)
    done = deliver(baked.root, tmp_path / "out.glb", error=ERROR, kind=kind)
    assert validated(done.path)["messages"] == []


def test_the_validator_sees_a_damaged_file(duck: Baked, tmp_path: Path) -> None:
    done = deliver(duck.root, tmp_path / "out.glb", error=0.1)
    data = done.path.read_bytes()
    done.path.write_bytes(data.replace(b'"count":', b'"count":1', 1))
    assert validated(done.path)["numErrors"] > 0


def validated(path: Path) -> dict:
    """The issues that the validator reports."""
    return json.loads(run(["node", PROBES / "gltf_validate.js", MODULES, path]))


class Served(SimpleHTTPRequestHandler):
    """The page, three.js and one file."""

    def translate_path(self, path: str) -> str:
        if path.startswith("/three/"):
            return str(MODULES / path.lstrip("/"))
        if path == "/file.glb":
            return str(Path(self.directory) / "out.glb")
        return str(PROBES / "three_gltf.html")

    def log_message(self, *args: object) -> None:
        pass


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    """Of a server on this machine that serves a folder's out.glb."""
    with ThreadingHTTPServer(
        ("127.0.0.1", 0), functools.partial(Served, directory=str(tmp_path))
    ) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()
        thread.join()


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed: apt-get install chromium")
@pytest.mark.parametrize("kind", ["joints", "shapes"])
def test_three_js_plays_it_within_the_error(
    duck: Baked, kind: str, address: str, tmp_path: Path
) -> None:
    from playwright.sync_api import sync_playwright

    done = deliver(duck.root, tmp_path / "out.glb", error=ERROR, kind=kind)
    flags = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    if os.name == "posix" and os.geteuid() == 0:
        flags.append("--no-sandbox")
    codes = time_codes(duck.root)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=flags)
        page = browser.new_page(viewport={"width": 480, "height": 360})
        page.goto(address)
        page.wait_for_function("window.ready", timeout=60_000)
        theirs = np.array([page.evaluate(f"at({frame / 24})") for frame in range(len(codes))])
        # an animation that has ended is played again: the picture is of the last frame, not of rest
        again = np.array(page.evaluate(f"at({(len(codes) - 1) / 24})"))
        np.testing.assert_array_equal(again, theirs[-1])
        page.evaluate(f"draw({(len(codes) - 1) / 24})")
        page.screenshot(path=tmp_path / "drawn.png")
        browser.close()
    (world,) = world_points(duck.root).values()  # Z up
    ours = np.stack([world[..., 0], world[..., 2], -world[..., 1]], axis=-1)
    _, at = kd_tree(ours[0]).query(theirs[0])
    off = np.linalg.norm(theirs - ours[:, at], axis=2).max()
    radius = done.bodies[0].radius
    assert off <= done.error * radius + NEAR * float(np.abs(ours).max())
    with Image.open(tmp_path / "drawn.png") as picture:
        pixels = np.asarray(picture.convert("RGB"), float)
    # the duck is yellow before gray
    yellow = (pixels[..., 0] > 120) & (pixels[..., 2] < 0.6 * pixels[..., 0])
    assert 0.05 < yellow.mean() < 0.8
