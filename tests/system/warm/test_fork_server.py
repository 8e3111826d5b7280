"""Children forked from a process that has loaded what they need; each is as isolated as any."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from gf_usd.core.errors import InputError
from gf_usd.system import sandbox
from gf_usd.system.memory_and_disk import system_file
from gf_usd.system.sandbox import Isolated, Limits, attempt
from gf_usd.system.warm.fork_server import AVAILABLE, ForkServer

pytestmark = pytest.mark.skipif(not AVAILABLE, reason="not this system")


@pytest.fixture(scope="module")
def forks() -> Iterator[ForkServer]:
    made = ForkServer(["isolated_tasks"])
    yield made
    made.close()


@pytest.fixture
def file(forks: ForkServer, tmp_path: Path) -> Iterator[Path]:
    sandbox.start_by(forks.start)
    path = tmp_path / "a.usda"
    path.write_text("#usda 1.0\n")
    yield path
    sandbox.start_by(sandbox.start)


def _is_gone(process: int) -> bool:
    """Whether a process ends within ten seconds; one that nobody reaped yet is a zombie."""
    until = time.monotonic() + 10.0
    while time.monotonic() < until:
        state = system_file(f"/proc/{process}/stat").rpartition(")")[2].split()
        if not state or state[0] == "Z":
            return True
        time.sleep(0.02)
    return False


def test_children_are_forked_one_after_the_other(file: Path, forks: ForkServer) -> None:
    parents = [attempt(file, "isolated_tasks:parent", Limits()) for _ in range(2)]
    assert parents == 2 * [forks._process.pid]
    before = forks.cpu_seconds
    attempt(file, "isolated_tasks:spin", Limits(), 0.2)
    assert forks.cpu_seconds - before > 0.2


def test_a_child_works_where_its_parent_does(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert attempt(file, "isolated_tasks:folder", Limits()) == str(tmp_path)


@pytest.mark.parametrize(
    ("work", "words"),
    [
        ("crash", "made its reader crash (signal 11, SIGSEGV)"),
        ("hang", "took longer than 0.2 s"),
        ("eat", "asked for more than 16 GB"),
        ("fail", "made its reader fail: KeyError: 'points'"),
        ("vanish", "made its reader crash (without a word)"),
    ],
)
def test_what_goes_wrong_is_said_and_harms_no_other(file: Path, work: str, words: str) -> None:
    seconds = 0.2 if work == "hang" else 60.0
    with pytest.raises(InputError) as caught:
        attempt(file, f"isolated_tasks:{work}", Limits(time=seconds))
    assert words in caught.value.message
    assert attempt(file, "isolated_tasks:folder", Limits()) == str(Path.cwd())


def test_two_at_once_and_one_that_is_given_up(file: Path, forks: ForkServer) -> None:
    with Isolated(file, "isolated_tasks:hang", Limits()):
        other = attempt(file, "isolated_tasks:parent", Limits())
        assert other == os.getpid(), "started afresh while the first runs"
    assert attempt(file, "isolated_tasks:parent", Limits()) == forks._process.pid


def test_without_the_process_a_child_is_started(file: Path) -> None:
    forks = ForkServer(["isolated_tasks"])
    sandbox.start_by(forks.start)
    forks._process.stop()
    forks._process.reap()
    assert attempt(file, "isolated_tasks:parent", Limits()) == os.getpid()
    forks._end.close()


def test_children_end_with_the_process_that_wants_them(file: Path, tmp_path: Path) -> None:
    forks = ForkServer(["isolated_tasks"])
    sandbox.start_by(forks.start)
    told = tmp_path / "told"
    isolated = Isolated(file, "isolated_tasks:stay", Limits(), told)
    until = time.monotonic() + 30.0
    while not told.exists() and time.monotonic() < until:
        time.sleep(0.01)
    forks._end.shutdown(2)
    forks._process.reap()
    isolated.__exit__()
    for process in map(int, told.read_text().split()):
        assert _is_gone(process)
    forks._end.close()
