"""Playback of frames in real time."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence

ROUNDING = 1e-9  # [s] tolerance of the time of a frame


class Clock:
    """Playback of frames at given times.

    times : playback times [s], ascending.   now : current time [s], e.g. `time.perf_counter`.
    """

    def __init__(self, times: Sequence[float], now: Callable[[], float]) -> None:
        self._times, self._now = list(times), now
        # the last frame has the duration of the one before
        self._duration = times[-1] - times[0] + (times[-1] - times[-2] if len(times) > 1 else 0.0)
        self.frame = 0
        self.playing = True
        self._start = now()

    def tick(self) -> bool:
        """Advance to the frame of the current time; True if it changes."""
        if not self.playing or self._duration <= 0.0:
            return False
        at = self._times[0] + (self._now() - self._start) % self._duration
        frame = max(0, bisect_right(self._times, at + ROUNDING) - 1)
        changed, self.frame = frame != self.frame, frame
        return changed

    def toggle(self) -> None:
        """Play from the current frame, or pause at it."""
        self.playing = not self.playing
        self._start = self._now() - (self._times[self.frame] - self._times[0])

    def step(self, by: int) -> None:
        """Pause, and step by a number of frames, modulo their number."""
        self.playing = False
        self.frame = (self.frame + by) % len(self._times)

    def rewind(self) -> None:
        """Return to the first frame."""
        self.frame, self._start = 0, self._now()
