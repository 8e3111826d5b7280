"""Work in the background, one piece at a time: saving while the next frame is simulated.

USD writes a layer without holding the interpreter's lock, and Taichi holds it through a launch: so
the two do not wait for each other.  Whoever takes several threads should ask `at_work` first.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from gf_usd.core.errors import BakeError

_at_work: set[threading.Thread] = set()


def at_work() -> int:
    """Number of threads that work in the background now."""
    return len(_at_work)


class BackgroundWriter:
    """Runs at most one piece of work at a time; what it raises is raised by `settle`."""

    def __init__(self) -> None:
        self._thread: threading.Thread | None = None
        self._failed: BakeError | None = None

    @property
    def busy(self) -> bool:
        """Whether there is work that nobody waited for."""
        return self._thread is not None

    def start(self, work: Callable[[], None]) -> None:
        """Begin; call `settle` before."""
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
        """Wait until the work is done; raises the BakeError that it raised."""
        if self._thread is None:
            return
        self._thread.join()
        self._thread = None
        failed, self._failed = self._failed, None
        if failed is not None:
            raise failed
