"""What is kept of a state is kept only as long as the state stands."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest
from solids import ball, preset_material, settings

from gf_usd.physics import per_particle, taichi_arrays
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian


@pytest.fixture
def solver():
    particles, _ = ball(120)
    return TotalLagrangian(particles, [preset_material("rubber", particles)], settings(frames=3))


def test_the_same_state_has_one_view(solver):
    assert solver.state.view() is solver.state.view()


@pytest.mark.parametrize("name", ["u", "v"])
def test_another_state_has_another_view(solver, name):
    before = solver.state.view()
    _ = before.particles, before.potential
    changed = taichi_arrays.values(solver.state.arrays[name])
    changed[1::3] += 0.5
    taichi_arrays.put(solver.state.arrays[name], changed)
    after = solver.state.view()
    moved, faster = (0.5, 0.0) if name == "u" else (0.0, 0.5)
    # Single precision of the state, and weights that add up to 1.
    for was, now, by in (
        (before.particles.x, after.particles.x, moved),
        (before.particles.v, after.particles.v, faster),
    ):
        np.testing.assert_allclose(now - was, np.tile([0.0, by, 0.0], (len(was), 1)), atol=1e-6)


def test_the_offset_is_part_of_it(solver):
    before = solver.state.view()
    solver.state.offset = solver.state.offset + [0.0, 2.0, 0.0]
    np.testing.assert_allclose(solver.state.view().x - before.x, [[0.0, 2.0, 0.0]] * len(before.x))


def test_a_state_that_is_no_number_is_never_the_same(solver):
    bad = taichi_arrays.values(solver.state.arrays["u"])
    bad[0] = np.nan
    taichi_arrays.put(solver.state.arrays["u"], bad)
    assert solver.state.view() is not solver.state.view()
    assert "no longer finite" in solver.not_finite()[1]


def test_what_is_handed_out_cannot_be_changed(solver):
    with pytest.raises(ValueError, match="read-only"):
        solver.state.view().u[0] = 1.0


@pytest.mark.slow
def test_a_solver_that_nobody_holds_is_gone_at_once() -> None:
    particles, _ = ball(120)
    solver = TotalLagrangian(particles, [preset_material("rubber", particles)], settings(frames=3))
    assert len(list(solver.frames())) == 3
    assert solver.state.view().particles.x.size
    seen = weakref.ref(solver)
    gc.disable()
    try:
        del solver
        assert seen() is None
    finally:
        gc.enable()


@pytest.mark.slow
@pytest.mark.acceptance
def test_strains_are_worked_out_again_only_where_f0_or_the_frame_is_another(monkeypatch):
    particles, _ = ball(120)
    chosen = settings(frames=3, wls=True)
    solver = TotalLagrangian(
        particles,
        [preset_material("rubber", particles)],
        chosen,
        velocity=lambda X: 3.0 * np.sin(2.0 * X[:, [1, 2, 0]]),
    )
    worked_out: list[int] = []
    strains = per_particle.strains
    monkeypatch.setattr(per_particle, "strains", lambda F: worked_out.append(len(F)) or strains(F))
    solver.advance(1, 2)
    after = len(worked_out)
    assert worked_out == [2 * len(particles)], "before F was put anew and after it, at once"
    frame = solver.read(1)
    assert len(worked_out) == after
    s = np.linalg.svd(frame.particles.F, compute_uv=False)
    assert frame.health.max_stretch == pytest.approx(s.max(), rel=1e-7)
    solver.state.put_F0(1.1 * solver.state.rest.F0)
    assert solver.read(1).health.max_stretch != frame.health.max_stretch
    assert len(worked_out) == after + 1
    solver.read(2)
    assert len(worked_out) == after + 2
