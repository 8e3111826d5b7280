"""The Updated Lagrangian solver: contact's transpose, limits, state, faults, threads."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from slow_parameters import longest_but, slow_but
from solids import ball, preset_material, settings

from gf_usd.core.errors import SolverError, UsageError
from gf_usd.core.stage import Pin
from gf_usd.physics.frame_loop import Solver
from gf_usd.physics.total_lagrangian import launch
from gf_usd.physics.updated_lagrangian import solver as module
from gf_usd.physics.updated_lagrangian import state as state_module
from gf_usd.physics.updated_lagrangian.solver import UpdatedLagrangian
from gf_usd.verify.bodies import elastic

KERNELS = ["serial", "parallel", "resident"]


def dropped(frames: int = 8, threads: int | None = None, real: type = np.float32, **changes):
    """A rubber ball of 10 cm that meets the floor at once."""
    body, samples = ball(700, radius=0.1)
    s = settings(
        frames=frames, gravity=(0.0, -9.81, 0.0), floor=-0.1, threads=threads, fps=60.0, **changes
    )
    made = preset_material("rubber", body)
    return UpdatedLagrangian(body, [made], s, samples=samples, velocity=(0.3, -2.0, 0.1), real=real)


def state(solver: UpdatedLagrangian) -> np.ndarray:
    return np.concatenate(
        [solver.state.get(name).astype(float) for name in state_module.PARTICLES]
        + [solver.state.offset]
    )


def landed(kernel: str, threads: int) -> np.ndarray:
    solver = dropped(threads=threads)
    solver.kernel = kernel
    assert max(f.health.penetration for f in solver.frames()) > 0.0
    return state(solver)


@cache
def first(kernel: str) -> np.ndarray:
    return landed(kernel, threads=1)


@pytest.mark.slow
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("kernel", slow_but(KERNELS, "serial"))
def test_reruns_and_thread_counts_agree_to_the_bit(kernel, threads):
    assert np.array_equal(first(kernel), landed(kernel, threads))


@pytest.mark.slow
@pytest.mark.parametrize("kernel", longest_but(KERNELS[1:], "parallel"))
def test_the_kernels_agree(kernel):
    # The same sums in the same order, but compiled apart: see test_determinism.
    serial, other = dropped(), dropped()
    other.kernel = kernel
    for solver in (serial, other):
        list(solver.frames())
    x, y = (solver.state.motion()[0] + solver.state.offset for solver in (serial, other))
    np.testing.assert_allclose(x, y, atol=1e-5)


@pytest.mark.slow
def test_how_substeps_are_cut_into_launches_does_not_change_a_bit(monkeypatch):
    whole, cut = dropped(frames=3), dropped(frames=3)
    for solver, seconds in ((whole, 1e9), (cut, 1e-9)):
        solver.kernel = "resident"
        monkeypatch.setattr(launch, "LAUNCH_SECONDS", seconds)
        list(solver.frames())
    assert np.array_equal(state(whole), state(cut))


@pytest.mark.slow
def test_a_saved_state_continues_bit_identically():
    whole, first, second = (dropped(frames=n) for n in (7, 4, 7))
    list(whole.frames())
    list(first.frames())
    second.state.load(first.state.save())
    second.guard.load(first.guard.save())
    last = second.read(3).health
    for index in range(4, 7):
        last = second.next(index, last).health
    assert np.array_equal(state(whole), state(second))
    assert (whole.state.time, whole.state.done) == (second.state.time, second.state.done)


@pytest.mark.slow
def test_the_floor_gives_what_its_samples_feel():
    # Forces go back by the transpose of how samples read their motion: over one substep the body
    # gains dt sum f and dt sum x_s x f_s, to rounding, its particles' own spin included.
    body, samples = ball(300)
    made = preset_material("jelly", body, damping_time=0.0, friction=0.3)
    s = settings(frames=2, substeps=1, fps=1000.0, floor=-0.9)

    def velocity(X):
        return np.array([1.0, -1.0, 0.5]) + 0.5 * np.cross([0.2, 1.0, 0.3], X)

    solver = UpdatedLagrangian(body, [made], s, samples=samples, velocity=velocity, real=np.float64)
    assert solver.body.embedding is not None
    x, v, F, L = solver.state.motion()
    half = 0.5 * solver.frame_time
    where = solver.body.embedding.pose(x + half * v, v, F + half * L @ F, L).x + solver.state.offset
    before, after = (f.health for f in solver.frames())
    f = solver.state.rows("sample_force")
    assert (np.abs(f).sum(1) > 0.0).sum() > 5
    impulse = solver.frame_time * f
    gained = np.subtract(after.momentum, before.momentum)
    np.testing.assert_allclose(gained, impulse.sum(0), atol=1e-11 * np.abs(impulse).sum())
    turned = np.subtract(after.angular_momentum, before.angular_momentum)
    moment = np.cross(where, impulse)
    np.testing.assert_allclose(turned, moment.sum(0), atol=1e-11 * np.abs(moment).sum())


@pytest.mark.slow  # compiles kernels of its own
def test_singular_values_are_clipped_and_counted():
    solver = dropped(frames=4, clamp=(0.97, 1.02))
    health = [f.health for f in solver.frames()]
    # F is clipped after it has moved: f32 rounding of an SVD is left.
    assert min(h.min_stretch for h in health) > 0.97 - 1e-5
    assert max(h.max_stretch for h in health) < 1.02 + 1e-5
    assert 0 < max(h.clamped for h in health) <= len(solver.particles)
    assert health[0].clamped == 0


@pytest.mark.slow  # compiles kernels of its own
def test_an_inverted_particle_is_turned_back_by_the_clamp():
    solver = dropped(frames=2, clamp=(0.2, 5.0))
    F = np.tile(np.eye(3), (len(solver.particles), 1, 1))
    F[7] = np.diag([1.0, -0.5, 1.2])
    solver.state.arrays["F"].from_numpy(F.astype(np.float32).ravel())
    solver.advance(1, 10_000)
    assert solver.read(1).health.inverted == 0


@pytest.mark.slow  # compiles kernels of its own
def test_stress_is_cut_and_counted():
    free, capped = dropped(frames=5), dropped(frames=5, stress_cap=100.0)
    frames = [list(s.frames()) for s in (free, capped)]
    assert max(f.health.stress_capped for f in frames[0]) == 0
    assert max(f.health.stress_capped for f in frames[1]) > 100
    # |P| <= 100 Pa hardly resists: the ball is squashed further.
    assert frames[1][-1].health.min_J < frames[0][-1].health.min_J


@pytest.mark.slow  # compiles kernels of its own
def test_a_cap_that_is_never_met_changes_nothing():
    # The same numbers times one; compiled apart, so to rounding.
    free, capped = dropped(frames=4), dropped(frames=4, stress_cap=1e12)
    list(free.frames())
    assert not any(f.health.stress_capped for f in capped.frames())
    np.testing.assert_allclose(state(free), state(capped), rtol=1e-3, atol=1e-4)


@pytest.mark.slow
def test_every_frame_has_the_embedded_points():
    body, _ = ball(300)
    made = preset_material("rubber", body, damping_time=0.0)
    points = np.array([[0.0, 1.0, 0.0], [0.5, 0.0, 0.2]])
    s = settings(frames=3, gravity=(0.0, -9.81, 0.0))
    solver = UpdatedLagrangian(body, [made], s, embedded={"a": points}, velocity=(1.0, 0.0, 0.0))
    for frame in solver.frames():
        at = points + np.array([1.0, 0.0, 0.0]) * frame.time
        at[:, 1] -= 0.5 * 9.81 * frame.time**2
        np.testing.assert_allclose(frame.embedded["a"].x, at, atol=1e-5)
        assert frame.embedded["a"].F.shape == (2, 3, 3)


@pytest.mark.slow
def test_stress_is_read_where_asked_for():
    body, _ = ball(300)
    made = preset_material("rubber", body, damping_time=0.0)
    s = settings(frames=3, stress=True)
    *_, last = UpdatedLagrangian(body, [made], s, velocity=lambda X: X * [0.0, -0.5, 0.0]).frames()
    assert last.stress is not None
    assert last.stress.shape == (len(body),)
    assert last.stress.min() > 0.0


def bursting() -> UpdatedLagrangian:
    """300 particles of next to nothing, each on a line of its own.

    A particle alone keeps its L, so that its F grows with every substep: few are taken.
    """
    body, _ = ball(300)
    made = elastic(E=1e-6, nu=0.3, density=1.0, law="fluid", parameters={"viscosity": 0.0})
    s = settings(frames=3, substeps=5, fps=1.0)
    return UpdatedLagrangian(body, [made], s, velocity=lambda X: 1e3 * X)


@pytest.mark.slow
@pytest.mark.acceptance
def test_more_nodes_than_memory_allows_is_a_solver_error():
    solver = bursting()
    solver.state._most_nodes = solver.state.node_capacity
    with pytest.raises(SolverError, match="occupy more than") as caught:
        list(solver.frames())
    assert caught.value.frame == 1
    assert 0 <= caught.value.particle < len(solver.particles)


@pytest.mark.slow
@pytest.mark.parametrize("kernel", longest_but(KERNELS, "serial"))
def test_what_flies_apart_has_a_grid_wherever_it_goes(kernel):
    solver = bursting()
    solver.kernel = kernel
    first, *_, last = solver.frames()
    n = len(solver.particles)
    # Positions are kept to 6e-8 of the distance, and none is moved by another.
    x = solver.particles.X + 2.0 * first.particles.v
    np.testing.assert_allclose(last.particles.x, x, atol=1e-6 * np.abs(x).max())
    assert np.prod(np.ptp(x, axis=0) / solver.body.h) > 1e11
    nodes, cells = solver.state.get("grid")[:2]
    assert (nodes, cells) == (27 * n, n)


@pytest.mark.slow
def test_it_does_not_matter_when_cells_are_numbered(monkeypatch):
    """A body that flies through the grid, and the same with all cells made anew every time."""
    monkeypatch.setattr(module, "SERIAL_BELOW", 0)
    body, _ = ball(300)
    s = settings(frames=3, substeps=40, gravity=(0.0, -9.81, 0.0))
    seen, most = [], []
    for anew in (False, True):
        solver = UpdatedLagrangian(
            body, [preset_material("jelly", body)], s, velocity=(5.0, -20.0, 3.0)
        )
        counts = []

        def launched(solver=solver, counts=counts, anew=anew) -> None:
            counts.append(solver.state.get("grid")[1])
            if anew:
                solver.state.clear("grid")

        solver.on_launch = launched
        list(solver.frames())
        seen.append(state(solver))
        most.append(max(counts))
    assert np.array_equal(*seen)
    assert most[1] < most[0] <= 1.5 * most[1] + 2 * 64


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:invalid value")
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e30])
def test_a_position_that_is_no_place_is_noticed_and_nothing_is_written_for_it(value):
    solver = dropped()
    x = solver.state.get("x").astype(float)
    x[3 * 17] = value
    solver.state.arrays["x"].from_numpy(x.astype(np.float32))
    before = solver.state.get("F").astype(float)
    solver.advance(1, 3)
    particle, fault = solver.not_finite()
    assert particle == 17
    assert fault
    # Only the drift that opens the frame was done, for the others.
    assert np.abs(solver.state.get("F").astype(float) - before).max() < 1e-5


@pytest.mark.slow
def test_positions_move_to_the_offset_by_whole_cells():
    body, _ = ball(300, radius=0.1)
    s = settings(frames=20, gravity=(0.0, -9.81, 0.0))
    solver = UpdatedLagrangian(body, [preset_material("rubber", body, damping_time=0.0)], s)
    start = solver.state.offset.copy()
    *_, last = solver.frames()
    cells = (solver.state.offset - start) / solver.body.h
    np.testing.assert_allclose(cells, np.round(cells), atol=1e-9)
    assert cells[1] < -10
    assert np.abs(solver.state.get("x").astype(float)).max() < 0.1 + solver.body.h
    fall = -0.5 * 9.81 * last.time**2
    assert last.health.center[1] == pytest.approx(fall + np.mean(body.X[:, 1]), abs=1e-4)


def test_what_it_does_not_know_is_refused():
    body, _ = ball(100)
    made = [preset_material("rubber", body)]
    pin = Pin(
        name="box", inside=lambda X: X[:, 0] > 0.0, nearest=lambda X: X,
        anchors=np.zeros((1, 3)), path=np.zeros((1, 1, 3)),
    )  # fmt: skip
    with pytest.raises(UsageError, match="does not support --pin"):
        UpdatedLagrangian(body, made, settings(), pins=[pin])
    with pytest.raises(UsageError, match="Procrustes"):
        UpdatedLagrangian(body, made, settings(procrustes=0.02))
    with pytest.raises(UsageError, match="WLS"):
        UpdatedLagrangian(body, made, settings(wls=True))


def test_it_keeps_the_protocol():
    assert issubclass(UpdatedLagrangian, Solver)
