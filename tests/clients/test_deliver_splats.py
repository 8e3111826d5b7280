"""Khronos' validator and three.js judge and show the Gaussians of delivered glTF files."""

from __future__ import annotations

import functools
import json
import os
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from client_runs import INTO, PROBES, needs, run
from moving_splats import FRAMES, KHR, moving_splats, upright, world_splats
from PIL import Image

from gf_usd.delivery.deliver import deliver

pytestmark = [pytest.mark.clients, needs("gltf")]

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
in_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium is installed: apt-get install chromium"
)
MODULES = INTO / "gltf" / "node_modules"
ERROR = 0.02
WAYS = [("joints", "skin"), ("shapes", "skin"), ("joints", "nodes")]  # kind, binding
NEAR = 1e-5  # [m] of some tenths of a meter: single precision, and rotations of 16 bits


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("source") / "ball.usdc"
    return moving_splats(path, mesh=False, degree=3, count=600)


@pytest.fixture(scope="module")
def over_mesh(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return moving_splats(tmp_path_factory.mktemp("over") / "ball.usdc")


@pytest.mark.parametrize(("kind", "bind"), WAYS)
@pytest.mark.parametrize("name", ["source", "over_mesh"])
def test_the_validator_knows_not_the_extension_and_finds_nothing_else(
    name: str, kind: str, bind: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    path = request.getfixturevalue(name)
    done = deliver(path, tmp_path / "out.glb", error=ERROR, kind=kind, bind_splats=bind)
    # a joint that no Gaussian follows is a remark
    expected = {"UNSUPPORTED_EXTENSION"} | ({"NODE_EMPTY"} if bind == "nodes" else set())
    messages = validated(done.path)["messages"]
    # the release of npm is older than the extension: it has none of its attributes
    assert {row["code"] for row in messages} <= {"MESH_PRIMITIVE_INVALID_ATTRIBUTE", *expected}
    named = {row["pointer"].rpartition("/")[2] for row in messages if row["severity"] == 0}
    assert named
    assert all(one.startswith(f"{KHR}:") for one in named)
    # with the names that an application may choose, the same arrays are attributes without fault
    data = done.path.read_bytes().replace(f"{KHR}:".encode(), b"_HR_gaussian_splatting_")
    done.path.write_bytes(data)
    assert {row["code"] for row in validated(done.path)["messages"]} <= expected


def validated(path: Path) -> dict:
    """The issues that the validator reports."""
    return json.loads(run(["node", PROBES / "gltf_validate.js", MODULES, path]))


class Served(SimpleHTTPRequestHandler):
    """A page, three.js and one file."""

    page = ""

    def translate_path(self, path: str) -> str:
        if path.startswith("/three/"):
            return str(MODULES / path.lstrip("/"))
        if path == "/file.glb":
            return str(Path(self.directory) / "out.glb")
        return str(PROBES / path.lstrip("/"))

    def log_message(self, *args: object) -> None:
        pass


@contextmanager
def shown(page_name: str, folder: Path) -> Iterator[Any]:
    """A page of three.js in Chromium with a folder's out.glb."""
    from playwright.sync_api import sync_playwright

    handler = functools.partial(Served, directory=str(folder))
    flags = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    if os.name == "posix" and os.geteuid() == 0:
        flags.append("--no-sandbox")
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=flags)
            page = browser.new_page(viewport={"width": 480, "height": 360})
            page.goto(f"http://127.0.0.1:{server.server_port}/{page_name}")
            page.wait_for_function("window.ready", timeout=60_000)
            yield page
            browser.close()
        server.shutdown()
        thread.join()


@in_chromium
@pytest.mark.parametrize("kind", ["joints", "shapes"])
def test_without_the_extension_three_js_shows_points(
    source: Path, kind: str, tmp_path: Path
) -> None:
    """Morph targets play; three.js skins no points, which stay at rest."""
    done = deliver(source, tmp_path / "out.glb", error=ERROR, kind=kind)
    with shown("three_gltf.html", tmp_path) as page:
        theirs = np.array([page.evaluate(f"at({frame / 24})") for frame in range(FRAMES)])
    for frame in range(FRAMES):
        code = 1.0 + (frame if kind == "shapes" else 0)
        ours, _ = upright(*world_splats(source, "/Ball/Splats", code))
        off = np.linalg.norm(theirs[frame] - ours, axis=1).max()
        allowed = done.splats[0].position * done.bodies[0].radius if kind == "shapes" else 0.0
        assert off <= allowed + NEAR


@in_chromium
@pytest.mark.parametrize(("kind", "bind"), WAYS)
def test_three_js_draws_the_splats(source: Path, kind: str, bind: str, tmp_path: Path) -> None:
    deliver(source, tmp_path / "out.glb", error=ERROR, kind=kind, bind_splats=bind)
    with shown("three_splats.html", tmp_path) as page:
        first, last = (
            np.array(page.evaluate(f"splats({frame / 24})")).reshape(-1, 4, 4)
            for frame in (0, FRAMES - 1)
        )
        page.evaluate("draw(0)")
        page.wait_for_timeout(500)
        page.evaluate("draw(0)")
        page.screenshot(path=tmp_path / "drawn.png")
    # the rigid motion of the body is that of a node where shapes are delivered, and each joint has
    # one where Gaussians follow nodes
    assert (len(first) > 1) == (bind == "nodes")
    moved = np.abs(first - last).max(axis=(1, 2)) > 1e-3
    assert moved.all() if (kind, bind) != ("joints", "skin") else not moved.any()
    with Image.open(tmp_path / "drawn.png") as picture:
        pixels = np.asarray(picture.convert("RGB"), float)
    # the ball is orange, as bright as its harmonics make it, before gray
    orange = pixels[..., 0] > pixels[..., 2] + 40
    assert 0.03 < orange.mean() < 0.6
