"""The step that a strained body requires on a grid that is fixed in the world."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from lane_kernels import alike
from law_references import ENERGIES, LAM, MU, felt, unit
from solids import ball, preset_material, settings

from gf_usd.core.materials.laws import LAWS
from gf_usd.physics.per_particle import strains
from gf_usd.physics.updated_lagrangian import solver as updated_solver
from gf_usd.physics.updated_lagrangian.energies import cells_now, strained_speed, world_stiffness
from gf_usd.physics.updated_lagrangian.solver import UpdatedLagrangian


@pytest.mark.slow
@pytest.mark.parametrize("token", ENERGIES)
def test_no_wave_is_faster_in_the_world(token):
    # A wave of rest normal N has its crests 1 / |F^-T N| apart in the world; differences of P
    # leave 1e-6.
    rng = np.random.default_rng(0)
    n = 400
    U, _, Vt = np.linalg.svd(rng.normal(size=(n, 3, 3)))
    F = (U * rng.uniform(0.25, 2.0, (n, 3))[:, None, :]) @ Vt
    F[np.linalg.det(F) < 0.0] *= -1.0
    k = world_stiffness(alike(token, n, MU, LAM), strains(F)[0], np.linalg.det(F))
    nearest = np.inf
    for _ in range(30):
        N = unit(rng, n)
        apart = np.linalg.norm(np.einsum("nba,nb->na", np.linalg.inv(F), N), axis=1)
        world = felt(token, F, unit(rng, n), N) / apart**2
        assert (world <= k * (1.0 + 1e-6)).all()
        nearest = min(nearest, float((1.0 - world / k).min()))
    # Hencky's has the stiffness of the least stretch in every direction: it is up to a third over.
    assert nearest < (0.33 if LAWS[token].flows else 0.1), "the bound is no loose one"


@pytest.mark.parametrize("token", ENERGIES)
def test_at_rest_it_is_that_of_the_pressure_wave(token):
    one = np.ones(1)
    k = world_stiffness(alike(token, 1, MU, LAM), np.ones((1, 3)), one)
    assert k == pytest.approx(LAM + 2.0 * MU)


def test_particles_are_listed_cell_by_cell():
    cells = np.random.default_rng(0).uniform(-3.0, 5.0, (500, 3))
    order, start = cells_now(cells)
    assert sorted(order) == list(range(500))
    assert (start[0], start[-1]) == (0, 500)
    base = np.floor(cells - 0.5)[order]
    seen = [tuple(base[a]) for a in start[:-1]]
    assert len(set(seen)) == len(seen) == len(np.unique(base, axis=0))
    for a, b in pairwise(start):
        assert (base[a:b] == base[a]).all()


def test_the_mean_of_a_cell_counts():
    cells = np.array([[1.0, 1.0, 1.0], [1.2, 1.0, 1.0], [9.0, 1.0, 1.0]])
    speed = strained_speed(np.array([1.0, 5.0, 2.0]), np.full(3, 2.0), cells)
    assert speed == pytest.approx(np.sqrt(1.5))


@pytest.mark.slow
def test_a_stretched_body_takes_shorter_steps():
    body, _ = ball(300)
    made = preset_material("rubber", body, damping_time=0.0, law="corotated")
    solver = UpdatedLagrangian(body, [made], settings(fps=1.0), real=np.float32)
    solver.read(0)
    relaxed = solver.substeps
    F = np.tile(np.diag([4.0, 1.0, 1.0]).ravel(), len(body)).astype(np.float32)
    solver.state.arrays["F"].from_numpy(F)
    solver.read(0)
    # Half of the limit at rest, all of it when strained: 4 times the frequency is twice the steps.
    assert solver.substeps > 1.5 * relaxed


def test_a_state_that_blew_up_is_left_to_the_guard(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its stable step can round to 0 s, by which nothing can be divided."""
    body, _ = ball(300)
    solver = UpdatedLagrangian(
        body, [preset_material("rubber", body)], settings(fps=1.0), real=np.float32
    )
    monkeypatch.setattr(updated_solver, "strained_step", lambda *of_the_strain: 0.0)
    solver.read(0)
    assert solver.strained == 1
