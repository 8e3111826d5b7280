"""File locks of the operating system, which end with the process that holds them.

The library filelock acquires them, with `flock` or `LockFileEx`, on separate lock files.  The
holder of a lock may remove its file; a process that acquires a lock therefore checks that the file
still has its name, and otherwise starts over.  On POSIX, a child that inherits the descriptor holds
the lock too, until it ends or the lock is released.
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
    """An acquired lock."""

    def __init__(self, descriptor: int, path: Path) -> None:
        self.descriptor = descriptor  # for inheritance by a child
        self._path = path

    def release(self, *, remove: bool = False) -> None:
        """Release the lock, also for children that inherited it; further calls do nothing.

        remove : delete the lock file too.
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
            # Windows cannot remove an open file, which another process may wait on
            with suppress(PermissionError):
                self._path.unlink(missing_ok=True)


def lock_path(path: Path) -> Path:
    """``duck.rubber.usda`` -> ``.duck.rubber.usda.lock``, next to it."""
    return path.with_name(f".{path.name}.lock")


def acquire(
    path: Path, *, lock_timeout: float = 0.0, stopped: Callable[[], bool] = lambda: False
) -> Held | None:
    """Lock the output `path`; None where another process holds the lock.

    Parameters
    ----------
    lock_timeout : [s] to wait for the lock; inf: without limit.
    stopped : polled while waiting; True ends the wait.

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
        os.close(descriptor)  # its holder has removed it


def inherited(path: Path) -> bool:
    """Whether the parent process holds the lock of `path` for this process."""
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
    """Whether an open file is the one that now has a path."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except OSError:  # no such descriptor, or no such file
        return False


@contextmanager
def locked(path: Path, *, remove: bool = False) -> Iterator[None]:
    """Hold the lock of `path` within the block, after waiting for it without limit."""
    held = acquire(path, lock_timeout=float("inf"))
    assert held is not None
    try:
        yield
    finally:
        held.release(remove=remove)
