"""Velocities of what is given at frames, by finite differences over the neighboring frames."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints


def velocity_at(
    at: Callable[[int], Floats], frame: int, frame_time: float, last: int | Ints
) -> NDArray[np.float64]:
    """dx/dt at a frame k >= 0 of a path over the frames 0 to m, constant after it.

        v_k = (x_b - x_a) / (T (b - a)),    a = max(k - 1, 0),    b = min(k + 1, m)

    the central difference inside, the one-sided one at the first and the last frame, each over
    the time between its two frames; 0 where b <= a: after the last frame, and of a single frame.
    Exact for linear motion at every frame; second order in T inside, first order at the ends.

    at : positions (n, 3) at a frame, which after the last are those of the last.
    frame_time : T [s] from a frame to the next.
    last : m; an array that broadcasts to (n, 3) where points have paths of different lengths.
    """
    before = max(frame - 1, 0)
    steps = np.maximum(np.minimum(frame + 1, last) - before, 1)  # 1: the difference is 0
    return np.asarray((at(frame + 1) - at(before)) / (frame_time * steps))
