"""A paste of Herschel and Bulkley: its stress at a rate, from creep to a blow."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import taichi as ti
from lane_kernels import compile_anew, flow_with_loss
from random_turns import random_turns
from scipy.optimize import brentq

from gf_usd.core.materials.physical import PHYSICAL
from gf_usd.physics.laws.flowing import paste

LAW = "paste"
MU, LAM, YIELD, HARDENING = 2.0, 3.0, 0.05, 0.3  # [Pa]
ETA = 0.4  # [Pa s^n]
EXPONENTS = (0.1, 1.0 / 3.0, 0.5, 1.0)


def gradients(n: int, size: float, seed: int = 0) -> np.ndarray:
    s = np.exp(np.random.default_rng(seed).uniform(-size, size, (n, 3)))
    U, V = (random_turns(n, k) for k in (seed + 1, seed + 2))
    return (U * s[:, None, :]) @ V.swapaxes(1, 2)


def shear_stress(F: np.ndarray) -> np.ndarray:
    """sigma = sqrt(3/2) |dev tau| [Pa] of (n, 3, 3) gradients."""
    e = np.log(np.linalg.svd(F)[1])
    return np.sqrt(6.0) * MU * np.linalg.norm(e - e.mean(1, keepdims=True), axis=1)


def returned(F, before, exponent, dt, real: type = np.float64, eta=ETA, hardening=HARDENING):
    own = {
        "yield_stress": YIELD, "hardening": hardening, "flow_viscosity": eta,
        "flow_exponent": exponent,
    }  # fmt: skip
    return flow_with_loss(LAW, F, before, MU, LAM, real, dt, **own)


def overstress(excess: float, exponent: float, dt: float) -> float:
    """[Pa] what is borne above the yield stress after a step of dt [s], by bisection."""
    stiff = 3.0 * MU + HARDENING

    def left(s: float) -> float:
        return s + stiff * dt * (s / ETA) ** (1.0 / exponent) - excess

    found: Any = brentq(left, 0.0, excess, rtol=np.float64(1e-14))
    return found


@pytest.mark.parametrize(("real", "rounding"), [(np.float64, 2e-16), (np.float32, 1e-7)])
@pytest.mark.parametrize("exponent", EXPONENTS)
def test_what_is_borne_above_the_yield_stress_is_the_power_of_the_rate(exponent, real, rounding):
    F = np.concatenate([gradients(112, 0.2), gradients(16, 0.002)]).astype(real)
    before = np.random.default_rng(1).uniform(0.0, 0.1, (128, 1)).astype(real)
    excess = shear_stress(F.astype(float)) - YIELD - HARDENING * before[:, 0]
    yields = excess > 0.0
    assert 100 < yields.sum() < 128
    # Logarithms of stretches, some dozen operations, and powers whose logarithm is up to WIDE;
    # and of Newton's iteration the square of its last residual but one.
    near = 50 * rounding * (3.0 * LAM + 8.0 * MU) + paste.CLOSE**2
    # from a blow, which lets next to nothing flow, to creep, which lets all
    for dt in 10.0 ** np.arange(-9, 10, 3):
        E, after, loss = returned(F, before, exponent, dt, real)
        over = np.array([overstress(y, exponent, dt) for y in excess[yields]])
        grown = (excess[yields] - over) / (3.0 * MU + HARDENING)
        np.testing.assert_allclose(after[yields, 0], before[yields, 0] + grown, atol=near)
        bears = YIELD + HARDENING * after[yields, 0] + over
        np.testing.assert_allclose(shear_stress(E)[yields], bears, atol=near)
        assert np.array_equal(E[~yields], F[~yields])
        assert (loss >= 0.0).all()


@pytest.mark.slow
def test_without_viscosity_it_lands_on_the_yield_stress_whatever_the_exponent() -> None:
    F = gradients(64, 0.2)
    seen = [returned(F, np.zeros((64, 1)), n, 1e-3, eta=0.0, hardening=0.0) for n in (0.1, 1.0)]
    assert np.array_equal(seen[0][0], seen[1][0])
    assert shear_stress(seen[0][0]).max() <= YIELD * (1.0 + 1e-12)


@pytest.mark.slow
def test_in_no_time_nothing_flows() -> None:
    F = gradients(64, 0.2)
    for exponent in EXPONENTS:
        E, after, _ = returned(F, np.zeros((64, 1)), exponent, 0.0)
        np.testing.assert_allclose(E, F, atol=1e-14)
        assert after.max() < 1e-14


@pytest.mark.parametrize("name", ["toothpaste", "mud", "cream", "honey"])
def test_the_shear_stress_of_presets_is_that_of_their_source(name) -> None:
    """tau_y + k D^n of pure shear at 1/s: sigma = sqrt(3) tau at a' = D / sqrt(3)."""
    own, n = PHYSICAL[name].parameters, PHYSICAL[name].parameters["flow_exponent"]
    source = {
        "toothpaste": (200.0, 60.0, 0.5), "mud": (50.0, 20.0, 1.0 / 3.0),
        "cream": (40.0, 15.0, 0.5), "honey": (0.06, 10.0, 1.0),
    }[name]  # fmt: skip
    for D in (0.1, 1.0, 10.0):
        sigma = own["yield_stress"] + own["flow_viscosity"] * (D / np.sqrt(3.0)) ** n
        assert sigma / np.sqrt(3.0) == pytest.approx(source[0] + source[1] * D ** source[2])


@ti.func
def growth_of_bingham(q, a, size, y, dt):
    return ti.max(y, 0.0) / (3.0 * q[0] + q[3] + q[4] / dt)


@pytest.mark.slow
def test_faults_are_caught(monkeypatch) -> None:
    """An exponent that is not heeded."""
    F = gradients(16, 0.2)
    E, _, _ = returned(F, np.zeros((16, 1)), 0.5, 0.1)
    monkeypatch.setattr(paste, "growth", growth_of_bingham)
    compile_anew()
    try:
        other, _, _ = returned(F, np.zeros((16, 1)), 0.5, 0.1)
        assert np.abs(other - E).max() > 1e-3
    finally:
        monkeypatch.undo()
        compile_anew()
