"""Playback in real time, pausing and stepping."""

from __future__ import annotations

from gf_usd.view.window.clock import Clock


class Now:
    """A clock that stands still until it is moved."""

    seconds = 100.0

    def __call__(self) -> float:
        return self.seconds


def test_it_plays_in_real_time_and_starts_again():
    now = Now()
    clock = Clock([0.0, 0.1, 0.2], now)
    seen = []
    for tenth in range(8):
        now.seconds = 100.0 + 0.1 * tenth + 0.05
        clock.tick()
        seen.append(clock.frame)
    assert seen == [0, 1, 2, 0, 1, 2, 0, 1]
    assert not clock.tick()


def test_it_pauses_steps_and_continues_from_there():
    now = Now()
    clock = Clock([0.0, 0.1, 0.2], now)
    clock.step(-1)
    assert (clock.frame, clock.playing) == (2, False)
    now.seconds += 5.0
    assert not clock.tick()
    clock.step(1)
    clock.step(1)
    clock.toggle()
    now.seconds += 0.12
    assert clock.tick()
    assert clock.frame == 2  # 0.1 s of frame 1 and 0.12 s more
    clock.rewind()
    assert clock.frame == 0
