"""The add-on's bakes without Blender: by a server of its own, with the words of gf-usd."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import time
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from small_bakes import BLOCK

ADDON = Path(__file__).resolve().parents[2] / "integrations" / "blender" / "gf_usd_bake"
PROGRAM = [sys.executable, "-m", "gf_usd"]
SMALL = ["--particles", "150", "--overwrite"]


@pytest.fixture(scope="module")
def addon() -> Iterator[Any]:
    """The module `job` of the add-on, whose package loads Blender."""
    package = types.ModuleType("addon_without_blender")
    package.__path__ = [str(ADDON)]
    sys.modules[package.__name__] = package
    job = importlib.import_module(f"{package.__name__}.job")
    if not job.server.AVAILABLE:
        pytest.skip("no Unix sockets here")
    # where it is installed, gf-usd needs no path
    surroundings = job.server.surroundings
    job.server.surroundings = lambda: {**surroundings(), "PYTHONPATH": os.pathsep.join(sys.path)}
    yield job
    job.server.server.stop()
    for name in [name for name in sys.modules if name.startswith(package.__name__)]:
        del sys.modules[name]


@pytest.fixture
def block(tmp_path: Path) -> Path:
    path = tmp_path / "block.usda"
    path.write_text(BLOCK, encoding="utf-8")
    return path


def test_a_program_that_does_not_start_is_said(addon: Any, tmp_path: Path) -> None:
    for program, message in (
        ([str(tmp_path / "nowhere")], "does not run"),
        ([sys.executable, "-c", "raise KeyError('broken')"], "KeyError: 'broken'"),
    ):
        job = addon.Job(program, ["bake", "a.usda"], str(tmp_path))
        job.wait(0.01)
        assert message in job.error.message


@pytest.mark.slow
def test_bakes_of_one_server(addon: Any, block: Path, tmp_path: Path) -> None:
    def bake(*arguments: str) -> Any:
        return addon.Job(PROGRAM, ["bake", "block.usda", *SMALL, *arguments], str(tmp_path))

    first = bake("--frames", "3")
    first.wait(0.01)
    assert first.error is None
    assert (first.done, first.total, first.result["frames"]) == (3, 3, 3)
    wrong = bake("--frames", "3", "--material", "ruber")
    wrong.wait(0.01)
    assert wrong.error.message == "there is no material 'ruber'"
    assert not wrong.failed
    unknown = bake("--nonsense")
    unknown.wait(0.01)
    assert unknown.error.message == "gf-usd bake has no option --nonsense"
    stopped = bake("--frames", "400")
    while not stopped.done:
        assert not stopped.step()
        time.sleep(0.01)
    stopped.cancel()
    stopped.wait(0.01)
    assert stopped.error.message == "canceled"
    assert stopped._process.returncode == 143
    server = addon.server.server._process
    assert server.poll() is None
    again = bake("--frames", "3", "-o", "again.usda")
    again.wait(0.01)
    assert again.error is None
    assert addon.server.server._process is server
    alone = [*PROGRAM, "bake", "block.usda", *SMALL, "--frames", "3", "-o", "again.usda", "-q"]
    served = (tmp_path / "again.cache.usdc").read_bytes()
    subprocess.run(alone, check=True, cwd=tmp_path)
    assert (tmp_path / "again.cache.usdc").read_bytes() == served


@pytest.mark.slow
def test_the_server_ends_with_the_program_that_started_it(tmp_path: Path) -> None:
    code = f"""
import importlib, json, os, sys, types
package = types.ModuleType("addon")
package.__path__ = [{str(ADDON)!r}]
sys.modules["addon"] = package
server = importlib.import_module("addon.server")
server.surroundings = lambda: dict(os.environ)
with server.server.connect({PROGRAM!r}):
    print(json.dumps([server.server._process.pid, server.server._path]), flush=True)
os.kill(os.getpid(), 9)
"""
    done = subprocess.run(
        [sys.executable, "-c", code], check=False, capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )  # fmt: skip
    process, path = json.loads(done.stdout)
    until = time.monotonic() + 30.0
    while Path(path).exists():
        assert time.monotonic() < until, f"{process} still listens"
        time.sleep(0.05)
    Path(path).parent.rmdir()
