"""A fluid: its pressure, its viscosity, and that it bears no tension."""

from __future__ import annotations

import numpy as np
import pytest
from lane_kernels import compile_anew, evaluate, flow_with_loss
from random_turns import gradients, log_strains, random_turns

from gf_usd.core.materials.dimensionless import DIMENSIONLESS, G0
from gf_usd.physics.laws.flowing import fluid

LAW = "fluid"
MU, LAM, ETA, DT = 2.0, 3.0, 0.5, 0.1  # [Pa], [Pa s], [s]
BULK = LAM + 2.0 / 3.0 * MU
TENSION = 0.05  # [Pa]
TIP = -np.log(1.0 - 7.0 * TENSION / BULK) / 7.0  # tr e where p = -TENSION


def returned(F, loose, real: type = np.float64, viscosity=ETA, cavitation=TENSION, dt=DT):
    own = {"viscosity": viscosity, "cavitation": cavitation}
    return flow_with_loss(LAW, F, loose, MU, LAM, real, dt, **own)


@pytest.mark.parametrize(("real", "rounding"), [(np.float64, 2e-16), (np.float32, 1e-7)])
@pytest.mark.parametrize("size", [0.02, 0.2])  # by the series, and by stretches
def test_shear_relaxes_tension_is_cut_and_the_volume_is_kept(real, rounding, size) -> None:
    F = gradients(256, size)
    E, loose, _ = returned(F, np.zeros((256, 1)), real)
    (dev, trace), (left, t) = log_strains(F), log_strains(E)
    # a few dozen operations with stretches, and the series' 2 |Z|^7 / 7: see `hencky`
    near = 50 * rounding + (1e-7 if real is np.float32 else 1e-14)
    np.testing.assert_allclose(left, ETA / (ETA + MU * DT) * dev, atol=near)
    np.testing.assert_allclose(t, np.minimum(trace, TIP), atol=near)
    np.testing.assert_allclose(loose[:, 0], np.maximum(trace - TIP, 0.0), atol=near)
    assert 50 < (trace > TIP).sum() < 250


@pytest.mark.slow
def test_the_tension_at_the_tip_is_that_of_cavitation() -> None:
    E, _, _ = returned(1.2 * np.eye(3)[None], np.zeros((1, 1)))
    P = evaluate(LAW, E, MU, LAM)[1]
    sigma = P @ E.swapaxes(1, 2) / np.linalg.det(E)
    np.testing.assert_allclose(sigma[0], TENSION * np.eye(3), atol=1e-14)


@pytest.mark.slow
def test_a_flow_at_a_rate_bears_twice_its_viscosity_times_that() -> None:
    """From rest, in one step much longer than viscosity / mu."""
    rate = 1e-3 * np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    eta, dt = 1e-6, 1.0
    F = (np.eye(3) + dt * rate)[None]
    E, _, _ = returned(F, np.zeros((1, 1)), viscosity=eta, dt=dt)
    P = evaluate(LAW, E, MU, LAM)[1]
    tau = (P @ E.swapaxes(1, 2))[0]
    # 1 / (1 + viscosity / (mu dt)) and strains of second order
    np.testing.assert_allclose(tau[0, 1], 2.0 * eta * rate[0, 1], rtol=2e-6)


def test_without_viscosity_it_bears_no_shear_at_all() -> None:
    for dt in (0.0, DT):
        E, _, loss = returned(gradients(64, 0.2), np.zeros((64, 1)), viscosity=0.0, dt=dt)
        assert log_strains(E)[0].max() < 1e-13
        assert loss.min() >= 0.0


def test_what_came_apart_closes_before_it_bears_pressure() -> None:
    E, loose, _ = returned(np.exp(0.03) * np.eye(3)[None], np.zeros((1, 1)), cavitation=0.0)
    np.testing.assert_allclose(E[0], np.eye(3), atol=1e-15)
    assert loose[0, 0] == pytest.approx(0.09)
    E, loose, _ = returned(np.exp(-0.04) * E, loose, cavitation=0.0)
    np.testing.assert_allclose(E[0], np.exp(-0.01) * np.eye(3), atol=1e-15)
    assert loose[0, 0] == pytest.approx(0.0, abs=1e-15)


def test_to_return_twice_without_viscosity_is_to_return_once() -> None:
    E, loose, _ = returned(gradients(64, 0.2), np.zeros((64, 1)), viscosity=0.0, cavitation=0.0)
    closed = loose[:, 0] == 0.0
    again, after, _ = returned(E, loose, viscosity=0.0, cavitation=0.0)
    np.testing.assert_allclose(again, E, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(after[closed], loose[closed], rtol=0.0, atol=1e-14)


def test_it_turns_with_the_body_and_with_the_material() -> None:
    F, Q = gradients(64, 0.2), random_turns(64, 9)
    loose = np.random.default_rng(3).uniform(0.0, 0.1, (64, 1))
    E, after, _ = returned(F, loose)
    for turned, expected in ((Q @ F, Q @ E), (F @ Q, E @ Q)):
        seen, seen_after, _ = returned(turned, loose)
        np.testing.assert_allclose(seen, expected, rtol=0.0, atol=1e-13)
        np.testing.assert_allclose(seen_after, after, rtol=0.0, atol=1e-13)


def test_dissipation_is_not_negative_and_the_energy_loses_no_less() -> None:
    F = gradients(256, 0.2)
    loose = np.random.default_rng(3).uniform(0.0, 0.05, (256, 1))
    E, _, loss = returned(F, loose)
    assert (loss >= -1e-15).all()
    before, after = (evaluate(LAW, G, MU, LAM)[0] for G in (F, E))
    # psi is convex in e along the way, and the stress that is counted is that at its end
    assert (before - after >= loss - 1e-14).all()


def test_water_is_compressed_by_a_percent_where_a_fall_of_three_radii_stops() -> None:
    r = 0.3
    made = DIMENSIONLESS["water"].material(r)
    K = made.lam + 2.0 / 3.0 * made.mu
    square = 6.0 * G0 * r  # [m^2/s^2] of a fall of three radii
    assert pytest.approx(100.0 * made.density * square) == K
    # the pressure of what stops, rho v^2, over K
    J = (1.0 + 7.0 * made.density * square / K) ** (-1.0 / 7.0)
    assert 1.0 - J < 0.01


def test_faults_are_caught(monkeypatch) -> None:
    """An exponent of 6 in the tension."""
    monkeypatch.setattr(fluid, "GAMMA", 6)
    compile_anew()
    try:
        E, _, _ = returned(1.2 * np.eye(3)[None], np.zeros((1, 1)))
        assert abs(log_strains(E)[1][0] - TIP) > 1e-5
    finally:
        monkeypatch.undo()
        compile_anew()
