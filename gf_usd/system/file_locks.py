"""Locks of the operating system, which end with the process that holds them, however it ends.

The library filelock takes them, by `flock` or `LockFileEx`, on a file of their own.  A lock file
may be removed by who holds it: who gets a lock looks whether its file is still the one of that
name, and else begins again.  On POSIX a child that inherits the descriptor holds the lock as well,
until it ends or the lock is released.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from gf_usd.core.errors import BakeError

INHERITED = "GF_USD_LOCKS"  # descriptors of the locks that a parent holds for its child
POLL = 0.2  # [s]


class Held:
    """A lock that is held."""

    def __init__(self, descriptor: int, path: Path) -> None:
        self.descriptor = descriptor  # to be inherited by a child
        self._path = path

    def release(self, *, remove: bool = False) -> None:
        """Let go, also for children that inherited it; more than once does nothing.

        remove : the file of the lock goes as well.
        """
        from filelock import unlock_descriptor

        if self.descriptor < 0:
            return
        if remove and os.name == "posix":
            self._path.unlink(missing_ok=True)
        unlock_descriptor(self.descriptor)
        os.close(self.descriptor)
        self.descriptor = -1
        if remove and os.name != "posix":
            # Windows removes no open file: it stays where another process waits for the lock
            with suppress(PermissionError):
                self._path.unlink(missing_ok=True)


def lock_path(path: Path) -> Path:
    """``duck.rubber.usda`` -> ``.duck.rubber.usda.lock``, next to it."""
    return path.with_name(f".{path.name}.lock")


def acquire(
    path: Path, *, lock_timeout: float = 0.0, stopped: Callable[[], bool] = lambda: False
) -> Held | None:
    """Lock what will be written under `path`; None where another holds it.

    Parameters
    ----------
    patience : [s] to wait for it; inf for as long as it takes.
    stopped : asked while waiting; True ends the wait.

    Raises
    ------
    BakeError : the folder cannot be written, or its file system has no locks.
    """
    from filelock import lock_descriptor

    target = lock_path(path)
    until = time.monotonic() + lock_timeout
    while True:
        descriptor = _open(target)
        try:
            free = lock_descriptor(descriptor, blocking=False)
        except OSError as error:
            os.close(descriptor)
            raise BakeError(
                f"{target} cannot be locked: {error.strerror}",
                "the file system of this folder may not support locks: write to another one",
            ) from error
        if not free:
            os.close(descriptor)
            if time.monotonic() >= until or stopped():
                return None
            time.sleep(POLL)
            continue
        if _is(descriptor, target):
            return Held(descriptor, target)
        os.close(descriptor)  # its holder removed it meanwhile


def inherited(path: Path) -> bool:
    """Whether the process that started this one holds the lock of `path` for it."""
    given = os.environ.get(INHERITED, "").split(",")
    return any(_is(int(word), lock_path(path)) for word in given if word.isdigit())


def _open(target: Path) -> int:
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        return os.open(target, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise BakeError(
            f"{target} cannot be created: {error.strerror}",
            f"check that {target.parent} is a writable folder with space left",
        ) from error


def _is(descriptor: int, path: Path) -> bool:
    """Whether an open file is the one that has a name now."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except OSError:  # no such descriptor, or no such file
        return False


@contextmanager
def locked(path: Path, *, remove: bool = False) -> Iterator[None]:
    """Hold the lock of `path`, waiting for it as long as it takes."""
    held = acquire(path, lock_timeout=float("inf"))
    assert held is not None
    try:
        yield
    finally:
        held.release(remove=remove)
