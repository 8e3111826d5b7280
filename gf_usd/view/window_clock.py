"""Which frame is on the screen: playing in real time, over and over, or stepped by hand."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence

ROUNDING = 1e-9  # [s] a time computed a little before a frame's own shows that frame


class Clock:
    """Playback of frames at given times.

    times : [s] of playback, ascending.   now : a clock [s], e.g. `time.perf_counter`.
    """

    def __init__(self, times: Sequence[float], now: Callable[[], float]) -> None:
        self._times, self._now = list(times), now
        # the last frame is held as long as the one before it
        self._length = times[-1] - times[0] + (times[-1] - times[-2] if len(times) > 1 else 0.0)
        self.frame = 0
        self.playing = True
        self._start = now()

    def tick(self) -> bool:
        """Move on to the frame that is due; True where that is another one."""
        if not self.playing or self._length <= 0.0:
            return False
        at = self._times[0] + (self._now() - self._start) % self._length
        frame = max(0, bisect_right(self._times, at + ROUNDING) - 1)
        changed, self.frame = frame != self.frame, frame
        return changed

    def toggle(self) -> None:
        """Play from the frame that is shown, or stop there."""
        self.playing = not self.playing
        self._start = self._now() - (self._times[self.frame] - self._times[0])

    def step(self, by: int) -> None:
        """Stop, and show the frame before or after; it goes round."""
        self.playing = False
        self.frame = (self.frame + by) % len(self._times)

    def rewind(self) -> None:
        """Back to the first frame."""
        self.frame, self._start = 0, self._now()
