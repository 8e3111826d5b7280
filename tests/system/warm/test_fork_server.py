"""Children forked from a process that has loaded what they need; each is as isolated as any."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from gf_usd.core.errors import InputError
from gf_usd.system import sandbox
from gf_usd.system.resources import system_file
from gf_usd.system.sandbox import Isolated, Limits, run_isolated
from gf_usd.system.warm.fork_server import ALONE, AVAILABLE, ForkServer

pytestmark = pytest.mark.skipif(not AVAILABLE, reason="not this system")


@pytest.fixture(scope="module")
def forks() -> Iterator[ForkServer]:
    made = ForkServer(["isolated_tasks"])
    yield made
    made.close()


@pytest.fixture
def file(forks: ForkServer, tmp_path: Path) -> Iterator[Path]:
    sandbox.set_starter(forks.start)
    path = tmp_path / "a.usda"
    path.write_text("#usda 1.0\n")
    yield path
    sandbox.set_starter(sandbox.start)


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
    parents = [run_isolated(file, "isolated_tasks:parent", Limits()) for _ in range(2)]
    assert parents == 2 * [forks._process.pid]
    before = forks.cpu_seconds
    run_isolated(file, "isolated_tasks:spin", Limits(), 0.2)
    assert forks.cpu_seconds - before > 0.2


def test_a_child_works_where_its_parent_does(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_isolated(file, "isolated_tasks:folder", Limits()) == str(tmp_path)


@pytest.mark.parametrize(
    ("work", "message"),
    [
        ("crash", "caused its reader to crash (signal 11, SIGSEGV)"),
        ("hang", "took longer than 0.2 s"),
        ("eat", "needed more than 16 GB"),
        ("fail", "caused its reader to fail: KeyError: 'points'"),
        ("vanish", "caused its reader to crash (without output)"),
    ],
)
def test_failures_are_reported_and_harms_no_other(file: Path, work: str, message: str) -> None:
    seconds = 0.2 if work == "hang" else 60.0
    with pytest.raises(InputError) as caught:
        run_isolated(file, f"isolated_tasks:{work}", Limits(time=seconds))
    assert message in caught.value.message
    assert run_isolated(file, "isolated_tasks:folder", Limits()) == str(Path.cwd())


def test_two_at_once_and_one_that_is_given_up(file: Path, forks: ForkServer) -> None:
    with Isolated(file, "isolated_tasks:hang", Limits()):
        other = run_isolated(file, "isolated_tasks:parent", Limits())
        assert other == os.getpid(), "started afresh while the first runs"
    assert run_isolated(file, "isolated_tasks:parent", Limits()) == forks._process.pid


def test_without_the_process_a_child_is_started(file: Path) -> None:
    forks = ForkServer(["isolated_tasks"])
    sandbox.set_starter(forks.start)
    forks._process.stop()
    forks._process.reap()
    assert run_isolated(file, "isolated_tasks:parent", Limits()) == os.getpid()
    forks._end.close()


def test_children_end_with_the_process_that_started_them(file: Path, tmp_path: Path) -> None:
    forks = ForkServer(["isolated_tasks"])
    sandbox.set_starter(forks.start)
    written = tmp_path / "told"
    isolated = Isolated(file, "isolated_tasks:stay", Limits(), written)
    until = time.monotonic() + 30.0
    while not written.exists() and time.monotonic() < until:
        time.sleep(0.01)
    forks._end.shutdown(2)
    forks._process.reap()
    isolated.__exit__()
    for process in map(int, written.read_text().split()):
        assert _is_gone(process)
    forks._end.close()


AHEAD = """
import os, sys, threading
from pathlib import Path
from gf_usd.core.errors import InputError
from gf_usd.system.sandbox import Limits, run_isolated, starts_new_processes
from gf_usd.system.warm.fork_server import fork_ahead

file, task, threads = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
for _ in range(threads):
    threading.Thread(target=threading.Event().wait, daemon=True).start()
held = os.open(file, os.O_RDONLY)
forked = fork_ahead(["isolated_tasks"])
assert forked is not starts_new_processes()
for number in range(2):
    try:
        message = run_isolated(file, f"isolated_tasks:{task}", Limits(time=1.0))
    except InputError as error:
        message = error.message
    print(forked, message, flush=True)  # `os._exit` flushes nothing
os._exit(0)
"""


def _ahead(file: Path, task: str, threads: int = 0) -> list[str]:
    """What a process says of a task that its first and second child do."""
    done = subprocess.run(
        [sys.executable, "-c", AHEAD, str(file), task, str(threads)],
        capture_output=True, text=True, check=True, timeout=60.0,
        env={
            **os.environ, "PYTHONPATH": os.pathsep.join(sys.path),
            **dict.fromkeys(ALONE, "1"),  # as the command line sets it: NumPy starts no threads
        },
    )  # fmt: skip
    return done.stdout.splitlines()


@pytest.mark.parametrize(
    ("task", "message"),
    [
        ("loaded_already", "1"),
        ("crash", "caused its reader to crash (signal 11, SIGSEGV)"),
        pytest.param("hang", "took longer than 1 s", marks=pytest.mark.slow),
        ("fail", "caused its reader to fail: KeyError: 'points'"),
        pytest.param(
            "vanish", "caused its reader to crash (without output)", marks=pytest.mark.slow
        ),
    ],
)
def test_a_child_that_is_forked_ahead_is_as_isolated_as_any(
    tmp_path: Path, task: str, message: str
) -> None:
    path = tmp_path / "a.usda"
    path.write_text("#usda 1.0\n")
    first, second = _ahead(path, task)
    assert first.startswith("True ")
    assert message in first
    # the second child is started afresh: it is one file that a command reads
    assert ("0" if task == "loaded_already" else message) in second


@pytest.mark.slow
def test_no_child_is_forked_ahead_in_a_process_with_threads_or_keeps_files(tmp_path: Path) -> None:
    path = tmp_path / "a.usda"
    path.write_text("#usda 1.0\n")
    assert _ahead(path, "folder", threads=1)[0] == f"False {Path.cwd()}"
    ahead, afresh = _ahead(path, "files")
    assert ahead.split()[1] == afresh.split()[1]
