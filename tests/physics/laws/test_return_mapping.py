"""The return mapping of every registered law, and faults put into it."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import taichi as ti
from lane_kernels import compile_anew
from return_mapping import faults

from gf_usd.core.materials.laws import LAWS, YIELD_STRESS
from gf_usd.physics.laws import crushable, radial_flow, von_mises
from gf_usd.physics.laws.simd3x3 import let, unrolled

# What bears more the more it is pressed has tests of its own.
FLOWING = [t for t, row in LAWS.items() if YIELD_STRESS in row.parameters and not row.unbounded]


@pytest.mark.parametrize("token", FLOWING)
def test_the_return_mapping_is_right(token):
    assert faults(token) == []


growth, multiplier, slope = von_mises.growth, crushable.multiplier, crushable.slope
excess, dissipated, bearable = crushable.excess, crushable.dissipated, von_mises.bearable
growth_over, near_stress = radial_flow.growth, radial_flow.near_stress
principal_stress, shrinking = radial_flow.principal_stress, radial_flow.shrinking


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
def half_of_the_slope(q):
    return 0.5 * slope(q)


@ti.func
def more_multiplier(q, a, y, stress, pressure, inward):
    m, lost = multiplier(q, a, y, stress, pressure, inward)
    return m, lost * 1.01


@ti.func
def forgets_what_was_lost(q, a, size, trace):
    return excess(q, 0.0 * a, size, trace)


@ti.func
def dissipation_without_pressure(q, m, stress, pressure):
    return dissipated(q, m, stress, 0.0 * pressure)


@ti.func
def negative_dissipation(q, m, stress, pressure):
    return 0.0 - dissipated(q, m, stress, pressure)


@ti.func
def less_growth_over(pk1: ti.template(), law: ti.template(), q, a, trial, n, most, y, dt, done):
    g, work = growth_over(pk1, law, q, a, trial, n, most, y, dt, done)
    return 0.999 * g, 0.999 * work


@ti.func
def growth_of_the_trial(pk1: ti.template(), law: ti.template(), q, a, trial, n, most, y, dt, done):
    g = ti.max(y, 0.0) / (3.0 * q[0] + 0.2)  # of Hencky's law without saturation
    return g, g * law(pk1, trial, n, g, q, done)[1]


@ti.func
def work_of_the_trial(pk1: ti.template(), law: ti.template(), q, a, trial, n, most, y, dt, done):
    g, _ = growth_over(pk1, law, q, a, trial, n, most, y, dt, done)
    return g, g * law(pk1, trial, n, 0.0 * g, q, done)[1]


@ti.func
def more_of_the_shear(pk1: ti.template(), F, n, g, q, converged):
    stress, along = near_stress(pk1, F, n, g, q, converged)
    m = [n[0], n[1], n[2], 0.5 * n[3], 0.5 * n[4], 0.5 * n[5]]
    return stress, along - near_stress(pk1, F, m, g, q, converged)[1] + along


@ti.func
def stress_off_by_a_thousandth(pk1: ti.template(), s, n, g, q, converged):
    stress, along = principal_stress(pk1, s, n, g, q, converged)
    return stress * 1.001, along


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
    "forgets what was lost": ("crushable", crushable, "excess", forgets_what_was_lost),
    "no work of pressure": ("crushable", crushable, "dissipated", dissipation_without_pressure),
    "work of the wrong sign": ("crushable", crushable, "dissipated", negative_dissipation),
    "exponential of a foam": ("crushable", crushable, "exponential", first_order_only),
    "less growth over another": (*NEO_HOOKEAN, "growth", less_growth_over),
    "growth of Hencky's law": (*NEO_HOOKEAN, "growth", growth_of_the_trial),
    "work of the trial stress": (*NEO_HOOKEAN, "growth", work_of_the_trial),
    "no hardening over another": (*NEO_HOOKEAN, "bearable", without_hardening),
    "shear counted otherwise": (*NEO_HOOKEAN, "near_stress", more_of_the_shear),
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
