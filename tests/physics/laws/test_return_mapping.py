"""The return mapping of every registered law, and faults put into it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import taichi as ti
from lane_kernels import compile_anew
from return_mapping import faults

from gf_usd.core.materials import LAWS
from gf_usd.physics.laws import crushable, von_mises
from gf_usd.physics.laws.simd3x3 import let, unrolled

# Of laws with Hencky's energy, for which the closed forms of `return_mapping` hold.
FLOWING = [token for token, row in LAWS.items() if row.flows and not row.over]


@pytest.mark.parametrize("token", FLOWING)
def test_the_return_mapping_is_right(token):
    assert faults(token) == []


growth, multiplier, slope = von_mises.growth, crushable.multiplier, crushable.slope
excess, dissipated, bearable = crushable.excess, crushable.dissipated, von_mises.bearable


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
