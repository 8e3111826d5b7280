"""The references of the cases: where their limits are known, and that a wrong one is noticed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import spherical_jn

from gf_usd.verify.cases.elastic import finite
from gf_usd.verify.cases.elastic.locking import ROOT
from gf_usd.verify.cases.elastic.slanted import breathing
from gf_usd.verify.ritz import bending_frequency


@pytest.mark.slow
@pytest.mark.parametrize("nu", [0.0, 0.3, 0.49])
def test_a_slender_bar_bends_as_euler_says(nu: float) -> None:
    slender = 60.0
    euler = ROOT**2 / np.sqrt(12.0) / slender
    # shear and rotary inertia slow it by a few (t / L)^2
    assert 1.0 - 5.0 / slender**2 <= bending_frequency(nu, slender) / euler < 1.0


@pytest.mark.slow
def test_a_sphere_with_a_tiny_hole_breathes_as_one_without() -> None:
    k, u = breathing(1e-3, 1.0, 1.0 / 3.0)  # nu = 1/4
    # Lamb: tan x = x / (1 - (c_p / 2 c_s)^2 x^2) with (c_p / c_s)^2 = 3
    assert np.tan(k) == pytest.approx(k / (1.0 - 0.75 * k * k), rel=1e-5)
    r = np.linspace(0.2, 1.0, 5)
    assert u(r) / u(r)[-1] == pytest.approx(spherical_jn(1, k * r) / spherical_jn(1, k), rel=1e-5)


def test_a_thin_shell_breathes_with_its_membrane() -> None:
    # w^2 rho R^2 = 2 E / (1 - nu), here nu = 1/4 and c_p^2 = 1.2 E / rho
    k, _ = breathing(0.999, 1.001, 1.0 / 3.0)
    assert k**2 * 1.2 == pytest.approx(2.0 / 0.75, rel=1e-4)


def test_forces_of_the_made_up_solution() -> None:
    X = np.random.default_rng(0).uniform(-0.5, 0.5, (20, 3))
    step, t = 1e-5, 0.3 * finite.END
    F = finite.gradient(X, t)
    for axis in range(3):
        aside = step * np.eye(3)[axis]
        slope = (finite.place(X + aside, t) - finite.place(X - aside, t)) / (2.0 * step)
        np.testing.assert_allclose(F[:, :, axis], slope, atol=1e-8)
    dt = 1e-3 * finite.END
    places = [finite.place(X, t + k * dt) for k in (-1, 0, 1)]
    second = (places[0] - 2.0 * places[1] + places[2]) / dt**2
    np.testing.assert_allclose(finite.acceleration(X, t), second, atol=1e-4 * np.abs(second).max())
    assert np.linalg.det(F).min() > 0.2


@pytest.mark.slow
def test_the_case_of_large_strain_notices_a_wrong_law(monkeypatch: pytest.MonkeyPatch) -> None:
    right = finite.stress
    monkeypatch.setattr(finite, "stress", lambda X, t, made: 1.1 * right(X, t, made))
    (measure,) = finite.converge(4, 8)("cpu")
    assert not measure.passed
