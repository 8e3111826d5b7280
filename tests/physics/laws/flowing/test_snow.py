"""Snow: the clamp of its stretches, what it keeps, how it hardens, and what that dissipates."""

from __future__ import annotations

import numpy as np
import pytest
from lane_kernels import compile_anew, evaluate, flow_with_loss
from random_turns import random_turns

from gf_usd.core.materials.laws import LAWS
from gf_usd.physics.laws.flowing import snow
from gf_usd.physics.laws.registry import law_set, load

LAW = "snow"
MU, LAM = 2.0, 3.0  # [Pa]
DOWN, UP, XI = 0.025, 0.0075, 10.0
PRESSED, TORN = -0.3, 0.3  # logarithmic stretches, at most


def turns(n: int, seed: int) -> np.ndarray:
    return random_turns(n, seed)


def gradients(n: int, low: float, high: float, seed: int = 0) -> np.ndarray:
    s = np.exp(np.random.default_rng(seed).uniform(low, high, (n, 3)))
    return (turns(n, seed + 1) * s[:, None, :]) @ turns(n, seed + 2).swapaxes(1, 2)


def returned(F, Jp, real: type = np.float64, lam: float = LAM):
    own = {"critical_compression": DOWN, "critical_stretch": UP, "hardening_coefficient": XI}
    return flow_with_loss(LAW, F, Jp, MU, lam, real, **own)


def stretches(F: np.ndarray) -> np.ndarray:
    return np.linalg.svd(F)[1]


def hardness(Jp: np.ndarray) -> np.ndarray:
    return np.minimum(np.exp(XI * (1.0 - Jp[:, 0])), snow.HARDEST)


@pytest.mark.parametrize("real", [np.float64, np.float32])
def test_within_the_critical_stretches_nothing_changes_not_a_bit(real: type) -> None:
    F = gradients(64, np.log(1.0 - 0.9 * DOWN), np.log(1.0 + 0.9 * UP)).astype(real)
    Jp = np.random.default_rng(4).uniform(0.7, 1.5, (64, 1)).astype(real)
    E, after, loss = returned(F, Jp, real)
    assert np.array_equal(E, F)
    assert np.array_equal(after, Jp)
    assert not loss.any()


@pytest.mark.parametrize(("real", "rounding"), [(np.float64, 2e-16), (np.float32, 1e-7)])
def test_stretches_are_clamped_and_the_rest_is_plastic(real: type, rounding: float) -> None:
    F = gradients(256, PRESSED, TORN)
    U, s, Vt = np.linalg.svd(F)
    Jp = np.random.default_rng(4).uniform(0.7, 1.5, (256, 1))
    E, after, _ = returned(F.astype(real), Jp.astype(real), real)
    clamped = np.clip(s, 1.0 - DOWN, 1.0 + UP)
    # stretches by F^T F, a few dozen operations on numbers of order 1
    near = 100 * rounding
    np.testing.assert_allclose(E, (U * clamped[:, None, :]) @ Vt, rtol=0.0, atol=near)
    whole = np.linalg.det(F) * Jp[:, 0]
    np.testing.assert_allclose(np.linalg.det(E) * after[:, 0], whole, rtol=near, atol=0.0)


@pytest.mark.slow
def test_what_is_inside_out_returns_upright() -> None:
    F = gradients(64, PRESSED, TORN)
    F[:, :, 0] *= -1.0
    E, after, _ = returned(F, np.ones((64, 1)))
    assert np.linalg.det(E).min() > 0.9
    assert (after > 0.0).all()
    np.testing.assert_allclose(stretches(E).min(1), 1.0 - DOWN, atol=1e-13)


@pytest.mark.slow
def test_to_return_twice_is_to_return_once() -> None:
    E, Jp, _ = returned(gradients(64, PRESSED, TORN), np.ones((64, 1)))
    again, after, _ = returned(E, Jp)
    np.testing.assert_allclose(again, E, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(after, Jp, rtol=1e-14)


def test_it_turns_with_the_body_and_with_the_material() -> None:
    F, Q = gradients(64, PRESSED, TORN), turns(64, 9)
    E, after, loss = returned(F, np.ones((64, 1)))
    for turned, expected in ((Q @ F, Q @ E), (F @ Q, E @ Q)):
        seen, seen_after, lost = returned(turned, np.ones((64, 1)))
        np.testing.assert_allclose(seen, expected, rtol=0.0, atol=1e-13)
        np.testing.assert_allclose(seen_after, after, rtol=1e-13)
        np.testing.assert_allclose(lost, loss, rtol=1e-11, atol=1e-14)


@pytest.mark.parametrize(("low", "high"), [(PRESSED, -0.03), (0.01, TORN)])
def test_compaction_and_tearing_dissipate(low: float, high: float) -> None:
    _, _, loss = returned(gradients(256, low, high), np.ones((256, 1)))
    assert loss.min() > 0.0


def test_without_lateral_stress_every_clamp_dissipates() -> None:
    """In compression and tension at once only lam can gain: with nu = 0 nothing does."""
    _, Jp, loss = returned(gradients(256, PRESSED, TORN), np.ones((256, 1)), lam=0.0)
    torn = Jp[:, 0] > 1.0
    assert 50 < torn.sum() < 206
    assert loss.min() > 0.0


def test_the_work_is_that_of_what_remains_less_what_hardening_stores() -> None:
    F = gradients(256, PRESSED, TORN)
    Jp = np.random.default_rng(4).uniform(0.7, 1.5, (256, 1))
    E, after, loss = returned(F, Jp)
    psi, P = evaluate(LAW, E, MU, LAM)
    expected = hardness(after) * (P * (F - E)).sum((1, 2))
    expected -= (hardness(after) - hardness(Jp)) * psi
    np.testing.assert_allclose(loss, expected, rtol=1e-10, atol=1e-13)


def test_a_stretch_next_to_compression_gains_and_that_is_counted() -> None:
    """The clamp is not an associated flow: P along the stretch is below 0 where J_e < 1."""
    E, _, loss = returned(np.diag([1.05, 0.98, 0.98])[None], np.ones((1, 1)), lam=LAM)
    P = evaluate(LAW, E, MU, LAM)[1]
    assert P[0, 0, 0] < 0.0
    assert loss[0] < 0.0
    assert not LAWS[LAW].associated


def test_hardness_is_the_same_in_both_languages_and_bounded() -> None:
    Jp = np.array([[0.2], [0.6], [0.9], [1.0], [1.5], [30.0]])
    q = np.array([[MU], [LAM], [DOWN], [UP], [XI]]) * np.ones(6)
    np.testing.assert_allclose(snow.hardnesses(q, Jp), hardness(Jp), rtol=1e-14)
    assert snow.hardnesses(q, Jp)[0] == snow.HARDEST
    assert law_set((LAWS[LAW],)).hardens
    assert load(LAWS[LAW]).hardness is snow.hardness
    assert not law_set((LAWS["vonMises"],)).hardens


def test_faults_are_caught(monkeypatch) -> None:
    """Limits that are a tenth too wide."""
    whole = snow.stretches

    def narrow(F):
        s, V = whole(F)
        return [0.999 * s[0], s[1], s[2]], V

    import taichi as ti

    monkeypatch.setattr(snow, "stretches", ti.func(narrow))
    compile_anew()
    try:
        E, _, _ = returned(gradients(64, PRESSED, TORN), np.ones((64, 1)))
        assert (np.abs(np.clip(stretches(E), 1.0 - DOWN, 1.0 + UP) - stretches(E)) > 5e-4).any()
    finally:
        monkeypatch.undo()
        compile_anew()
