"""Pins that hold some axes and let the body slide along the others."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from slow_parameters import longest_but
from solids import settings

from gf_usd.core.arrays import Floats
from gf_usd.core.frames.frame import Health
from gf_usd.core.frames.particles import Particles
from gf_usd.core.frames.settings import CONSISTENT, LUMPED
from gf_usd.core.materials.material import Material
from gf_usd.core.stage import Pin
from gf_usd.physics.grid import mass as nodal_mass
from gf_usd.physics.grid.pins import PinnedPoints, axis_factors, mirror_points, pinned_by
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import block, clamp, elastic, mirror_plane, set_state

E, NU, RHO = 1e4, 0.3, 1000.0  # [Pa], [kg/m^3]
H = 0.25  # [m] of a cell
QUARTER = (mirror_plane(0, 0.0), mirror_plane(1, 0.0))
HELD, FREE, DEEP = 1.0, -1.0, 0.0  # factors


def soft(**changes: float) -> Material:
    return elastic(E=E, nu=NU, density=RHO, law="neoHookean", **changes)


def moved(pin: Pin, path: Floats) -> Pin:
    """A pin whose anchors go by path (T, 3) [m]."""
    return replace(pin, path=pin.anchors + path[:, None])


def test_pins_that_hold_different_axes_hold_a_point_together():
    X = np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -2.0, 0.0]])
    held = pinned_by(QUARTER, X)
    assert held.axes.tolist() == [[-1, -1, -1], [0, -1, -1], [-1, 1, -1], [0, 1, -1]]
    assert held.pin.tolist() == [-1, 0, 1, 0]
    assert held.slide.tolist() == [False, True, True, True]
    mirror, share = mirror_points(QUARTER, held, X, 1.0)
    assert share.tolist() == [-1.0] * 4
    assert np.isnan(mirror[0]).all()
    np.testing.assert_array_equal(mirror[1:3], [[1.0, 1.0, 0.0]] * 2)
    assert np.isnan(mirror[3]).all()  # two cells deep


def test_the_first_of_pins_that_hold_the_same_axis_has_the_point():
    whole = clamp(2, 0.5)
    held = pinned_by([whole, *QUARTER], np.array([[-1.0, -1.0, 0.0], [-1.0, -1.0, 1.0]]))
    assert held.axes.tolist() == [[0, 0, 0], [1, 2, -1]]


def test_factors_are_odd_in_what_is_held_and_even_in_what_is_free():
    held = PinnedPoints(axes=np.array([[0, -1, -1], [0, 1, -1], [0, -1, -1], [-1, -1, -1]]))
    mirror = np.array([[1.0] * 3, [1.0] * 3, [np.nan] * 3, [np.nan] * 3])
    factors = axis_factors(held, mirror)
    assert factors is not None
    assert factors.tolist() == [
        [HELD, FREE, FREE], [HELD, HELD, FREE], [DEEP, FREE, FREE], [1.0, 1.0, 1.0]
    ]  # fmt: skip
    assert axis_factors(PinnedPoints(axes=np.array([[0, 0, 0]])), mirror[:1]) is None


def swirl(X: Floats) -> Floats:
    """A velocity [m/s] that is its own mirror image across the planes x = 0 and y = 0."""
    x, y, z = X.T
    return np.stack([np.sin(x) * (1.0 + y**2), 0.5 * y * np.cos(x), np.sin(z) * x**2], 1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mass", "plain"),
    longest_but(product([LUMPED, CONSISTENT], [False, True]), (CONSISTENT, False), (LUMPED, True)),
)
def test_a_quarter_on_symmetry_planes_moves_as_the_whole_body(mass, plain, monkeypatch):
    # To rounding: without light nodes, whose fits do not end at the planes, and without what sets
    # the inertia of bodies that nothing holds.
    monkeypatch.setattr(nodal_mass, "PASSES", 0)
    monkeypatch.setattr(nodal_mass, "WEAK", 0.0)
    whole, quarter = block((-1, -1, -0.5), (8, 8, 4), H), block((0, 0, -0.5), (4, 4, 4), H)
    s = settings(frames=6, substeps=30, followers=False, mass=mass, filter_rate=3.0)
    points = {"points": np.array([[0.0, 0.0, 0.0], [0.3, 0.4, 0.1], [0.05, 0.6, 0.2]])}

    def last(body: Particles, pins: tuple[Pin, ...]):
        solver = TotalLagrangian(
            body, [soft()], s, velocity=swirl, embedded=points, pins=pins, real=np.float64,
            plain=plain,
        )  # fmt: skip
        *_, frame = solver.frames()
        return frame

    a, b = last(whole, ()), last(quarter, QUARTER)
    same = [int(np.linalg.norm(whole.X - X, axis=1).argmin()) for X in quarter.X]
    assert np.abs(a.particles.x - whole.X).max() > 0.1
    np.testing.assert_allclose(b.particles.x, a.particles.x[same], atol=1e-12)
    np.testing.assert_allclose(b.particles.F, a.particles.F[same], atol=1e-11)
    np.testing.assert_allclose(b.particles.v, a.particles.v[same], atol=1e-11)
    np.testing.assert_allclose(b.embedded["points"].x, a.embedded["points"].x, atol=1e-12)
    assert b.health.kinetic == pytest.approx(a.health.kinetic / 4.0, rel=1e-10)
    assert b.health.elastic == pytest.approx(a.health.elastic / 4.0, rel=1e-10)


def pulled(strain: float, frames: int, drag: float) -> tuple[TotalLagrangian, list[Health]]:
    """A bar between planes, of which the upper is moved within 40 frames."""
    body = block((-0.25, 0.0, -0.25), (2, 8, 2), H)
    rise = 2.0 * strain * (0.5 - 0.5 * np.cos(np.pi * np.minimum(np.arange(frames) / 40.0, 1.0)))
    above = mirror_plane(1, 2.0)
    above = replace(above, name="above", inside=lambda X: X[:, 1] > 2.0)
    foot = mirror_plane(1, 0.0)
    top = moved(above, np.outer(rise, [0.0, 1.0, 0.0]))
    solver = TotalLagrangian(
        body, [soft()], settings(frames=frames, drag=drag, filter_rate=0.0), pins=[foot, top],
        real=np.float64,
    )  # fmt: skip
    return solver, [frame.health for frame in solver.frames()]


@pytest.mark.slow
def test_a_bar_between_planes_contracts_freely_and_pulls_with_E_strain():
    # Small strain: the law's second order is of the size of the strain.
    strain = 1e-3
    solver, health = pulled(strain, frames=160, drag=4.0)
    F = solver.state.view().F
    np.testing.assert_allclose(F[:, 1, 1] - 1.0, strain, rtol=5e-3)
    np.testing.assert_allclose(F[:, 0, 0] - 1.0, -NU * strain, rtol=5e-3)
    np.testing.assert_allclose(F[:, 2, 2] - 1.0, -NU * strain, rtol=5e-3)
    volume = float(solver.particles.V0.sum())
    assert health[-1].elastic == pytest.approx(0.5 * E * strain**2 * volume, rel=5e-3)
    # the support: what the planes' nodes pass on is the bar's pull, E strain A
    state, nodes = solver.state, solver.body.stencil
    free = nodes.free_count
    share = state.rows("share")[free:]
    low = nodes.held.axes[free:, 1] == 0
    reaction = -2.0 * float(share[low, 1].sum())
    assert abs(reaction) == pytest.approx(E * strain * 0.25, rel=5e-3)


@pytest.mark.slow
def test_the_work_of_a_sliding_pin_is_what_the_energy_gains():
    # Summed over substeps by the rectangle rule, of which there are dozens.
    _, health = pulled(0.02, frames=30, drag=0.0)
    gained = health[-1].kinetic + health[-1].elastic
    assert gained > 0.5
    assert sum(h.work for h in health) == pytest.approx(gained, rel=0.02)


@pytest.mark.slow
def test_a_thrown_bar_keeps_its_energy_and_what_it_has_along_the_plane():
    body = block((-0.25, 0.0, -0.25), (2, 6, 2), H)
    s = settings(frames=30, substeps=20, filter_rate=0.0)
    solver = TotalLagrangian(
        body, [soft()], s, velocity=(0.3, -0.2, 0.1), pins=[mirror_plane(1, 0.0)], real=np.float64
    )
    seen = [frame.health for frame in solver.frames()]
    first, last = seen[0], seen[-1]
    for axis in (0, 2):
        assert last.momentum[axis] == pytest.approx(first.momentum[axis], rel=1e-12)
    assert min(h.momentum[1] for h in seen) < 0.0 < max(h.momentum[1] for h in seen)
    energy = [h.kinetic + h.elastic for h in seen]
    np.testing.assert_allclose(energy[1:], energy[1], rtol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("plain", [False, True])
def test_kernels_and_operator_have_the_same_mass_where_axes_have_springs_of_their_own(plain):
    # A piece of a ball: at its rim one axis has springs that the others lack.
    body = block((0.0, 0.0, 0.0), (3, 3, 3), H)
    inside = np.linalg.norm(body.X, axis=1) < 0.75
    part = {
        name: value[inside]
        for name, value in vars(body).items()
        if isinstance(value, np.ndarray) and len(value) == len(body)
    }
    body = replace(body, **part, volume=float(body.V0[inside].sum()))
    kicks = {}
    for mass in (LUMPED, CONSISTENT):
        solver = TotalLagrangian(
            body, [soft()], settings(frames=2, fps=1e3, substeps=1, mass=mass), pins=QUARTER,
            real=np.float64, plain=plain,
        )  # fmt: skip
        nodes, free = solver.body.stencil, solver.body.stencil.free_count
        assert nodes.factors is not None
        u = np.zeros((nodes.node_count, 3))
        u[:free] = np.random.default_rng(0).normal(scale=0.01 * H, size=(free, 3))
        u[free:] = nodes.factors * (nodes.follow @ u[:free])
        set_state(solver, u)
        solver.advance(1, 1)
        kicks[mass] = solver.state.view().v[:free]
    operator = solver.body.mass
    assert (operator.springs.data == 0.0).any()
    force = kicks[LUMPED] * operator.lumped[:, None]
    np.testing.assert_allclose(kicks[CONSISTENT], operator.acceleration(force), rtol=1e-9)
