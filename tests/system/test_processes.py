"""Processes of jobs: heard line by line, ended when they must."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from gf_usd.system import processes
from gf_usd.system.processes import Child, Children, ProcessResult

STUBBORN = (
    "import signal, sys, time; signal.signal(signal.SIGTERM, signal.SIG_IGN);"
    "print('ready', file=sys.stderr, flush=True); time.sleep(60)"
)


def python(code: str, **kwargs) -> ProcessResult:
    return Child([sys.executable, "-c", code]).wait(lambda line: None, **kwargs)


def test_it_is_heard_out() -> None:
    lines: list[str] = []
    code = (
        "import sys; print('x' * 200_000);"  # more than a pipe holds
        "print('one\\ntwo', file=sys.stderr); sys.exit(3)"
    )
    ended = Child([sys.executable, "-c", code]).wait(lines.append)
    assert lines == ["one", "two"]
    assert (ended.status, len(ended.out), ended.err) == (3, 200_001, "one\ntwo\n")
    assert ended.seconds > 0.0
    assert ended.cpu_seconds > 0.0
    # Python itself takes several megabytes: a figure in kilobytes would show
    assert 2e6 < ended.peak_memory < 2e9
    assert not ended.timed_out
    assert not ended.stopped


def test_a_native_crash_is_the_signal() -> None:
    ended = python("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    assert ended.status == -signal.SIGSEGV
    assert not ended.stopped


def test_too_long_is_ended_and_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "GRACE", 0.2)
    ended = python(STUBBORN, timeout=1.0)
    assert ended.timed_out
    assert not ended.stopped
    assert ended.status == -signal.SIGKILL


@pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_limit_longer_than_any_clock_is_none() -> None:
    ended = python("import time; time.sleep(0.3)", timeout=1e30)
    assert (ended.status, ended.timed_out) == (0, False)


def test_stopping_ends_what_runs_and_starts_no_more(tmp_path: Path) -> None:
    children, found = Children(), []
    ready = threading.Event()
    code = "import sys, time; print('ready', file=sys.stderr, flush=True); time.sleep(60)"

    def work() -> None:
        found.append(children.run([sys.executable, "-c", code], lambda line: ready.set()))

    worker = threading.Thread(target=work)
    worker.start()
    assert ready.wait(30.0)
    children.stop()
    worker.join(30.0)
    assert found[0] is not None
    assert found[0].stopped
    assert found[0].status == -signal.SIGTERM
    flag = tmp_path / "flag"
    assert children.run(["touch", str(flag)], lambda line: None) is None
    assert not flag.exists()
    assert children.stopping


def test_a_child_ends_with_whoever_started_it() -> None:
    """A batch that is killed leaves no bake behind: the child looks for its parent."""
    watching = (
        "import time; from gf_usd.system.processes import end_with_parent; end_with_parent();"
        "import os; print(os.getpid(), flush=True); time.sleep(60)"
    )
    parent = (
        "import os, subprocess, sys, time;"
        "os.environ['GF_USD_PARENT'] = str(os.getpid());"
        f"subprocess.Popen([sys.executable, '-c', {watching!r}]); time.sleep(60)"
    )
    process = subprocess.Popen([sys.executable, "-c", parent], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    pid = int(process.stdout.readline())
    process.kill()
    process.wait()
    for _ in range(200):
        try:
            # a zombie whose new parent has not looked yet is gone as well
            if Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z":
                return
        except OSError:
            return
        time.sleep(0.1)
    os.kill(pid, signal.SIGKILL)
    raise AssertionError("the child outlived its parent")
