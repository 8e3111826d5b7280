"""Floor contact: stiffness by three bounds, damping by restitution, the fastest vibration."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse
from scipy.integrate import solve_ivp
from solids import ball

from gf_usd.core.frames.particles import SurfaceSamples
from gf_usd.physics.contact.floor import (
    HALF_SPACE,
    REST_DEPTH,
    STOPPING_DISTANCE,
    build_contact,
    damping_coefficient,
    hertz_pressure,
    largest_eigenvalue,
    plane_modulus,
    stiffness_per_mass,  # fmt: skip
)
from gf_usd.physics.grid.reference.build import build_stencil


def rebound(k: float, m: float, c: float, *, sticky: bool) -> float:
    """Speed out over speed in of a lone mass on the floor's spring, integrated numerically.

    sticky : the spring pulls as well, down to depth 0; else it releases where its force is 0.
    """

    def rate(_, y):
        return [y[1], (-k * y[0] - c * y[1]) / m]

    def back(_, y):
        return y[0] if sticky else k * y[0] + c * y[1]

    back.terminal, back.direction = True, -1.0  # type: ignore[attr-defined]
    period = 2.0 * np.pi * np.sqrt(m / k)
    out = solve_ivp(rate, (0.0, 5.0 * period), [0.0, 1.0], events=back, rtol=1e-10, atol=1e-12)
    # y[0] is the depth: in at speed 1, out where the event fires for the first time.
    return -float(out.y_events[0][0][1])


@pytest.mark.parametrize("restitution", [0.99, 0.85, 0.5, 0.2])
@pytest.mark.parametrize(("k", "m"), [(1.0, 1.0), (4e5, 0.02)])
def test_a_lone_mass_leaves_with_the_restitution_asked_for(restitution, k, m):
    c = damping_coefficient(np.array([k]), np.array([m]), np.array([restitution]))[0]
    # The integrator's 1e-10 a step, over some hundred steps.
    assert rebound(k, m, c, sticky=True) == pytest.approx(restitution, abs=1e-7)
    # A floor that never pulls releases where its force is 0, sooner, and returns a little more
    # (Schwager and Poeschel 2007, eq. 21): .855 where .85 is required.
    z = c / (2.0 * np.sqrt(k * m))
    root = np.sqrt(1.0 - z * z)
    more = np.exp(-z / root * (np.pi - np.arctan2(2.0 * z * root, 1.0 - 2.0 * z * z)))
    assert rebound(k, m, c, sticky=False) == pytest.approx(more, abs=1e-7)
    assert more > restitution


def test_the_ends_of_the_damping_range():
    k, m = np.array([9.0, 9.0]), np.array([4.0, 4.0])
    none, most = damping_coefficient(k, m, np.array([1.0, 0.0]))
    assert none == 0.0
    # ln 0 is cut at 1e-6: 13.8 / sqrt(pi^2 + 13.8^2) = .975 of the critical 2 sqrt(k m).
    assert most == pytest.approx(0.975 * 2.0 * np.sqrt(36.0), rel=1e-3)


def test_hertz_pressure_agrees_with_radius_and_load_of_the_contact():
    W, R, E, nu = 30.0, 0.4, 2e5, 0.3
    effective = E / (1.0 - nu**2)
    a = np.cbrt(3.0 * W * R / (4.0 * effective))  # Johnson 1985, eq. 4.22
    p0 = hertz_pressure(weight=W, radius=R, modulus=plane_modulus(np.array([E]), np.array([nu])))
    assert p0[0] == pytest.approx(1.5 * W / (np.pi * a**2), rel=1e-14)  # mean is 2/3 of the peak


def test_the_stiffness_meets_each_of_its_three_purposes():
    E, s, v = np.array([4e5, 1e3, 1e3]), 0.05, np.array([0.1, 9.0, 0.1])
    p, rho = np.array([1.0, 1.0, 5e4]), np.array([1e3, 1e3, 1e3])
    got = np.array(
        [
            stiffness_per_mass(
                modulus=E[i : i + 1], spacing=s, impact_speed=v[i],
                pressure=p[i : i + 1], density=rho[i : i + 1],
            )[0]
            for i in range(3)
        ]
    )  # fmt: skip
    # Per area it is 1.3 E* / s, of m = rho A s.
    assert rho[0] * s * got[0] == pytest.approx(HALF_SPACE * E[0] / s)
    # m v^2 / 2 = k d^2 / 2: stopped within a quarter of a spacing.
    assert v[1] / np.sqrt(got[1]) == pytest.approx(STOPPING_DISTANCE * s)
    # A sample of mass rho A s under p A sinks by p / (rho s k/m).
    assert p[2] / (rho[2] * s * got[2]) == pytest.approx(REST_DEPTH * s)
    assert REST_DEPTH <= 0.1  # what a body at rest is promised


@pytest.fixture(scope="module")
def built():
    particles, samples = ball(600)
    m = 1000.0 * particles.V0
    stencil = build_stencil(particles.X, m, 2.0 * particles.lattice, particles.corner)
    n = len(samples.X)
    contact = build_contact(
        samples, stencil, spacing=particles.spacing, density=np.full(n, 1000.0),
        modulus=np.full(n, 4e5), friction=np.array(0.8), restitution=np.full(n, 0.85),
        impact_speed=5.0, pressure=np.full(n, 2e4),
    )  # fmt: skip
    return particles, samples, stencil, contact


def test_samples_stand_for_a_layer_one_spacing_thick(built):
    particles, samples, _, contact = built
    np.testing.assert_allclose(contact.mass, 1000.0 * samples.area * particles.spacing, rtol=1e-14)
    assert contact.mass.sum() == pytest.approx(1000.0 * 4.0 * np.pi * particles.spacing, rel=0.01)
    ratio = contact.stiffness / contact.mass
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-12)
    assert contact.friction.shape == contact.mass.shape


def test_a_given_rate_replaces_the_formula(built):
    particles, samples, stencil, contact = built
    n = len(samples.X)
    soft = build_contact(
        samples, stencil, spacing=particles.spacing, density=np.full(n, 1000.0),
        modulus=np.full(n, 4e5), friction=np.array(0.8), restitution=np.full(n, 0.85),
        impact_speed=5.0, pressure=np.full(n, 2e4), rate=2000.0,
    )  # fmt: skip
    np.testing.assert_allclose(soft.stiffness, 2000.0 * soft.mass, rtol=1e-14)
    assert soft.omega2 < contact.omega2


def test_the_fastest_vibration_of_the_floor_is_bounded_closely(built):
    _, _, stencil, contact = built
    W, root = contact.rows.W.toarray(), 1.0 / np.sqrt(stencil.mass)
    for values, bound in (
        (contact.stiffness, contact.omega2),
        (contact.damping, contact.damping_rate),
    ):
        S = root[:, None] * (W.T @ (values[:, None] * W)) * root
        true = np.linalg.eigvalsh(S)[-1]
        # Iteration stops at a residual of 1 %, which is added; it starts off every eigenvector.
        assert true <= bound <= 1.05 * true


@pytest.mark.parametrize("seed", range(5))
def test_the_bound_holds_for_any_rows(seed):
    rng = np.random.default_rng(seed)
    W = sparse.random(80, 40, density=0.1, random_state=seed, format="csr")
    k, m = rng.uniform(0.1, 10.0, 80), rng.uniform(0.1, 10.0, 40)
    root = 1.0 / np.sqrt(m)
    dense = W.toarray()
    true = np.linalg.eigvalsh(root[:, None] * (dense.T @ (k[:, None] * dense)) * root)[-1]
    assert true * (1.0 - 1e-12) <= largest_eigenvalue(W, k, m) <= 1.1 * true


def test_no_samples_no_vibration():
    assert largest_eigenvalue(sparse.csr_matrix((0, 4)), np.zeros(0), np.ones(4)) == 0.0


def test_samples_out_of_reach_of_any_particle_still_have_rows(built):
    _, _, stencil, _ = built
    far = SurfaceSamples(X=np.array([[0.0, -1.8, 0.0]]), area=np.ones(1))
    out = build_contact(
        far, stencil, spacing=0.1, density=np.ones(1), modulus=np.ones(1),
        friction=np.zeros(1), restitution=np.ones(1), impact_speed=0.0, pressure=np.zeros(1),
    )  # fmt: skip
    assert out.rows.W.sum() == pytest.approx(1.0, abs=1e-10)
    assert np.isfinite(out.omega2)
