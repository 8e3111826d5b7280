"""Drucker-Prager: the return to the cone, to its tip, and what closes before it bears pressure."""

from __future__ import annotations

import numpy as np
import pytest
from lane_kernels import evaluate, flow_with_loss
from random_turns import gradients, log_strains, random_turns

from gf_usd.physics.laws.flowing import drucker_prager

LAW = "druckerPrager"
MU, LAM = 2.0, 3.0  # [Pa]
BULK = LAM + 2.0 / 3.0 * MU
FRICTION, COHESION = 0.6, 0.02
TIP = COHESION / (FRICTION * BULK)  # tr e at the tip of the cone


def returned(F, loose, real: type = np.float64, friction=FRICTION, cohesion=COHESION):
    return flow_with_loss(
        LAW, F, loose, MU, LAM, real, internal_friction=friction, cohesion=cohesion
    )


def excess(F: np.ndarray) -> np.ndarray:
    """(n,) [Pa] |s| / sqrt(2) over what the pressure lets it bear."""
    size, trace = log_strains(F)
    return np.sqrt(2.0) * MU * size - (COHESION - FRICTION * BULK * trace)


@pytest.mark.slow
@pytest.mark.parametrize("real", [np.float64, np.float32])
def test_inside_the_cone_nothing_changes_not_a_bit(real: type) -> None:
    # pressed by 2 %, sheared by little
    F = (np.exp(-0.02) * gradients(64, 0.002)).astype(real)
    assert (excess(F.astype(float)) < 0.0).all()
    E, loose, loss = returned(F, np.zeros((64, 1), real), real)
    assert np.array_equal(E, F)
    assert not loose.any()
    assert not loss.any()


@pytest.mark.parametrize(("real", "rounding"), [(np.float64, 2e-16), (np.float32, 1e-7)])
@pytest.mark.parametrize("size", [0.03, 0.3])  # by the series, and by stretches
def test_beyond_it_the_stress_lands_on_the_cone_or_its_tip(real, rounding, size) -> None:
    F = gradients(256, size)
    E, loose, _ = returned(F, np.zeros((256, 1)), real)
    dev, trace = log_strains(E)
    before = log_strains(F)[1]
    # Logarithms of stretches by F^T F, some dozen operations, times 2 mu or 3 K.
    landing = 50 * rounding * 3.0 * BULK
    # The series of the near branch leaves 2 |Z|^7 / 7, see `hencky`.
    landing += 2.0 * MU * (1e-7 if real is np.float32 else 1e-14)
    assert excess(E).max() < landing
    pulled = before > TIP
    assert 20 < pulled.sum() < 236
    np.testing.assert_allclose(trace[pulled], TIP, atol=landing)
    assert dev[pulled].max() < landing
    np.testing.assert_allclose(trace[~pulled], before[~pulled], atol=landing)
    np.testing.assert_allclose(loose[pulled, 0], before[pulled] - TIP, atol=landing)
    assert np.abs(loose[~pulled, 0]).max() < landing


@pytest.mark.slow
def test_to_return_twice_is_to_return_once() -> None:
    E, loose, _ = returned(gradients(64, 0.3), np.zeros((64, 1)))
    closed = loose[:, 0] == 0.0
    again, after, _ = returned(E, loose)
    np.testing.assert_allclose(again, E, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(after[closed], loose[closed], rtol=0.0, atol=1e-14)


def test_it_turns_with_the_body_and_with_the_material() -> None:
    F, Q = gradients(64, 0.3), random_turns(64, 9)
    loose = np.random.default_rng(3).uniform(0.0, 0.1, (64, 1))
    E, after, _ = returned(F, loose)
    for turned, expected in ((Q @ F, Q @ E), (F @ Q, E @ Q)):
        seen, seen_after, _ = returned(turned, loose)
        np.testing.assert_allclose(seen, expected, rtol=0.0, atol=1e-13)
        np.testing.assert_allclose(seen_after, after, rtol=0.0, atol=1e-13)


def test_flow_dissipates_what_the_energy_loses_less_what_it_does_at_second_order() -> None:
    F = gradients(256, 0.1)
    loose = np.random.default_rng(3).uniform(0.0, 0.05, (256, 1))
    E, _, loss = returned(F, loose)
    assert (loss >= 0.0).all()
    before, after = (evaluate(LAW, G, MU, LAM)[0] for G in (F, E))
    assert (after <= before + 1e-15).all()
    (dev, trace), (left, t) = log_strains(F), log_strains(E)
    # psi* - psi - tau : (e* - e) = mu |de|^2 + K/2 (d tr)^2, since psi is quadratic in e
    rest = MU * (dev - left) ** 2 + 0.5 * BULK * (trace - t) ** 2
    np.testing.assert_allclose(before - after - loss, rest, atol=1e-13)


def test_what_came_apart_closes_before_it_bears_pressure() -> None:
    grown = np.exp(0.03) * np.eye(3)[None]
    E, loose, _ = returned(grown, np.zeros((1, 1)), cohesion=0.0)
    np.testing.assert_allclose(E[0], np.eye(3), atol=1e-15)
    assert loose[0, 0] == pytest.approx(0.09)
    half = np.exp(-0.02) * E  # of the 0.09, 0.06 close
    E, loose, _ = returned(half, loose, cohesion=0.0)
    np.testing.assert_allclose(E[0], np.eye(3), atol=1e-15)
    assert loose[0, 0] == pytest.approx(0.03)
    E, loose, _ = returned(np.exp(-0.02) * E, loose, cohesion=0.0)
    np.testing.assert_allclose(E[0], np.exp(-0.01) * np.eye(3), atol=1e-15)
    assert loose[0, 0] == pytest.approx(0.0, abs=1e-15)


def test_simple_shear_under_pressure_bears_friction_times_the_pressure() -> None:
    """An infinite slope: pressed on its plane, sheared along it, it bears tau = friction p."""
    F = np.exp(-0.01) * np.array([[[1.0, 0.2, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]])
    E, _, _ = returned(F, np.zeros((1, 1)), cohesion=0.0)
    B = E[0] @ E[0].T
    w, V = np.linalg.eigh(B)
    e = V @ np.diag(0.5 * np.log(w)) @ V.T
    tau = 2.0 * MU * e + LAM * np.trace(e) * np.eye(3)
    p = -np.trace(tau) / 3.0
    s = tau + p * np.eye(3)
    assert np.sqrt(0.5 * (s * s).sum()) == pytest.approx(FRICTION * p, rel=1e-12)


def test_faults_are_caught(monkeypatch) -> None:
    """A cone that is a tenth too wide, and no closing of what came apart."""
    from lane_kernels import compile_anew

    monkeypatch.setattr(drucker_prager, "ROOT", 1.1 * drucker_prager.ROOT)
    compile_anew()
    try:
        E, _, _ = returned(gradients(256, 0.3), np.zeros((256, 1)))
        assert excess(E).max() > 1e-3
    finally:
        monkeypatch.undo()
        compile_anew()
