"""The return mapping of every registered law, and faults put into it."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import taichi as ti
from lane_kernels import compile_anew
from return_mapping import faults

from gf_usd.core.materials.laws import LAWS, YIELD_STRESS
from gf_usd.physics.laws import crushable, hencky, radial_flow, von_mises, von_mises_neo_hookean
from gf_usd.physics.laws.simd3x3 import let, unrolled

# What bears more the more it is pressed has tests of its own.
FLOWING = [t for t, row in LAWS.items() if YIELD_STRESS in row.parameters and not row.unbounded]


@pytest.mark.slow
@pytest.mark.parametrize("token", FLOWING)
def test_the_return_mapping_is_right(token):
    assert faults(token) == []


growth, multiplier = von_mises.growth, crushable.multiplier
cap, slope = crushable.cap, crushable.slope
trial, dissipated, bearable = crushable.trial, crushable.dissipated, von_mises.bearable
growth_over, exponents = radial_flow.growth, radial_flow.exponents
invariants, shrinking = radial_flow.invariants, radial_flow.shrinking
principal_stress = radial_flow.principal_stress


@ti.func
def less_growth(q, a, size, y, dt):
    return 0.999 * growth(q, a, size, y, dt)


@ti.func
def growth_of_the_norm(q, a, size, y, dt):
    return ti.sqrt(2.0 / 3.0) * growth(q, a, size, y, dt)


@ti.func
def without_hardening(q, a):
    return bearable(q, 0.0 * a)


@unrolled
def first_order_only(X):
    a, b, c, d, e, f = X
    return let([1.0 + a, f, e, f, 1.0 + b, d, e, d, 1.0 + c])


@unrolled
def strain_without_its_cube(Z):
    mean = let((Z[0] + Z[1] + Z[2]) / 3.0)
    return let([1.001 * (Z[0] - mean), Z[1] - mean, Z[2] - mean, Z[3], Z[4], Z[5]])


@ti.func
def half_of_the_slope(q, pressure):
    return 0.5 * slope(q, pressure)


@ti.func
def as_strong_in_tension(q, pressure):
    return cap(q, -1.0 + 0.0 * pressure)


@ti.func
def more_multiplier(q, a, y, stress, pressure, inward):
    m, lost = multiplier(q, a, y, stress, pressure, inward)
    return m, lost * 1.01


@ti.func
def forgets_what_was_lost(q, a, dt, square, trace):
    return trial(q, 0.0 * a, dt, square, trace)


@ti.func
def dissipation_without_pressure(q, m, stress, pressure):
    return dissipated(q, m, stress, 0.0 * pressure)


@ti.func
def negative_dissipation(q, m, stress, pressure):
    return 0.0 - dissipated(q, m, stress, pressure)


@ti.func
def less_growth_over(law: ti.template(), c, q, a, trial, n, most, y, dt, done):
    g, work = growth_over(law, c, q, a, trial, n, most, y, dt, done)
    return 0.999 * g, 0.999 * work


@ti.func
def growth_of_the_trial(law: ti.template(), c, q, a, trial, n, most, y, dt, done):
    g = ti.max(y, 0.0) / (3.0 * q[0] + 0.2)  # of Hencky's law without saturation
    return g, g * law(c, trial, n, g)[1]


@ti.func
def work_of_the_trial(law: ti.template(), c, q, a, trial, n, most, y, dt, done):
    g, _ = growth_over(law, c, q, a, trial, n, most, y, dt, done)
    return g, g * law(c, trial, n, 0.0 * g)[1]


@unrolled
def without_the_square(k, h, w):
    A, B = exponents(k, h, w)
    return [A, 0.0 * B]


@unrolled
def determinant_of_the_other_sign(X, D):
    h, w, j = invariants(X, D)
    return [h, let(0.0 - w), j]


@unrolled
def never(c, D, Z):
    return 0.0 * Z[0]


@ti.func
def stress_off_by_a_thousandth(c, s, n, g):
    stress, along = principal_stress(c, s, n, g)
    return stress * 1.001, along


@ti.func
def less_of_the_square(q):
    return [0.0 * q[0], 0.999 * q[0]]


@ti.func
def shrinking_along_one(n, g):
    k = shrinking(n, g)
    return [k[0] * 1.0001, k[1], k[2]]


NEO_HOOKEAN = ("vonMisesNeoHookean", radial_flow)
MUTATIONS: dict[str, tuple[str, Any, str, Any]] = {
    "a thousandth less growth": ("vonMises", von_mises, "growth", less_growth),
    "growth of the norm": ("vonMises", von_mises, "growth", growth_of_the_norm),
    "no hardening": ("vonMises", von_mises, "bearable", without_hardening),
    "exponential of the first order": ("vonMises", von_mises, "exponential", first_order_only),
    "skewed strain": ("vonMises", von_mises, "deviator_of_series", strain_without_its_cube),
    "half of the pressure's slope": ("crushable", crushable, "slope", half_of_the_slope),
    "more lost than flowed": ("crushable", crushable, "multiplier", more_multiplier),
    "as strong in tension": ("crushable", crushable, "cap", as_strong_in_tension),
    "forgets what was lost": ("crushable", crushable, "trial", forgets_what_was_lost),
    "no work of pressure": ("crushable", crushable, "dissipated", dissipation_without_pressure),
    "work of the wrong sign": ("crushable", crushable, "dissipated", negative_dissipation),
    "exponential of a foam": ("crushable", hencky, "exponential", first_order_only),
    "less growth over another": (*NEO_HOOKEAN, "growth", less_growth_over),
    "growth of Hencky's law": (*NEO_HOOKEAN, "growth", growth_of_the_trial),
    "work of the trial stress": (*NEO_HOOKEAN, "growth", work_of_the_trial),
    "no hardening over another": (*NEO_HOOKEAN, "bearable", without_hardening),
    "exponential without its square": (*NEO_HOOKEAN, "exponents", without_the_square),
    "determinant of the other sign": (*NEO_HOOKEAN, "invariants", determinant_of_the_other_sign),
    "bound too low": (*NEO_HOOKEAN, "bound", never),
    "less of the law's stress": (
        "vonMisesNeoHookean",
        von_mises_neo_hookean,
        "powers",
        less_of_the_square,
    ),
    "more stress than there is": (*NEO_HOOKEAN, "principal_stress", stress_off_by_a_thousandth),
    "flow that is not isochoric": (*NEO_HOOKEAN, "shrinking", shrinking_along_one),
    "exponential over another": (*NEO_HOOKEAN, "exponential", first_order_only),
}


@contextmanager
def mutated(module: Any, name: str, wrong: Any) -> Iterator[None]:
    """A function of a law's module is another one as long as this lasts."""
    right = vars(module)[name]
    setattr(module, name, wrong)
    compile_anew()
    try:
        yield
    finally:
        setattr(module, name, right)
        compile_anew()


@pytest.mark.slow
@pytest.mark.parametrize("name", MUTATIONS)
def test_a_fault_in_the_return_mapping_is_noticed(name):
    token, module, function, wrong = MUTATIONS[name]
    assert vars(module)[function] is not wrong
    with mutated(module, function, wrong):
        assert faults(token) != []
