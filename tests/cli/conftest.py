"""The command line run in this process, from its words to its exit status, and a small asset."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from gf_usd.cli import main

# A block of 20 x 20 x 30 cm, two metres above the floor; centimetres, Z up, 48 frames a second.
BLOCK = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 0.01
    upAxis = "Z"
    timeCodesPerSecond = 48
    startTimeCode = 101
    endTimeCode = 110
)
def Xform "World" (
    kind = "component"
)
{
    def Mesh "Block"
    {
        uniform token subdivisionScheme = "none"
        float3[] extent = [(-10, -10, 200), (10, 10, 230)]
        point3f[] points = [
            (-10, -10, 200), (10, -10, 200), (10, 10, 200), (-10, 10, 200),
            (-10, -10, 230), (10, -10, 230), (10, 10, 230), (-10, 10, 230)
        ]
        int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
        int[] faceVertexIndices = [
            0, 3, 2, 1, 4, 5, 6, 7, 0, 1, 5, 4, 1, 2, 6, 5, 2, 3, 7, 6, 3, 0, 4, 7
        ]
        color3f[] primvars:displayColor = [(0.2, 0.4, 0.6)]
    }
}
"""


@dataclass(frozen=True)
class Done:
    """How a command ended."""

    status: int
    out: str
    err: str


@pytest.fixture
def gf_usd(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[..., Done]]:
    """Run ``gf-usd`` with these words, catching what any part of the process prints."""
    numbers = (signal.SIGTERM, signal.SIGINT)
    handlers = {number: signal.getsignal(number) for number in numbers}

    def call(*words: object) -> Done:
        capfd.readouterr()
        monkeypatch.setattr(sys, "argv", ["gf-usd", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            main.run()
        out, err = capfd.readouterr()
        code = ended.value.code
        return Done(0 if code is None else int(code), out, err)

    yield call
    for number, handler in handlers.items():
        signal.signal(number, handler)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to work in."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def block(tmp_path: Path) -> Path:
    """The small asset, outside the folder to work in."""
    path = tmp_path / "block.usda"
    path.write_text(BLOCK, encoding="utf-8")
    return path


def names(folder: Path) -> list[str]:
    """What lies in a folder."""
    return sorted(path.name for path in folder.iterdir())
