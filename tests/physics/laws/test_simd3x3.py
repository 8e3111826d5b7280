"""Functions that write a kernel down as they are called, against what Taichi reads itself."""

import warnings

import numpy as np
import pytest
import taichi as ti

from gf_usd.physics.laws.simd3x3 import at, let, put, unrolled
from gf_usd.system.taichi_runtime import init_taichi

ARRAY = ti.types.ndarray(dtype=ti.f64, ndim=1)


@pytest.fixture(autouse=True)
def _started():
    init_taichi("cpu", threads=1)


@unrolled
def cubes(x):
    square = let(x * x)
    return [square * x, square]


@unrolled
def gather_into(total, array, o):
    for n in range(3):
        put(total, total + at(array, o + n))


@unrolled
def swapped(pair):
    first = let(pair[0])
    put(pair[0], pair[1])
    put(pair[1], first)


def test_a_kernel_calls_it_without_a_warning_and_gets_its_numbers() -> None:
    @ti.kernel
    def run(a: ARRAY, out: ARRAY):
        for i in range(4):
            cube, square = cubes(a[i])
            out[i] = cube - square

    a, out = np.array([1.0, 2.0, -3.0, 0.5]), np.zeros(4)
    with warnings.catch_warnings():
        warnings.simplefilter("error", SyntaxWarning)
        run(a, out)
    assert out == pytest.approx(a**3 - a**2)


def test_memory_is_read_and_variables_change_within_a_loop_of_the_kernel() -> None:
    @ti.kernel
    def run(a: ARRAY, out: ARRAY):
        for _ in range(1):
            total = 0.0 * a[0]
            for k in range(4):
                gather_into(total, a, 3 * k)
            out[0] = total

    a, out = np.arange(12.0), np.zeros(1)
    run(a, out)
    assert out[0] == a.sum()


def test_a_variable_keeps_what_it_held_before_the_next_change() -> None:
    @ti.kernel
    def run(out: ARRAY):
        for _ in range(1):
            pair = [1.0 + 0.0 * out[0], 2.0 + 0.0 * out[0]]
            swapped(pair)
            out[0], out[1] = pair[0], pair[1]

    out = np.zeros(2)
    run(out)
    assert out.tolist() == [2.0, 1.0]


def test_a_fault_in_it_is_reported_with_the_line_of_the_kernel() -> None:
    @unrolled
    def wrong(x):
        return x + "no number"

    @ti.kernel
    def run(out: ARRAY):
        for _ in range(1):
            out[0] = wrong(out[1])

    with pytest.raises(ti.TaichiCompilationError, match=r"out\[0\] = wrong\(out\[1\]\)"):
        run(np.zeros(2))
