"""The stable step: its formula on an oscillator, its frequency on the real operators."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import eigsh
from solids import ball

from gf_usd.physics.grid.dependent_nodes import FREE_MASS
from gf_usd.physics.grid.reference.build import build_stencil
from gf_usd.physics.time_step import (
    CLOSE,
    GRID_FREQUENCY,
    MARGIN,
    StableStep,
    grid_frequency,
    stable_step,
)

GRID = {"wave_speed": 3.0, "h": 0.1, "per_cell": 8.0}


def step(**changes: float) -> StableStep:
    values = {
        **GRID, "viscous_time": 0.0, "contact_omega2": 0.0, "contact_damping": 0.0, "safety": 1.0,
    }  # fmt: skip
    return stable_step(**{**values, **changes})


def swing(w: float, z: float, dt: float, steps: int = 4000) -> float:
    """Largest |x| over the last tenth of a damped oscillator stepped as the solver steps."""
    x, v, most = 1.0, 0.0, 0.0
    for k in range(steps):
        v += dt * (-(w**2) * x - 2.0 * z * w * v)
        x += dt * v
        if k >= 0.9 * steps:
            most = max(most, abs(x))
        if abs(x) > 1e6:
            return abs(x)
    return most


@pytest.mark.parametrize("viscous_time", [0.0, 1e-3, 1e-2, 0.1])
@pytest.mark.parametrize("contact", [0.0, 1e4])
def test_an_oscillator_is_stable_below_the_limit_and_not_above(viscous_time, contact):
    limit = step(viscous_time=viscous_time, contact_omega2=contact, contact_damping=0.1 * contact)
    w = np.hypot(limit.elastic, limit.contact)
    z = limit.damping_ratio
    # Just under the limit undamped steps swing with amplitude 1 / sqrt(1 - .99^2) = 7.
    assert swing(w, z, 0.99 * limit.dt) < 10.0
    # Just over it the growth is exp(2 acosh(1.05)) = 1.9 a step undamped, and any damping ratio
    # leaves some per cent a step.
    assert swing(w, z, 1.05 * limit.dt) > 1e6


def test_the_factor_of_contact_is_that_of_the_steps_with_and_without():
    assert step(viscous_time=0.01).contact_factor == 1.0
    for more in ({"contact_omega2": 1e8}, {"contact_damping": 5e4}):
        factor = step(**more).contact_factor
        assert factor == pytest.approx(step().dt / step(**more).dt)
        assert factor > 10.0


def test_each_of_its_parts_shortens_the_step():
    base = step()
    assert base.dt == pytest.approx(2.0 / (grid_frequency(8.0) * 3.0 / 0.1))
    assert base.damping_ratio == 0.0
    assert step(viscous_time=0.01).dt < base.dt
    assert step(contact_omega2=1e4).dt < base.dt
    assert step(contact_damping=50.0).dt < base.dt
    assert step(per_cell=3.0).dt < base.dt
    assert step(safety=0.5).dt == pytest.approx(0.5 * base.dt)


def test_safety_is_for_the_body_and_a_margin_for_contact():
    alone = step(safety=0.5)
    # Springs of contact as stiff as the body: 1 / sqrt(2) of its limit is more than safety leaves.
    like = step(safety=0.5, contact_omega2=alone.elastic**2)
    assert like.dt == pytest.approx(alone.dt)
    stiffer = step(safety=0.5, contact_omega2=8.0 * alone.elastic**2)
    assert stiffer.dt == pytest.approx(MARGIN * 2.0 / (3.0 * alone.elastic))


def test_contact_alone_obeys_the_limit_of_its_own_spring():
    # A nearly slack body: dt -> 2 / sqrt(k/m).
    alone = step(wave_speed=1e-9, contact_omega2=400.0)
    assert alone.dt == pytest.approx(0.1, rel=1e-6)


def test_fewer_particles_a_cell_are_never_given_more():
    bounds = [grid_frequency(n) for n in (20.0, 8.0, 4.0, 3.9, 1.0, 0.9, 0.45)]
    assert bounds == sorted(bounds)
    assert {b for _, b in GRID_FREQUENCY} == set(bounds)


def operators(per_cell: float, nu: float, seed: int):
    """M^-1/2 K M^-1/2 of the linearized body and its shear part alone, with c = h = 1.

    K is the derivative of the nodal forces -sum V0 P(F) G at rest: P = 2 mu sym + lam tr.
    """
    particles, _ = ball(700, seed=seed)
    h = float(np.cbrt(per_cell * particles.volume / len(particles)))
    # Below one a cell there is only the paper's set-up, where every node is free.
    free_mass = FREE_MASS if per_cell >= 1.0 else 0.0
    made = build_stencil(particles.X, particles.V0, h, particles.corner, free_mass=free_mass)
    G = made.rows(particles.X).G
    lam = nu / (1.0 - nu)  # of lam + 2 mu = 1
    mu = 0.5 * (1.0 - lam)
    V = sparse.diags_array(particles.V0)
    A = [[(G[a].T @ V @ G[b]).tocsr() for b in range(3)] for a in range(3)]
    trace = A[0][0] + A[1][1] + A[2][2]
    # 2 mu sym(grad u) : sym(grad w) = mu (u_a,b w_a,b + u_b,a w_a,b)
    shear = sparse.block_array(
        [[mu * ((a == b) * trace + A[b][a]) for b in range(3)] for a in range(3)], format="csr"
    )
    bulk = sparse.block_array([[lam * A[a][b] for b in range(3)] for a in range(3)], format="csr")
    root = sparse.diags_array(np.tile(1.0 / np.sqrt(made.mass), 3))
    return h, lam, mu, root @ (shear + bulk) @ root, root @ shear @ root


def top(S: sparse.csr_array) -> float:
    """Largest eigenvalue of a symmetric matrix."""
    start = np.random.default_rng(0).normal(size=S.shape[0])
    return float(eigsh(S, k=1, which="LA", v0=start, tol=1e-6, return_eigenvectors=False)[0])


@pytest.mark.parametrize("per_cell", [8.0, 4.0, 0.45])
@pytest.mark.parametrize("nu", [0.17, 0.42])  # rubber's and metal's
@pytest.mark.parametrize("seed", [0, 1])
def test_no_vibration_of_a_ball_is_faster_than_the_bound(per_cell, nu, seed):
    h, _, _, S, _ = operators(per_cell, nu, seed)
    fastest = h * np.sqrt(top(S))
    bound = grid_frequency(per_cell)
    assert fastest <= bound
    # A bound that is twice what is needed would halve every step for nothing.
    assert fastest > 0.5 * bound


@pytest.mark.parametrize("nu", [0.17, 0.42])
def test_no_vibration_is_damped_faster_than_the_step_allows_for(nu):
    h, lam, mu, _, shear = operators(8.0, nu, 0)
    tau = 0.3
    # Kelvin-Voigt adds the rate 2 mu tau sym: its operator is tau times the shear stiffness.
    viscous_time = tau * 2.0 * mu / (lam + 2.0 * mu)
    limit = step(wave_speed=1.0, h=h, viscous_time=viscous_time)
    assert tau * top(shear) <= 2.0 * limit.damping_ratio * limit.elastic


@pytest.mark.parametrize("strained", [2.5, 10.0, 300.0])
@pytest.mark.parametrize("contact", [30.0, 3e3, 3e5])
def test_contact_of_a_strained_body_takes_the_substeps_of_both_frequencies(strained, contact):
    """Frequencies add up as squares: the springs of contact and the stiffness by strain."""
    rest = step(safety=0.5)
    w = strained * rest.elastic
    dt = 0.99 * 2.0 / w
    by = rest.substeps_with_contact(dt, replace(rest, contact=contact).contact_share)
    both = np.hypot(w, contact)
    assert swing(both, 0.0, dt / by) < 20.0
    # and few more: (1 + sqrt(1 + 4 a)) / 2 is at most 1.21 sqrt(1 + a); MARGIN on the springs
    assert by < 1.21 * CLOSE * np.hypot(w, contact / MARGIN) / w


@pytest.mark.parametrize("z", [0.0, 0.1, 1.0, 20.0])
@pytest.mark.parametrize("contact", [0.1, 1.0, 30.0])
@pytest.mark.parametrize("damping", [0.0, 0.1, 1.0, 20.0])
def test_contact_of_a_damped_strained_body_is_stable(z, contact, damping):
    """z : of the strained body; contact : its frequency over that of the body; damping : ratio."""
    rest = step(viscous_time=1e-4, safety=0.5)
    w = 8.0 * rest.elastic
    dt = 2.0 / w * (np.sqrt(1.0 + z * z) - z)
    wc = contact * w
    springs = replace(rest, contact=wc, contact_damping=2.0 * damping * wc)
    short = dt / rest.substeps_with_contact(dt, springs.contact_share)
    c = 2.0 * z * w + 2.0 * damping * wc
    assert 0.25 * (w * w + wc * wc) * short**2 + 0.5 * c * short <= 1.0
    both = np.hypot(w, wc)
    assert swing(both, 0.5 * c / both, 0.99 * short) < 20.0


@pytest.mark.parametrize("contact", [0.0, 1.0, 3.0, 30.0])
@pytest.mark.parametrize("damping", [0.0, 0.3, 3.0])
def test_a_body_at_rest_takes_its_step_with_the_springs_or_a_little_less(contact, damping):
    rest = step(safety=0.5, viscous_time=1e-4)
    wc = contact * rest.elastic
    springs = replace(rest, contact=wc, contact_damping=2.0 * damping * wc)
    needed = max(1.0, rest.dt / springs.dt)
    by = rest.substeps_with_contact(rest.dt, springs.contact_share)
    assert needed <= 1.000001 * by
    assert by <= 1.000001 * CLOSE * needed


def test_springs_and_dampers_of_different_samples_do_not_add_up():
    """Two unit masses, one on a spring and one on a damper."""
    rest = step(safety=0.5)
    k, c = (6.0 * rest.elastic) ** 2, 9.0 * rest.elastic

    def share(dt: float) -> float:
        return float(max(0.25 * dt * dt * k, 0.5 * dt * c))

    by = rest.substeps_with_contact(rest.dt, share)
    both = replace(rest, contact=np.sqrt(k), contact_damping=c)
    assert by < 0.85 * rest.dt / both.dt
    short = rest.dt / by
    assert (0.5 * rest.elastic * short) ** 2 + share(short) <= MARGIN
    K, C = np.diag([k, 0.0]), np.diag([0.0, c])
    x, v = np.ones(2), np.ones(2)
    for _ in range(300):
        v -= short * (K @ x + C @ v)
        x += short * v
    assert np.abs(v[0]) < 20.0 * np.sqrt(k)
    assert np.abs(v[1]) < 1e-6


@pytest.mark.parametrize("safety", [0.5, 0.9, 1.0])
def test_without_springs_it_takes_no_more_substeps(safety):
    rest = step(safety=safety)
    assert rest.substeps_with_contact(rest.dt, lambda _: 0.0) == pytest.approx(1.0)


@pytest.mark.parametrize("strain", [1.0, 1.5, 1.9])
@pytest.mark.parametrize("contact", [0.3, 1.0, 10.0])
def test_a_body_that_its_strain_makes_stiffer_within_its_safety_is_stable_with_springs(
    strain, contact
):
    rest = step(safety=0.5, viscous_time=1e-4, contact_omega2=1e3, contact_damping=2.0)
    stiff = replace(rest, elastic=strain * rest.elastic, safety=1.0)
    stiff = replace(stiff, viscous_time=rest.viscous_time / strain**2)  # the damping rate stays
    springs = replace(rest, contact=contact * rest.elastic, contact_damping=5.0)
    assert rest.dt <= stiff.dt
    by = rest.substeps_with_contact(rest.dt, springs.contact_share, stiff.dt)
    short, rate = rest.dt / by, rest.viscous_time * rest.elastic**2
    part = (0.5 * stiff.elastic * short) ** 2 + 0.5 * rate * short
    assert part + springs.contact_share(short) <= 1.0
    without = rest.substeps_with_contact(rest.dt, springs.contact_share)
    assert without <= by < 1.7 * without
    assert rest.substeps_with_contact(rest.dt, lambda _: 0.0, stiff.dt) == pytest.approx(1.0)
