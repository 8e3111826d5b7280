"""A bake that a batch started ends when the batch is gone, whatever killed it."""

from __future__ import annotations

import os
import signal
import threading

PARENT = "GF_USD_PARENT"  # set by batch.child: the process that waits for this one
EVERY = 0.5  # [s]


def end_with_parent() -> None:
    """Watch the parent that started this process to hear it out, if one did.

    Without it nobody would hear the result, while the lock on its files would still be held.
    """
    parent = os.environ.pop(PARENT, "")
    if parent.isdigit():
        threading.Thread(target=_watch, args=(int(parent),), daemon=True).start()


def _watch(parent: int) -> None:
    tick = threading.Event()
    while os.getppid() == parent:
        tick.wait(EVERY)
    os.kill(os.getpid(), signal.SIGTERM)
