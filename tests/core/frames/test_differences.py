"""Velocities from neighboring frames: exact for linear motion at every frame, ends included."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from gf_usd.core.frames.differences import velocity_at

V = np.array([[1.0, -2.0, 0.5], [0.0, 3.0, -4.0]])  # [m/s]
T = 0.25  # [s] of one frame, exact in binary
LAST = 4


def linear(frame: int) -> NDArray[np.float64]:
    """x = V t up to the last frame."""
    return V * T * np.clip(frame, 0, LAST)


@pytest.mark.parametrize("frame", range(LAST + 1))
def test_linear_motion_has_its_velocity_at_every_frame(frame: int) -> None:
    np.testing.assert_array_equal(velocity_at(linear, frame, T, LAST), V)


@pytest.mark.parametrize("frame", [LAST + 1, LAST + 7])
def test_the_velocity_is_zero_after_the_last_frame(frame: int) -> None:
    np.testing.assert_array_equal(velocity_at(linear, frame, T, LAST), 0.0 * V)


def test_a_single_frame_is_at_rest() -> None:
    np.testing.assert_array_equal(velocity_at(lambda _: V, 0, T, 0), 0.0 * V)


def test_the_central_difference_is_exact_for_a_parabola_inside() -> None:
    """d/dt (a t^2 / 2) = a t; at the ends it is that of half a frame inside."""
    t = [velocity_at(lambda k: V * 0.5 * (T * k) ** 2, f, T, LAST) for f in range(LAST)]
    for got, time in zip(t, (0.5, 1.0, 2.0, 3.0), strict=True):
        np.testing.assert_array_equal(got, V * time * T)


def test_rows_may_end_at_different_frames() -> None:
    """The first point stops at frame 2, the second at frame 4."""
    last = np.array([[2], [LAST]])

    def x(frame: int) -> NDArray[np.float64]:
        return V * T * np.minimum(frame, last)

    np.testing.assert_array_equal(velocity_at(x, 2, T, last), V)
    np.testing.assert_array_equal(velocity_at(x, 3, T, last), V * [[0.0], [1.0]])
