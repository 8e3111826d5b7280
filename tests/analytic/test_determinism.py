"""Bit-identical from run to run and at any number of threads, on both paths of the solver."""

from __future__ import annotations

import numpy as np
import pytest
from solids import ball, look, settings

from gf_usd.physics import launch as module
from gf_usd.physics.solver import TotalLagrangian


def drop(threads: int, frames: int = 8) -> np.ndarray:
    body, samples = ball(700, radius=0.1)
    s = settings(
        frames=frames, gravity=(0.0, -9.81, 0.0), floor=-0.1, filter_rate=50.0, threads=threads,
        fps=60.0,
    )  # fmt: skip
    solver = TotalLagrangian(
        body, [look("rubber", body)], s, samples=samples, velocity=(0.3, -2.0, 0.1)
    )
    deepest = max(f.health.penetration for f in solver.frames())
    assert deepest > 0.0, "the floor is met: contact is part of what must repeat"
    return np.concatenate([*solver.state(), [solver.offset]])


@pytest.mark.parametrize("serial_below", [10**9, 0], ids=["serial", "parallel"])
def test_reruns_and_thread_counts_agree_to_the_bit(monkeypatch, serial_below):
    monkeypatch.setattr(module, "SERIAL_BELOW", serial_below)
    first = drop(threads=2)
    assert np.array_equal(first, drop(threads=2))
    assert np.array_equal(first, drop(threads=1))


def test_the_two_paths_agree_to_the_bit(monkeypatch):
    # The same sums in the same order, and no multiply-add is fused (`runtime`: fast_math is off).
    states = []
    for below in (10**9, 0):
        monkeypatch.setattr(module, "SERIAL_BELOW", below)
        states.append(drop(threads=2))
    assert np.array_equal(*states)
