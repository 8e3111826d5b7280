"""Locks of the operating system, which end with the process that holds them, however it ends.

A lock is an advisory `flock` on a file of its own, which stays: a file that is removed while
another process waits for it would be two locks.  A child that inherits the descriptor holds the
lock as well, until it ends or the lock is released.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from gf_usd.errors import BakeError, UsageError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

POLL = 0.2  # [s]


class Held:
    """A lock that is held."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor  # to be inherited by a child

    def release(self) -> None:
        """Let go, also for children that inherited it; more than once does nothing."""
        if self.descriptor >= 0:
            assert fcntl is not None
            fcntl.flock(self.descriptor, fcntl.LOCK_UN)
            os.close(self.descriptor)
            self.descriptor = -1


def lock_path(path: Path) -> Path:
    """``duck.rubber.usda`` -> ``.duck.rubber.usda.lock``, beside it."""
    return path.with_name(f".{path.name}.lock")


def acquire(
    path: Path, *, patience: float = 0.0, stopped: Callable[[], bool] = lambda: False
) -> Held | None:
    """Lock what will be written under `path`; None where another holds it.

    Parameters
    ----------
    patience : [s] to wait for it; inf for as long as it takes.
    stopped : asked while waiting; True ends the wait.

    Raises
    ------
    UsageError : the system has no such locks.
    BakeError : the folder cannot be written.
    """
    if fcntl is None:
        raise UsageError(
            "gf-usd batch needs file locks, which this system does not have",
            "run it under Linux, macOS or the Windows Subsystem for Linux",
        )
    target = lock_path(path)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(target, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise BakeError(
            f"{target} cannot be made: {error.strerror}",
            f"check that {target.parent} is a folder that can be written, with space left",
        ) from error
    until = time.monotonic() + patience
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return Held(descriptor)
        except BlockingIOError:
            if time.monotonic() >= until or stopped():
                os.close(descriptor)
                return None
            time.sleep(POLL)


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold the lock of `path`, waiting for it as long as it takes."""
    held = acquire(path, patience=float("inf"))
    assert held is not None
    try:
        yield
    finally:
        held.release()
