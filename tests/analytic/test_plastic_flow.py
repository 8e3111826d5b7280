"""A law with a history in every kernel family: yield, springback, energy, rollback, checkpoints."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from flowing import ROW, registered
from slow_parameters import longest_but, slow_but
from von_mises_law import HARDENING

from gf_usd.core.arrays import Floats
from gf_usd.core.frames.particles import Particles
from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.material import Material
from gf_usd.physics.frame_loop import Solver
from gf_usd.physics.laws.registry import GRADIENT
from gf_usd.physics.total_lagrangian import layout
from gf_usd.physics.total_lagrangian.energies import elastic_energy
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.physics.updated_lagrangian.solver import UpdatedLagrangian
from gf_usd.verify.bodies import block, elastic, set_state, settings
from gf_usd.verify.cases.law import CASES as _LAW_CASES  # noqa: F401  (imported before the row)
from gf_usd.verify.cases.patch import patch

E, NU = 1e4, 0.3  # [Pa]
MU = E / (2.0 * (1.0 + NU))
HARD = HARDENING * MU  # [Pa]
YIELD = 200.0  # [Pa]: a strain of 0.02
RATE = np.array([[4.0, 2.0, 0.0], [0.0, -3.0, 1.0], [2.0, 0.0, -1.0]])  # [1/s]
FAMILIES = ["simd", "scalar", "ul"]
families = pytest.mark.parametrize("family", slow_but(FAMILIES, "simd"))
longest_families = pytest.mark.parametrize("family", longest_but(FAMILIES, "simd"))


@pytest.fixture(autouse=True)
def _with_a_law_that_flows():
    with registered():
        yield


def made(
    family: str, body: Particles, materials: tuple[Material, ...], chosen: Settings, **more: Any
) -> Solver:
    if family == "ul":
        return UpdatedLagrangian(body, materials, replace(chosen, solver="ul"), **more)
    return TotalLagrangian(body, materials, chosen, plain=family == "scalar", **more)


def soft(density: float = 1000.0, yields: float = YIELD, **more: Any) -> Material:
    return elastic(
        E=E, nu=NU, density=density, law=ROW.token, parameters={"yield_stress": yields}, **more
    )


def history(solver: Solver) -> Floats:
    """(N, 9 + 1 + 1) gradient, plastic strain, dissipated energy of the particles."""
    seen = solver.state.save()["history"]
    return np.asarray(seen, float).reshape(len(solver.particles), -1)


def plastic_strain(solver: Solver) -> Floats:
    """(N,) the internal variable, by its name."""
    return solver.body.law.internal(history(solver))["plastic_strain"]


class Press:
    """A block so heavy that stress does not move it: it is strained as its velocity says.

    A frame is one substep, and takes the block from F to another F, both diagonal.
    """

    def __init__(self, family: str, real: type) -> None:
        body = block((-0.5, -0.5, -0.5), (2, 2, 2), 0.5)
        chosen = settings("cpu", frames=10_000, fps=1e3, substeps=1, stress=True, followers=False)
        self.family, self.F = family, np.eye(3)
        self.solver = made(family, body, (soft(density=1e15),), chosen, real=real)
        self.index, self.health = 0, self.solver.read(0).health

    def strain(self, F: Floats) -> Floats:
        """Von Mises stress (N,) [Pa] once the block is strained so.

        A second frame holds it there: stress is evaluated in the middle of a frame's substep.
        """
        lost = self._move(F) + self._move(F)
        frame = self.solver.read(self.index)
        self.health = replace(frame.health, plastic_dissipation=lost)
        seen = frame.particles.F
        np.testing.assert_allclose(seen, np.broadcast_to(F, seen.shape), rtol=0.0, atol=1e-5)
        return frame.stress

    def _move(self, F: Floats) -> float:
        """[J] that flow dissipates along the path to F, on which every point keeps its velocity."""
        state, dt, n = self.solver.state, self.solver.frame_time, len(self.solver.particles)
        rate = (F - self.F) / dt
        if self.family == "ul":
            rest = state.rows("x") @ np.linalg.inv(self.F).T
            middle = 0.5 * (F + self.F)  # where the grid takes the motion over
            state.put("v", (rest @ rate.T).ravel())
            state.put("L", np.tile((rate @ np.linalg.inv(self.F)).ravel(), n))
            state.put("C", np.tile((rate @ np.linalg.inv(middle)).ravel(), n))
        else:
            state.put("v", (self.solver.body.stencil.node_X @ rate.T).ravel())
        self.F, self.index = F, self.index + 1
        return self.solver.advance(self.index, 1).plastic_dissipation


def uniaxial(a: float, stress: float) -> Floats:
    """F of a bar with plastic strain a and uniaxial Kirchhoff stress [Pa]."""
    e, across = stress / E + a, -NU * stress / E - 0.5 * a
    return np.diag(np.exp([e, across, across]))


@pytest.mark.slow
@families
@pytest.mark.parametrize(
    ("real", "tolerance"),
    # F is a sum of 27 terms rounded to 2e-16 or 1e-7, and stress E times what that leaves of it.
    [pytest.param(np.float64, 1e-9, marks=pytest.mark.slow), (np.float32, 0.5)],
)
def test_a_bar_yields_hardens_and_springs_back(family, real, tolerance):
    press = Press(family, real)
    strained = [(0.0, 0.5 * YIELD), (0.0, 0.99 * YIELD)]
    strained += [(a, YIELD + HARD * a) for a in (0.01, 0.03, 0.06)]
    top = strained[-1][1]
    # Unloading is elastic, with slope E, down to no stress at a permanent strain of 6 %; and so is
    # loading again, up to the hardened yield stress and not the first.
    strained += [(0.06, share * top) for share in (0.5, 0.0, 0.9)] + [(0.08, YIELD + HARD * 0.08)]
    for a, stress in strained:
        F = uniaxial(a, stress)
        seen = press.strain(F)
        np.testing.assert_allclose(seen, stress / np.linalg.det(F), rtol=0.0, atol=tolerance)


@pytest.mark.slow
@longest_families
def test_energy_that_flow_takes_is_its_plastic_work(family):
    press = Press(family, np.float64)
    volume = float(press.solver.particles.V0.sum())
    strains, lost = np.linspace(0.0, 0.06, 61), []
    for a in strains:
        press.strain(uniaxial(a, YIELD + HARD * a))
        lost.append(press.health.plastic_dissipation)
    assert min(lost) >= 0.0
    # int (sigma_y + H a) da: what hardening takes no spring gives back.  Steps of .001 leave the
    # strain's own size, .1 % of it.
    work = YIELD * 0.06 + 0.5 * HARD * 0.06**2
    assert sum(lost) == pytest.approx(volume * work, rel=2e-3)
    unloaded = press.strain(uniaxial(0.06, 0.0))
    np.testing.assert_allclose(unloaded, 0.0, atol=1e-6)
    assert press.health.plastic_dissipation == 0.0
    assert press.health.elastic < 1e-9 * sum(lost)


@pytest.mark.slow
@families
def test_a_body_at_rest_has_no_energy_and_no_plastic_flow(family):
    body = block((0.0, 0.0, 0.0), (2, 2, 2), 0.5)
    solver = made(family, body, (soft(),), settings("cpu", frames=4, substeps=20))
    for frame in solver.frames():
        assert (frame.health.elastic, frame.health.plastic_dissipation) == (0.0, 0.0)
    assert np.array_equal(history(solver), np.tile([*np.eye(3).ravel(), 0.0, 0.0], (len(body), 1)))


@pytest.mark.slow  # compiles kernels of double precision
@longest_families
def test_to_turn_a_bent_body_is_no_flow(family):
    press = Press(family, np.float64)
    stress = press.strain(uniaxial(0.05, YIELD + HARD * 0.05))
    press.strain(uniaxial(0.05, 0.9 * YIELD))
    before = press.solver.von_mises() if family == "ul" else press.solver.read(9).stress
    Q = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    state = press.solver.state
    if family == "ul":
        seen = history(press.solver)
        seen[:, :GRADIENT] = (Q @ seen[:, :GRADIENT].reshape(-1, 3, 3)).reshape(-1, 9)
        state.put("history", seen.ravel())
        after = press.solver.von_mises()
    else:
        X = press.solver.body.stencil.node_X
        state.put("u", (X @ (Q @ press.F - np.eye(3)).T).ravel())
        after = press.solver.read(9).stress
    np.testing.assert_allclose(after, before, rtol=1e-12)
    assert stress.min() > before.max() > 0.0


def test_the_step_follows_what_is_pressed_flat_for_good():
    """Cells at a tenth of their height without any stress are crossed ten times as fast."""
    body = block((0.0, 0.0, 0.0), (2, 2, 2), 0.5)
    solver = TotalLagrangian(body, [soft()], settings("cpu", frames=2, fps=0.1))
    seen = []
    for squash in (1.0, 0.1):
        F = np.diag([squash**-0.5, squash, squash**-0.5])
        set_state(solver, solver.body.stencil.node_X @ (F - np.eye(3)).T)
        state = history(solver)
        state[:, :GRADIENT] = np.linalg.inv(F).ravel()
        lanes = layout.law_lanes(solver.body.layout, state)
        solver.state.put("history", lanes.ravel())
        solver.read(0)
        seen.append(solver.strained)
    assert seen[1] / seen[0] == pytest.approx(10.0, rel=0.02)  # whole numbers of substeps


@pytest.mark.slow
@pytest.mark.parametrize("plain", slow_but([False, True], False))
def test_flow_keeps_the_volume_over_many_steps(plain):
    """A block is sheared evenly in steps that all round alike."""
    law = elastic(E=E, nu=NU, density=1e9, law="vonMises", parameters={"yield_stress": 1.0})
    body = block((0.0, 0.0, 0.0), (1, 1, 1), 1.0)
    chosen = settings("cpu", fps=1e9, substeps=1, followers=False)
    solver = TotalLagrangian(body, [law], chosen, plain=plain)
    for a in np.linspace(0.0, 0.04, 201):
        set_state(
            solver, solver.body.stencil.node_X @ (np.diag(np.exp([a, -a, 0.0])) - np.eye(3)).T
        )
        solver.advance(1, 1)
    assert plastic_strain(solver).min() > 0.045
    Pi = history(solver)[:, :GRADIENT].reshape(-1, 3, 3)
    # Nine products, rounded to 6e-8 each; without a correction 200 steps add up to 5e-6.
    np.testing.assert_allclose(np.linalg.det(Pi), 1.0, rtol=0.0, atol=5e-7)


def thrown(family: str, frames: int = 8, options: Any = None, **more: Any) -> Solver:
    """A block that its own motion strains far beyond yield."""
    body = block((0.0, 0.0, 0.0), (4, 3, 3), 0.25)
    chosen = settings("cpu", frames=frames, substeps=60, **(options or {}))
    return made(family, body, (soft(**more),), chosen, velocity=lambda X: X @ RATE.T)


OPTIONS = {"clamp": (0.985, 1.015), "stress_cap": 250.0, "stress": True}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "more"),
    longest_but(
        [
            ({}, {}),
            ({"stress": True}, {"damping_time": 1e-3}),
            (OPTIONS, {"damping_time": 1e-3}),
            ({"wls": True}, {}),
        ],
        ({}, {}),
    ),
    ids=["plain", "damped", "limited", "wls"],
)
def test_kernel_families_agree(options, more):
    # Kernels of one equation round apart: 420 substeps by some 1e-7 each, of values of order 1.
    seen = []
    for family in ("simd", "scalar"):
        solver = thrown(family, options=options, **more)
        frames = list(solver.frames())
        if "clamp" in options:
            assert min(frames[-1].health.clamped, frames[-1].health.stress_capped) > 0
        if "stress" in options:
            assert frames[-1].stress.max() > 150.0
        seen.append((frames[-1].particles.F, plastic_strain(solver)))
    assert seen[0][1].max() > 0.05
    for one, other in zip(*seen):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=2e-5)


@pytest.mark.slow
@pytest.mark.parametrize("family", slow_but(["simd", "scalar"], "simd"))
def test_energy_is_kept_but_for_what_flow_takes(family):
    solver = thrown(family)
    seen = [frame.health for frame in solver.frames()]
    lost = np.cumsum([h.plastic_dissipation for h in seen])
    total = np.array([h.kinetic + h.elastic for h in seen]) + lost
    assert lost[-1] > 5.0 * max(h.elastic for h in seen), "it flows far"
    assert np.diff(lost).min() >= 0.0
    # A substep strains it by .003: what the work leaves out is of that order of itself.
    assert np.abs(total - total[0]).max() < 3e-3 * lost[-1]
    assert plastic_strain(solver).max() > 0.05
    # What the report says is stored is what the kernels' forces are the gradient of.
    assert seen[-1].elastic == pytest.approx(elastic_energy(solver.body, solver.state), rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("damping_time", longest_but([0.0, 1e-3], 0.0))
def test_both_solvers_flow_alike(damping_time):
    """While strains are small, one is discretized as the other."""
    seen = []
    for family in ("simd", "ul"):
        solver = thrown(family, frames=3, damping_time=damping_time)
        lost = sum(frame.health.plastic_dissipation for frame in solver.frames())
        seen.append((plastic_strain(solver).mean(), lost))
    assert seen[0][0] > 0.05
    # The grid of one moves with the body, which is strained by 0.3, and its particles meet others
    # on it: some per cent.
    assert seen[1] == pytest.approx(seen[0], rel=0.05)


@pytest.mark.slow
@pytest.mark.acceptance
def test_limits_act_on_the_elastic_gradient_in_the_world_too():
    frames = list(thrown("ul", options=OPTIONS, damping_time=1e-3).frames())
    assert min(frames[-1].health.clamped, frames[-1].health.stress_capped) > 0
    assert frames[-1].health.max_stretch > 1.2, "the body flows beyond the clamp of F_e"


def test_a_high_yield_stress_makes_it_elastic():
    solver = thrown("simd", yields=1e9)
    assert sum(frame.health.plastic_dissipation for frame in solver.frames()) == 0.0
    assert plastic_strain(solver).max() == 0.0


@families
def test_a_frame_done_again_is_the_same_to_the_bit(family):
    solver = thrown(family)
    for index in range(1, 4):
        solver.advance(index, 60)
    before = solver.state.save()
    assert plastic_strain(solver).max() > 0.01
    first = {}
    for attempt in range(2):
        solver.advance(4, 60)
        after = solver.state.save()
        assert not np.array_equal(after["history"], before["history"])
        for name, value in after.items():
            assert np.array_equal(value, first.setdefault(name, value)), (attempt, name)
        solver.state.load(before)
        for name, value in solver.state.save().items():
            assert np.array_equal(value, before[name]), name


@families
def test_a_frame_that_the_guard_refuses_leaves_no_history(family, monkeypatch):
    refused, plain = thrown(family), thrown(family)
    refused.settings = plain.settings = replace(plain.settings, substeps=None)
    refused.coarse = plain.coarse = 60
    judge, calls = refused.guard.judge, []

    def once(last, now, particles):
        calls.append(now)
        return (0, "refused") if len(calls) == 1 else judge(last, now, particles)

    monkeypatch.setattr(refused.guard, "judge", once)
    plain.guard.refine()
    for solver in (refused, plain):
        solver.strained = 1
        frame = solver.next(1, solver.read(0).health)
    assert len(calls) == 2
    assert calls[0].plastic_dissipation > 0.0
    assert frame.health.plastic_dissipation == calls[1].plastic_dissipation
    for name, value in plain.state.save().items():
        assert np.array_equal(value, refused.state.save()[name]), name


@families
def test_another_solver_continues_a_checkpoint_bit_identically(family, tmp_path):
    through, first, second = (thrown(family) for _ in range(3))
    healths = [frame.health for frame in through.frames()]
    frame = next(frame for frame in first.frames() if frame.index == 3)
    np.savez(tmp_path / "standing.npz", **first.save())
    with np.load(tmp_path / "standing.npz", allow_pickle=False) as kept:
        second.load({name: kept[name] for name in kept.files})
    rest = [f.health for f in second.frames_after(3, frame.health)]
    assert rest == healths[4:]
    for name, value in through.state.save().items():
        assert np.array_equal(value, second.state.save()[name]), name


@families
def test_the_guard_counts_what_flow_takes_as_taken(family):
    solver = thrown(family)
    last = solver.read(0).health
    now = replace(last, plastic_dissipation=0.5 * last.kinetic)
    place = solver.read(0).particles
    assert "energy rose" in solver.guard.judge(last, now, place)[1]
    down = replace(now, kinetic=0.5 * last.kinetic)
    assert solver.guard.judge(last, down, place)[1] == ""


@pytest.mark.slow
@longest_families
def test_three_laws_in_one_bake_each_move_as_alone(family):
    """Bodies of their own, three cells apart, so that none feels the others."""
    one = block((0.0, 0.0, 0.0), (3, 2, 2), 0.25)
    n = len(one)
    shift = np.repeat([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [4.0, 0.0, 0.0]], n, axis=0)
    whole = {
        name: np.concatenate([value] * 3)
        for name, value in vars(one).items()
        if isinstance(value, np.ndarray) and len(value) == n
    }
    which = np.repeat(np.arange(3), n)
    body = replace(one, **{**whole, "X": whole["X"] + shift}, volume=3.0 * one.volume)
    if family != "ul":
        body = replace(body, body=which)
    laws = (elastic(E=E, nu=NU, density=1000.0), elastic(E=E, nu=NU, density=1000.0,
            law="neoHookean"), soft())  # fmt: skip
    chosen = settings("cpu", frames=5, substeps=60, stress=True)

    def run(body: Particles, materials: tuple[Material, ...]):
        solver = made(family, body, materials, chosen, velocity=lambda X: X @ RATE.T)
        return list(solver.frames())[-1], solver

    mixed, solver = run(replace(body, material=which), laws)
    assert len(solver.body.law.set.laws) == 3
    assert np.isnan(plastic_strain(solver)[which < 2]).all()
    assert plastic_strain(solver)[which == 2].max() > 0.01
    for k, law in enumerate(laws):
        alone, _ = run(body, (law,))
        mine = which == k
        for name in ("x", "F"):
            seen, expected = (getattr(f.particles, name)[mine] for f in (mixed, alone))
            # As in test_two_laws: 240 substeps by some 1e-7 each, of values of order 1.
            np.testing.assert_allclose(seen, expected, rtol=0.0, atol=1e-5 * np.abs(expected).max())
        np.testing.assert_allclose(
            mixed.stress[mine], alone.stress[mine], rtol=0.0, atol=1e-4 * alone.stress.max()
        )


def test_laws_that_share_cells_stand_in_batches_of_their_own():
    body = block((0.0, 0.0, 0.0), (3, 3, 3), 0.25)
    law = np.random.default_rng(0).integers(0, 3, len(body))
    materials = (elastic(E=E, nu=NU, density=1.0), soft(), soft(yields=50.0))
    solver = made("simd", replace(body, material=law), materials, settings("cpu"))
    batches, of = solver.body.layout, solver.body.law.of
    assert set(of) == {0, 1}
    assert (of[batches.owner] == of[batches.owner][:, :1]).all()
    filled = batches.filled > 0.0
    assert sorted(batches.source[filled]) == list(range(len(body)))
    assert (batches.owner == batches.source)[filled].all()
    cell = np.empty(len(body), int)
    stencil = solver.body.stencil
    cell[stencil.order] = np.repeat(np.arange(len(stencil.cell_nodes)), np.diff(stencil.cell_start))
    group = np.repeat(np.arange(len(batches.cells)), np.diff(batches.batch))
    assert (cell[batches.source] == batches.cells[group]).all()
    values = np.arange(len(body) * 2.0).reshape(-1, 2)
    assert np.array_equal(layout.from_lanes(batches, layout.law_lanes(batches, values)), values)


@pytest.mark.slow  # compiles kernels of its own
def test_the_patch_test_passes_with_flowing_laws():
    figures = list(patch(np.float64, (ROW.token,))("cpu"))
    mine = [m for m in figures if m.name.startswith(ROW.token)]
    assert len(mine) == 2
    assert all(m.value < m.bound for m in mine)
