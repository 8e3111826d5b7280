"""Bit-identical from run to run, at any number of threads and however substeps are launched."""

from __future__ import annotations

import numpy as np
import pytest
from launching import WAYS, launched
from slow_parameters import slow_but
from solids import ball, preset_material, settings

from gf_usd.physics.total_lagrangian.solver import TotalLagrangian


def drop(threads: int, way: str, monkeypatch, frames: int = 8) -> np.ndarray:
    body, samples = ball(1_500, radius=0.1)
    s = settings(
        frames=frames, gravity=(0.0, -9.81, 0.0), floor=-0.1, filter_rate=50.0, threads=threads,
        fps=60.0,
    )  # fmt: skip
    solver = TotalLagrangian(
        body, [preset_material("rubber", body)], s, samples=samples, velocity=(0.3, -2.0, 0.1)
    )
    launched(solver, way, monkeypatch)
    deepest = max(f.health.penetration for f in solver.frames())
    assert deepest > 0.0, "the floor is met: contact is part of what must repeat"
    now = solver.state.view()
    return np.concatenate([now.u, now.v, [now.offset]])


@pytest.fixture(scope="module")
def first():
    with pytest.MonkeyPatch.context() as patch:
        return drop(1, "alone", patch)


@pytest.mark.parametrize(
    ("way", "threads"),
    slow_but([(way, k) for way in WAYS for k in (1, 2)], ("alone", 1), *((w, 2) for w in WAYS)),
)
def test_reruns_threads_and_launches_agree_to_the_bit(first, way, threads, monkeypatch):
    # The same sums in the same order, and no multiply-add is fused (`runtime`: fast_math is off).
    assert np.array_equal(first, drop(threads, way, monkeypatch))
