"""Every registered law: gradient, objectivity, isotropy, rest state, and what it does at J <= 0."""

from __future__ import annotations

import numpy as np
import pytest
from flowing import ROW, registered
from lane_kernels import alike, evaluate, flow_with_loss, rotations
from random_turns import random_turns

from gf_usd.core.materials.laws import LAWS, LawSpec
from gf_usd.physics.laws.neo_hookean import J_EXTENSION
from gf_usd.physics.laws.registry import load

MU, LAM = 2.0, 3.0  # [Pa] of order one: stresses and their rounding are then of order one too
every_law = pytest.mark.parametrize("token", [*LAWS, ROW.token])


@pytest.fixture(autouse=True)
def _with_a_law_that_flows():
    """Its row in the registry, below yield: it is held to all that the others are."""
    with registered():
        yield


def turns(n: int, seed: int) -> np.ndarray:
    """(n, 3, 3) random rotations."""
    return random_turns(n, seed)


def gradients(stretches: np.ndarray, seed: int = 0) -> np.ndarray:
    """F = U diag(s) V^T with random rotations U, V for signed stretches (n, 3)."""
    U, V = turns(len(stretches), seed), turns(len(stretches), seed + 1)
    return (U * stretches[:, None, :]) @ V.swapaxes(1, 2)


def stretches(n: int, seed: int, inverted: bool) -> np.ndarray:
    """(n, 3) stretches .3 .. 1.7 whose smallest lies .2 under the next, negative where inverted.

    The gap keeps clear of s2 + s3 = 0, where the nearest rotation jumps.
    """
    s = np.sort(np.random.default_rng(seed).uniform(0.5, 1.7, (n, 3)), 1)[:, ::-1].copy()
    s[:, 2] -= 0.2
    return s * np.where(inverted, [1.0, 1.0, -1.0], 1.0)


def samples() -> np.ndarray:
    """64 gradients: upright, inverted, and on both sides of the place where ln J is continued."""
    flat = np.stack([np.full(16, 1.1), np.full(16, 0.9), np.linspace(0.05, 0.2, 16)], 1)
    assert (flat.prod(1) < J_EXTENSION).any()
    assert (flat.prod(1) > J_EXTENSION).any()
    s = [stretches(24, 1, False), stretches(24, 2, True), flat]
    return gradients(np.concatenate(s))


def relative(error: np.ndarray, value: np.ndarray) -> float:
    """Largest error of a particle over its own largest value, or over the moduli where it has less.

    error, value : (n, ...).
    """
    n = len(value)
    size = np.maximum(np.abs(value.reshape(n, -1)).max(1), MU)
    return float((np.abs(error.reshape(n, -1)).max(1) / size).max())


def test_every_row_has_its_code():
    assert all(law.token == token for token, law in LAWS.items())
    assert [load(row).spec for row in LAWS.values()] == list(LAWS.values())


def test_a_row_and_a_module_that_disagree_are_refused():
    with pytest.raises(ValueError, match="flows=True"):
        load(LawSpec(token="corotated", code=".corotated", source="", flows=True))


@every_law
def test_stress_is_the_gradient_of_the_energy(token):
    F = samples()
    step = 1e-5
    bumps = step * np.eye(9).reshape(9, 3, 3)
    high = evaluate(token, (F[:, None] + bumps).reshape(-1, 3, 3), MU, LAM)[0]
    low = evaluate(token, (F[:, None] - bumps).reshape(-1, 3, 3), MU, LAM)[0]
    slope = ((high - low) / (2.0 * step)).reshape(-1, 3, 3)
    P = evaluate(token, F, MU, LAM)[1]
    # Truncation is step^2 / 6 times the third derivative: at J0 = .1, the steepest place, some
    # lam ln(J0) 2 / J0^3 + 3 lam / J0^3 = 2e4 on a stress of lam ln(J0) / J0 = 70, thus 5e-9 of
    # it.  Rounding is 1e-16 psi / step = 1e-11 psi, and psi is at most ten times the stress.
    assert relative(P - slope, P) < 2e-8


@every_law
def test_turning_the_body_turns_the_stress_and_keeps_the_energy(token):
    F, Q = samples(), turns(64, 7)
    psi, P = evaluate(token, F, MU, LAM)
    psi_turned, P_turned = evaluate(token, Q @ F, MU, LAM)
    # Rounding of 1e-16 in four dozen operations, amplified by dln(J) / dJ = 1 / J0 = 10.
    assert relative(psi_turned - psi, psi) < 5e-14
    assert relative(P_turned - Q @ P, P) < 5e-14


@every_law
def test_turning_the_material_first_makes_no_difference(token):
    F, Q = samples(), turns(64, 8)
    psi, P = evaluate(token, F, MU, LAM)
    psi_turned, P_turned = evaluate(token, F @ Q, MU, LAM)
    assert relative(psi_turned - psi, psi) < 5e-14  # as above
    assert relative(P_turned - P @ Q, P) < 5e-14


@every_law
def test_no_stress_and_no_energy_at_rest_however_turned(token):
    psi, P = evaluate(token, np.concatenate([np.eye(3)[None], turns(7, 3)]), MU, LAM)
    assert psi[0] == 0.0
    assert (P[0] == 0.0).all()
    np.testing.assert_allclose(psi, 0.0, atol=1e-14)  # rounding of |F|^2 - 3
    np.testing.assert_allclose(P, 0.0, atol=1e-14)


@every_law
def test_energy_of_stretches_is_that_of_the_gradient(token):
    spread = np.concatenate([stretches(24, 1, False), stretches(24, 2, True)])
    psi = evaluate(token, gradients(spread), MU, LAM)[0]
    stored = alike(token, len(spread), MU, LAM).stored(spread, spread.prod(1))
    assert relative(stored - psi, psi) < 3e-14  # rounding of a dozen operations, as above


@every_law
def test_energy_is_least_at_rest(token):
    psi = evaluate(token, samples(), MU, LAM)[0]
    # Upright stretches of the samples are at least .1 off 1 somewhere: psi >= mu .1^2 / 2.
    assert psi.min() > 0.0


@every_law
def test_small_strains_follow_hooke_with_the_moduli_given(token):
    size = 1e-6
    e = np.random.default_rng(5).uniform(-size, size, (16, 3, 3))
    P = evaluate(token, np.eye(3) + e, MU, LAM)[1]
    sym = 0.5 * (e + e.swapaxes(1, 2))
    hooke = 2.0 * MU * sym + LAM * np.trace(sym, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    # The next term of the series is of order (lam + mu) 9 size^2 = 5e-11.
    np.testing.assert_allclose(P, hooke, rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("token", [*(token for token, row in LAWS.items() if row.flows), ROW.token])
def test_no_law_flows_where_a_body_is_slightly_pressed_from_all_sides(token):
    F = 0.995 * np.concatenate([np.eye(3)[None], turns(7, 9)])
    rest = np.tile([value.rest for value in LAWS[token].internal], (len(F), 1))
    E, after, loss = flow_with_loss(token, F, rest, MU, LAM, dt=1e-3)
    # Less than the compression of which snow is compacted.  A fluid bears no shear, of which
    # the rounding of a turned gradient is some.
    np.testing.assert_allclose(E, F, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(after, rest, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(loss, 0.0, atol=1e-30)


@every_law
@pytest.mark.parametrize("real", [np.float64, np.float32])
def test_collapsed_and_inverted_particles_stay_finite(token, real):
    lines = np.zeros((3, 3))
    lines[0, 0] = 1.0
    F = np.stack(
        [
            np.zeros((3, 3)), lines, np.diag([1.0, 1.0, 0.0]), np.ones((3, 3)), -np.eye(3),
            np.diag([1.0, 1.0, -1.0]), np.diag([-2.0, -2.0, -2.0]), 1e-6 * np.eye(3),
            -1e-6 * np.eye(3), 1e3 * np.eye(3), np.diag([1e-6, 1e3, 1.0]), np.diag([1.0, 1e-6, 0]),
        ]
    )  # fmt: skip
    psi, P = evaluate(token, F, MU, LAM, real)
    assert np.isfinite(psi).all()
    assert np.isfinite(P).all()


@every_law
def test_a_flattened_particle_is_pushed_back_up(token):
    # Squashed along one axis to nothing, and through itself: P_zz < 0 makes it grow again.
    s = np.array([0.5, 0.1, 0.01, -0.01, -0.1])
    F = np.zeros((len(s), 3, 3))
    F[:, 0, 0] = F[:, 1, 1] = 1.0
    F[:, 2, 2] = s
    assert (evaluate(token, F, MU, LAM)[1][:, 2, 2] < 0.0).all()


@pytest.mark.parametrize(
    ("real", "tolerance"),
    # R is as sharp as rounding over s2 + s3 >= .2, that is 5 u, times a few dozen operations.
    [(np.float64, 5e-14), (np.float32, 1e-5)],
)
def test_the_rotation_is_that_of_the_signed_svd(real, tolerance):
    spread = np.concatenate([stretches(200, 3, False), stretches(200, 4, True)])
    F = gradients(spread, seed=11)
    U, _, Vt = np.linalg.svd(F)
    U[:, :, 2] *= np.linalg.det(U @ Vt)[:, None]
    R = rotations(F, real)
    np.testing.assert_allclose(R, U @ Vt, rtol=0.0, atol=tolerance)


def test_the_rotation_of_strongly_stretched_particles_converges():
    # Ratios of 1e4 are what the scaling of the Newton iteration is there for.
    s = np.exp(np.random.default_rng(6).uniform(-4.6, 4.6, (64, 3)))
    F = gradients(s, seed=13)
    R = rotations(F)
    S = R.swapaxes(1, 2) @ F
    scale = np.abs(S).max((1, 2), keepdims=True)
    # R^T F symmetric and positive is what makes R the polar rotation; 1e-16 times 24 iterations,
    # times the condition 1e4.
    np.testing.assert_allclose((S - S.swapaxes(1, 2)) / scale, 0.0, atol=1e-11)
    np.testing.assert_allclose(R.swapaxes(1, 2) @ R, np.eye(3) + 0.0 * R, atol=1e-13)
    assert (np.linalg.eigvalsh(0.5 * (S + S.swapaxes(1, 2))) > 0.0).all()
