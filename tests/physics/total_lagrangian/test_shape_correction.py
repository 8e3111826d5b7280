"""F from the positions once a frame, and the shape correction; and all options at once."""

from __future__ import annotations

import numpy as np
import pytest
from solids import preset_material, settings
from strained_ball import EXACT, SQUASH, body, made, shear_modulus, strain

from gf_usd.core.errors import UsageError
from gf_usd.core.neighbors import slopes
from gf_usd.core.stage import Pin
from gf_usd.physics.total_lagrangian.energies import elastic_energy
from gf_usd.physics.total_lagrangian.limits import DEFAULT, options_of
from gf_usd.physics.total_lagrangian.shape_correction import wls_gradient

# WLS


def test_wls_is_exact_for_affine_maps():
    X = body().X
    D = wls_gradient(X, 0.2 * body().radius)
    x = X @ SQUASH.T + [3.0, -1.0, 2.0]
    F = slopes(D, x)
    # The weights of the farthest neighbors are e^-10 of the nearest: the moments lose as much.
    np.testing.assert_allclose(F, np.broadcast_to(SQUASH, F.shape), atol=1e-9)


def test_wls_is_a_least_squares_fit():
    # Against numpy's own solution for one particle, of values that are not affine.
    X, width = body().X, 0.2 * body().radius
    x = X + 0.1 * np.sin(3.0 * X[:, [1, 2, 0]])
    F = slopes(wls_gradient(X, width), x)
    p = 17
    distance = np.linalg.norm(X - X[p], axis=1)
    near = np.argsort(distance)[1:21]
    root = np.exp(-0.25 * (distance[near] / width) ** 2)[:, None]
    wanted = np.linalg.lstsq(root * (X[near] - X[p]), root * (x[near] - x[p]), rcond=None)[0].T
    np.testing.assert_allclose(F[p], wanted, atol=1e-9)


def test_wls_leaves_out_a_direction_without_particles():
    # Particles in a plane say nothing of what happens across it.
    X = np.random.default_rng(0).uniform(size=(60, 3)) * [1.0, 1.0, 0.0]
    D = wls_gradient(X, 0.2)
    x = X * [2.0, 1.0, 1.0]
    F = slopes(D, x)
    np.testing.assert_allclose(F, np.broadcast_to(np.diag([2.0, 1.0, 0.0]), F.shape), atol=1e-9)


def test_wls_of_few_particles():
    # Fewer than there should be neighbors, two of them at one place.
    X = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1], [1, 1, 1]], float)
    x = X @ SQUASH.T
    F = slopes(wls_gradient(X, 0.5), x)
    np.testing.assert_allclose(F, np.broadcast_to(SQUASH, F.shape), atol=1e-9)


@pytest.mark.slow  # compiles kernels of its own
def test_a_frame_with_wls_ends_with_f_of_the_positions():
    solver = made(wls=True, velocity=lambda X: 2e3 * np.sin(2.0 * X[:, [1, 2, 0]]))
    frame = list(solver.frames())[-1]
    D = wls_gradient(body().X, 0.2 * body().radius)
    F = slopes(D, frame.particles.x)
    np.testing.assert_allclose(frame.particles.F, F, atol=1e-9)
    G = np.stack(
        [g @ solver.body.rows.nodes(solver.state.view().u) for g in solver.body.rows.G], -1
    )
    assert np.abs(F - np.eye(3) - G).max() > 1e-3, "it is not what the grid says"
    # The kernels see the same F: their energy is that of a law called on it.
    mu, lam = shear_modulus(), preset_material("rubber", body()).lam
    s = np.linalg.svd(F, compute_uv=False)
    psi = mu * ((s - 1.0) ** 2).sum(1) + 0.5 * lam * (np.linalg.det(F) - 1.0) ** 2
    assert elastic_energy(solver.body, solver.state) == pytest.approx(
        float(body().V0 @ psi), rel=1e-9
    )


@pytest.mark.slow
def test_wls_gives_energy_that_is_counted():
    solver = made(wls=True, velocity=lambda X: 2e3 * np.sin(2.0 * X[:, [1, 2, 0]]))
    solver.advance(1, 2)  # forget the start: F0 is not I any more
    passage = solver.advance(2, 2)
    after = elastic_energy(solver.body, solver.state)
    saved = solver.state.rest.F0.copy()
    solver.correction.frame(solver.state, 2)
    np.testing.assert_allclose(solver.state.rest.F0, saved, atol=EXACT)  # twice is once
    assert after == pytest.approx(elastic_energy(solver.body, solver.state), rel=1e-12)
    assert abs(passage.injected) > 1e-3 * after


# Shape correction


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [0.02, 0.3, 1.0])
def test_the_shape_correction_moves_towards_the_rest_shape_by_its_strength(alpha):
    embedded = np.array([[0.0, 1.0, 0.0], [0.3, -0.2, 0.9]])
    A, b = SQUASH - np.eye(3), np.array([0.5, -2.0, 1.0])
    poses = []
    for strength in (0.0, alpha):
        # The motion of one frame is A X + b, times the time.
        solver = made(
            procrustes=strength, embedded={"r": embedded}, velocity=lambda X: 1e5 * (X @ A.T + b)
        )
        frame = list(solver.frames())[-1]
        poses.append((frame.particles, frame.embedded["r"], frame.health))
    (plain, rode, before), (moved, rides, after) = poses
    X, m = body().X, body().V0 / body().V0.sum()
    mean, rest = m @ plain.x, m @ X
    for was, now, at in ((plain, moved, X), (rode, rides, embedded)):
        target = mean + (at - rest)
        np.testing.assert_allclose(now.x, was.x + alpha * (target - was.x), atol=1e-9)
        np.testing.assert_allclose(now.v, was.v, atol=1e-9 * 1e5)
        np.testing.assert_allclose(now.F, was.F + alpha * (np.eye(3) - was.F), atol=1e-9)
    np.testing.assert_allclose(after.center, before.center, atol=1e-9)
    assert after.kinetic == before.kinetic
    assert after.injected == pytest.approx(after.elastic - before.elastic, rel=1e-9)
    assert after.injected < 0.0


@pytest.mark.slow
def test_the_shape_correction_does_not_turn_with_the_body():
    # A quarter turn is pulled apart: the price of a target without rotation.
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    solver = made(procrustes=0.5)
    strain(solver, turn)
    passage = solver.advance(1, 2)
    F = solver.state.view().pose(1).F
    np.testing.assert_allclose(F, np.broadcast_to(0.5 * (turn + np.eye(3)), F.shape), atol=1e-6)
    assert passage.injected > 0.0


@pytest.mark.slow
def test_a_body_that_is_pinned_has_no_shape_correction():
    pin = Pin(
        name="top",
        inside=lambda X: X[:, 1] > 0.5,
        nearest=lambda X: np.column_stack([X[:, 0], np.full(len(X), 0.5), X[:, 2]]),
        anchors=body().X[:4],
        path=body().X[None, :4],
    )
    with pytest.raises(UsageError) as caught:
        made(procrustes=0.1, pins=[pin])
    assert "--pin" in caught.value.message
    solver = made(wls=True, pins=[pin])
    assert all(np.isfinite(f.particles.F).all() for f in solver.frames())


# All of them


@pytest.mark.slow
def test_off_they_leave_no_trace():
    solver = made()
    assert solver.body.options == DEFAULT == options_of(settings())
    for name in ("F0", "clip_buffer", "touched"):
        assert solver.state.arrays[name].shape == (1,)
    assert "F0" not in solver.state.save()
    passage = solver.advance(1, 2)
    assert (passage.injected, passage.clamped, passage.stress_capped) == (0.0, 0, 0)
    now = solver.state.view()
    assert now.gradients(1) is now.F


@pytest.mark.slow  # compiles kernels of its own
def test_limits_that_are_not_met_change_nothing():
    # Compiled apart, so that a fused multiply-add may round differently: 1e-16 a substep.
    states = []
    for options in ({}, {"clamp": (0.01, 100.0), "stress_cap": 1e12}):
        solver = made(velocity=lambda X: X @ SQUASH, frames=20, fps=60.0, substeps=20, **options)
        last = list(solver.frames())[-1]
        states.append((solver.state.view().u, solver.state.view().v))
        assert last.health.clamped == last.health.stress_capped == 0
    np.testing.assert_allclose(states[0], states[1], atol=1e-9)


@pytest.mark.acceptance
@pytest.mark.slow  # compiles kernels of its own
def test_what_is_saved_continues_bit_identically():
    def solver():
        return made(
            real=np.float32, wls=True, procrustes=0.02, clamp=(0.2, 5.0), stress_cap=1e5,
            velocity=lambda X: 3.0 * np.sin(2.0 * X[:, [1, 2, 0]]), frames=9, fps=60.0, substeps=10,
        )  # fmt: skip

    one = solver()
    for index in range(1, 5):
        one.advance(index, 10)
    saved = one.state.save()

    def on(body):
        for index in range(5, 9):
            body.advance(index, 10)
        pose = body.state.view().pose(8)
        return np.concatenate([pose.x.ravel(), pose.F.ravel(), body.state.rest.F0.ravel()])

    wanted = on(one)
    one.state.load(saved)
    assert np.array_equal(on(one), wanted)
    other = solver()
    other.state.load(saved)
    assert np.array_equal(on(other), wanted)
