"""A background thread for one task at a time: saving while the next frame is simulated.

USD writes a layer without holding Python's GIL, and Taichi holds it during a launch, so neither
waits for the other.  Code that starts several threads should consult `running_threads` first.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from gf_usd.core.errors import BakeError

_at_work: set[threading.Thread] = set()


def running_threads() -> int:
    """Number of background threads that are busy."""
    return len(_at_work)


class BackgroundWriter:
    """Runs at most one task at a time; `settle` raises the exception of the task."""

    def __init__(self) -> None:
        self._thread: threading.Thread | None = None
        self._failed: BakeError | None = None

    @property
    def busy(self) -> bool:
        """Whether a task was started and not yet settled."""
        return self._thread is not None

    def start(self, work: Callable[[], None]) -> None:
        """Start a task; call `settle` before."""
        assert self._thread is None, "the last task was not waited for"

        def run() -> None:
            try:
                work()
            except BakeError as error:
                self._failed = error
            finally:
                _at_work.discard(threading.current_thread())

        self._thread = threading.Thread(target=run, name="gf-usd writer")
        _at_work.add(self._thread)
        self._thread.start()

    def settle(self) -> None:
        """Wait for the end of the task; raises its BakeError."""
        if self._thread is None:
            return
        self._thread.join()
        self._thread = None
        failed, self._failed = self._failed, None
        if failed is not None:
            raise failed
