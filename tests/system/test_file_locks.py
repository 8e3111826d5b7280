"""Locks: one holder at a time, and none that outlives its process."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gf_usd.core.errors import BakeError
from gf_usd.system.file_locks import acquire, inherited, lock_path

HOLD = (
    "import sys, time; from pathlib import Path; from gf_usd.system.file_locks import acquire;"
    "held = acquire(Path(sys.argv[1])); print(held is not None, flush=True); time.sleep(60)"
)


def pin_constraint(path: Path) -> subprocess.Popen[str]:
    """A process that holds the lock."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(path)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "True\n"
    return process


def test_a_second_one_does_not_get_it(tmp_path: Path) -> None:
    path = tmp_path / "new" / "duck.rubber.usda"
    held = acquire(path)
    assert held is not None
    assert lock_path(path).is_file()
    assert acquire(path) is None
    held.release()
    held.release()
    again = acquire(path)
    assert again is not None
    again.release()


def test_kill_9_sets_it_free(tmp_path: Path) -> None:
    path = tmp_path / "a.usda"
    process = pin_constraint(path)
    assert acquire(path) is None
    process.send_signal(signal.SIGKILL)
    held = acquire(path, lock_timeout=20.0)
    assert held is not None
    held.release()
    process.wait()


def test_waiting_can_be_ended(tmp_path: Path) -> None:
    path = tmp_path / "a.usda"
    held = acquire(path)
    assert held is not None
    calls: list[float] = []

    def stopped() -> bool:
        calls.append(time.monotonic())
        return len(calls) > 2

    assert acquire(path, lock_timeout=float("inf"), stopped=stopped) is None
    assert len(calls) == 3
    held.release()


def test_a_child_holds_it_on_until_it_is_released(tmp_path: Path) -> None:
    path = tmp_path / "a.usda"
    for release in (False, True):
        held = acquire(path)
        assert held is not None
        child = subprocess.Popen(["sleep", "60"], pass_fds=(held.descriptor,))
        if release:
            held.release()
            free = acquire(path)
            assert free is not None
            free.release()
        else:
            # as if this process had died: its descriptor is closed, the child's is not
            os.close(held.descriptor)
            assert acquire(path) is None
        child.kill()
        child.wait()
        free = acquire(path)
        assert free is not None
        free.release()


def test_a_folder_that_cannot_be_is_an_error_in_words(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(BakeError, match=r"\.a\.usda\.lock cannot be created"):
        acquire(tmp_path / "file" / "a.usda")


def test_a_file_system_without_locks_is_an_error_in_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lock(descriptor: int, *, blocking: bool) -> bool:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr("filelock.lock_descriptor", lock)
    before = len(os.listdir("/proc/self/fd"))
    with pytest.raises(BakeError, match=r"\.a\.usda\.lock cannot be locked: No locks available"):
        acquire(tmp_path / "a.usda")
    assert len(os.listdir("/proc/self/fd")) == before


def test_a_lock_whose_file_was_removed_is_still_one(tmp_path: Path) -> None:
    path = tmp_path / "a.usda"
    first = acquire(path)
    assert first is not None
    first.release(remove=True)
    assert not lock_path(path).exists()
    second = acquire(path)
    assert second is not None
    assert acquire(path) is None
    second.release()


def test_a_child_knows_the_locks_it_was_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    held = acquire(tmp_path / "a.usda")
    assert held is not None
    monkeypatch.setenv("GF_USD_LOCKS", str(held.descriptor))
    assert inherited(tmp_path / "a.usda")
    assert not inherited(tmp_path / "b.usda")
    held.release()
    assert not inherited(tmp_path / "a.usda")  # a number that is no descriptor any more
