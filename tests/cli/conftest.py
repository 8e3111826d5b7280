"""The command line run in this process, from its arguments to its exit status."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from small_bakes import BLOCK, Done

from gf_usd.cli import main
from gf_usd.cli.worker import READERS, SCHEMA
from gf_usd.system import sandbox
from gf_usd.system.warm.fork_server import AVAILABLE, ForkServer


@pytest.fixture(scope="module", autouse=True)
def _draw_quickly(small_pictures: None) -> None:
    """The command line hands over what is drawn: see `small_pictures`."""


@pytest.fixture(scope="session")
def start_reader() -> Iterator[Callable[[Path], sandbox.Reader]]:
    """Start a child that reads files as the workers of `gf-usd batch` do: by a fork.

    A new process for each would be a third of the time of these tests.  Programs that tests start
    have one.
    """
    if not AVAILABLE:
        yield sandbox.start
        return
    forks = ForkServer((*READERS, SCHEMA))
    yield forks.start
    forks.close()


@pytest.fixture
def gf_usd(
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    start_reader: Callable[[Path], sandbox.Reader],
) -> Iterator[Callable[..., Done]]:
    """Run ``gf-usd`` with these arguments, catching what any part of the process prints."""
    numbers = (signal.SIGTERM, signal.SIGINT)
    handlers = {number: signal.getsignal(number) for number in numbers}
    sandbox.set_starter(start_reader)

    def call(*arguments: object) -> Done:
        capfd.readouterr()
        monkeypatch.setattr(sys, "argv", ["gf-usd", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main.run()
        out, err = capfd.readouterr()
        code = ended.value.code
        return Done(0 if code is None else int(code), out, err)

    yield call
    sandbox.set_starter(sandbox.start)
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
