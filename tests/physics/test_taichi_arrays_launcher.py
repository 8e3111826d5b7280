"""Launches with arrays looked at once: what a launch by Taichi does."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from strained_ball import body, made

from gf_usd.physics import taichi_arrays
from gf_usd.physics.taichi_arrays import Launcher

# Half the body squeezed, so that every number of the launch matters.
SPEED = 40.0


@pytest.mark.parametrize("real", [np.float32, np.float64])
def test_a_launcher_moves_a_body_as_its_kernel_does(real) -> None:
    ends = []
    for quick in (True, False):
        solver = made(real, velocity=lambda X: SPEED * np.sin(3.0 * X[:, [1, 2, 0]]))
        if not quick:
            kernel, pack = solver.body.kernels.queued, solver.state.pack
            plain: Any = lambda *a, kernel=kernel, pack=pack: kernel(pack, *a)  # noqa: E731
            solver.launches._kernel = plain
        for index in (1, 2, 3):
            solver.advance(index, 2 + index)
        ends.append(taichi_arrays.values(solver.state.arrays["u"]))
    assert np.abs(ends[0]).max() > 1e-3 * body().radius
    np.testing.assert_array_equal(ends[0], ends[1])


@pytest.mark.slow
def test_launchers_of_two_bodies_keep_to_their_own() -> None:
    one, other = made(), made()
    for solver in (one, other):
        solver.advance(1, 2)
    before = taichi_arrays.values(one.state.arrays["u"])
    taichi_arrays.put(other.state.arrays["v"], taichi_arrays.values(other.state.arrays["v"]) + 1.0)
    other.advance(2, 2)
    np.testing.assert_array_equal(taichi_arrays.values(one.state.arrays["u"]), before)


def test_it_complains_as_taichi_does() -> None:
    solver = made()
    with pytest.raises(Exception, match="missing"):
        Launcher(solver.body.kernels.queued, solver.state.pack)(1)
