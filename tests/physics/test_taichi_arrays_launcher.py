"""Launches with arrays looked at once: what a launch by Taichi does."""

from typing import Any

import numpy as np
import pytest
from strained_ball import body, made

from gf_usd.physics import taichi_arrays
from gf_usd.physics.taichi_arrays import Launcher, aligned, on_arrays
from gf_usd.system.taichi_runtime import import_taichi, init_taichi

ti = import_taichi()

# Half the body squeezed, so that every number of the launch matters.
SPEED = 40.0


@pytest.mark.slow
@pytest.mark.parametrize("real", [np.float32, pytest.param(np.float64, marks=pytest.mark.slow)])
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


@pytest.mark.slow
def test_it_complains_as_taichi_does() -> None:
    solver = made()
    with pytest.raises(Exception, match="missing"):
        Launcher(solver.body.kernels.queued, solver.state.pack)(1)


@ti.kernel
def _shifted(of: ti.types.ndarray(dtype=ti.f64, ndim=2), by: ti.f64, count: ti.i32,
             out: ti.types.ndarray(dtype=ti.types.vector(4, ti.f64), ndim=1)):  # fmt: skip
    for p in range(count):
        for a in ti.static(range(3)):
            out[p][a] = of[p, a] + by


def test_launches_on_arrays_do_what_the_kernel_does() -> None:
    init_taichi()
    quick = on_arrays(_shifted)
    for by in (1.0, 2.0, 3.0):  # the first is launched by Taichi
        of, out = np.arange(6.0).reshape(2, 3) * by, aligned(2, 4)
        quick(of, by, 2, out)
        np.testing.assert_array_equal(out[:, :3], of + by)


@pytest.mark.slow
def test_launches_on_arrays_survive_a_restart_of_taichi() -> None:
    quick, of, out = on_arrays(_shifted), np.ones((2, 3)), aligned(2, 4)
    for threads in (1, 2, 1):
        init_taichi(threads=threads)
        out[...] = 0.0
        quick(of, 1.0, 2, out)
        np.testing.assert_array_equal(out[:, :3], 2.0)
    init_taichi()


@pytest.mark.parametrize(
    "of",
    [np.ones((2, 3), np.float32), np.ones(6), np.ones((3, 2)).T],
    ids=["type", "dimensions", "order"],
)
def test_other_arrays_are_refused_after_the_first_launch(of) -> None:
    init_taichi()
    quick, out = on_arrays(_shifted), aligned(2, 4)
    quick(np.ones((2, 3)), 1.0, 2, out)
    with pytest.raises(TypeError, match=r"contiguous float64 with 2 dimensions of elements \(\)"):
        quick(of, 1.0, 2, out)


def test_elements_of_another_width_are_refused() -> None:
    init_taichi()
    quick, of = on_arrays(_shifted), np.ones((2, 3))
    quick(of, 1.0, 2, aligned(2, 4))
    with pytest.raises(TypeError, match=r"1 dimensions of elements \(4,\)"):
        quick(of, 1.0, 2, np.zeros((2, 3)))
