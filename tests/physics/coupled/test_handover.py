"""A body that leaves the solver of solids for that of what flows: what it takes along."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from solids import cube, settings, solid

from gf_usd.core.errors import UsageError
from gf_usd.core.frames.settings import MIXED
from gf_usd.core.materials.conversion import STRAIN, TIME, Conversion, Limit
from gf_usd.core.materials.presets import find_preset
from gf_usd.core.stage import Pin, StagePhysics
from gf_usd.geometry.sampling.contact_samples import sample_surface
from gf_usd.geometry.sampling.particles import sample_solid
from gf_usd.physics.coupled.handover import Converting
from gf_usd.physics.coupled.solver import Coupled
from gf_usd.physics.coupled.transfer import SolidState, conserving_velocities, read_solid, solid_of
from gf_usd.physics.solvers import make_solver
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.physics.updated_lagrangian.solver import UpdatedLagrangian
from gf_usd.prepare.bodies.contact import contact_setup
from gf_usd.prepare.bodies.plan import BodyPlan

FAST = {"fps": 240.0, "time_codes_per_second": 240.0, "start": 0.0}


def turning(X):
    """[m/s] of what turns and is drawn out along x."""
    return np.cross([0.0, 2.0, 3.0], X) + X * [1.0, -0.5, -0.5]


def converting(
    materials: tuple[str, ...],
    becomes: dict[int, tuple[str, Limit]],
    particles: int = 250,
    velocity: Any = turning,
    scatter: bool = False,
    **options: Any,
) -> Converting:
    """Cubes of 1 m in a row, 1.5 m apart, of a preset each; some of which become another."""
    count = len(materials)
    surfaces = [cube((1.5 * k, 0.0, 0.0), path=f"/Body{k}") for k in range(count)]
    made, of = solid(*surfaces), np.arange(count)
    filled = sample_solid(
        made, particles=particles * count, spacing=None, seed=0, bodies=of,
        later=np.full(count, scatter),
    )  # fmt: skip
    body = of[filled.surface]
    table = [find_preset(name).material(0.62, None) for name in materials]
    conversions = []
    for k, (name, limit) in becomes.items():
        rows = np.flatnonzero(body == k)
        conversions.append(Conversion(particles=rows, material=len(table), limit=limit))
        table.append(find_preset(name).material(0.62, None))
    filled = replace(filled, body=body, material=body, conversions=tuple(conversions))
    plan = BodyPlan(
        of_surface=of, radius=filled.radii, surfaces=tuple((s.path,) for s in surfaces),
        embedded={s.path: k for k, s in enumerate(surfaces)},
    )  # fmt: skip
    solver = make_solver(
        settings(**{"solver": MIXED, **FAST, **options}), filled, table,
        samples=sample_surface(made, filled.spacing, of),
        embedded={s.path: s.points for s in surfaces}, embedded_body=plan.embedded,
        velocity=velocity, real=np.float64,
        contact_setup=contact_setup(
            made, plan, StagePhysics(), spacing=filled.spacing, self_contact=False
        ),
    )  # fmt: skip
    assert isinstance(solver, Converting)
    return solver


def at(code: float, name: str = "powder-snow") -> tuple[str, Limit]:
    return name, Limit(kind=TIME, value=code)


@pytest.mark.slow
def test_momenta_and_energy_are_those_before() -> None:
    run = converting(("rubber",), {0: at(2.0)}, frames=5)
    assert isinstance(run.now, TotalLagrangian)
    walk = run.frames()
    next(walk)
    next(walk)
    frame = run.now.next(2, run.read(1).health)  # as it is before
    assert run._hand_over(frame, 2) is not frame
    after = run.now.read(2)
    assert isinstance(run.now, UpdatedLagrangian)
    before, now = frame.health, after.health
    m, v = before.mass, float(np.linalg.norm(frame.particles.v, axis=1).max())
    rounding = 1e-12 * m * v
    assert now.momentum == pytest.approx(before.momentum, abs=rounding)
    assert now.angular_momentum == pytest.approx(before.angular_momentum, abs=rounding)
    assert now.elastic == pytest.approx(before.elastic, rel=1e-12)
    assert np.allclose(after.particles.x, frame.particles.x, atol=1e-12)
    assert np.allclose(after.particles.F, frame.particles.F, atol=1e-12)
    # the affine motion makes up for what particles see less of; w changes it by its square
    assert now.kinetic == pytest.approx(before.kinetic, rel=1e-2)


@pytest.mark.slow
def test_what_is_converted_goes_to_random_places() -> None:
    """Where the motion of each particle takes them, with the momenta of before."""
    run = converting(("rubber", "rubber"), {0: at(2.0)}, scatter=True, frames=5)
    d, X = run._moved, run.particles.X
    mine = np.asarray(run.particles.body) == 0
    moved = mine & d.any(1)
    assert 0 < moved.sum() < mine.sum()  # the outermost stay
    assert run.particles.scatter[~mine].any()
    assert not d[~mine].any()  # of what is not converted nothing moves
    np.testing.assert_allclose(run.particles.V0 @ d, 0.0, atol=1e-15)  # nor does the center
    plain = converting(("rubber", "rubber"), {0: at(2.0)}, frames=5)
    walk, other = run.frames(), plain.frames()
    for _ in range(2):
        np.testing.assert_array_equal(next(walk).particles.x, next(other).particles.x)
    frame = run.now.next(2, run.read(1).health)  # as it is before
    after = run._hand_over(frame, 2)
    there = frame.particles.x + np.einsum("nab,nb->na", frame.particles.F, d)
    np.testing.assert_allclose(after.particles.x, there, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(after.particles.F, frame.particles.F, atol=1e-12)
    flow = run.now.flow.body.particles
    np.testing.assert_array_equal(flow.X, (X + d)[mine])
    before, now = frame.health, after.health
    m, v = before.mass, float(np.linalg.norm(frame.particles.v, axis=1).max())
    assert now.momentum == pytest.approx(before.momentum, abs=1e-12 * m * v)
    assert now.angular_momentum == pytest.approx(before.angular_momentum, abs=1e-12 * m * v)
    assert now.elastic == pytest.approx(before.elastic, rel=1e-12)
    assert now.kinetic == pytest.approx(before.kinetic, rel=1e-2)


def test_velocities_are_those_of_the_random_places() -> None:
    """Of an affine motion exactly: v = A x before and after, but for what conserves momenta."""
    n = 50
    random = np.random.default_rng(5)
    A = random.normal(size=(3, 3))
    F = np.eye(3) + 0.2 * random.normal(size=(3, 3))
    X, d = random.normal(size=(n, 3)), 0.1 * random.normal(size=(n, 3))
    many = np.broadcast_to(np.eye(3), (n, 3, 3))
    one = SolidState(
        body=0, x=X @ F.T, v=X @ F.T @ A.T, F=many @ F, elastic=many @ F, L=many @ A, internal={},
        momentum=np.zeros(3), spin=np.zeros(3), kinetic=0.0,
    ).moved(d)  # fmt: skip
    np.testing.assert_allclose(one.x, (X + d) @ F.T, atol=1e-12)
    np.testing.assert_allclose(one.v, one.x @ A.T, atol=1e-12)


@pytest.mark.slow
@pytest.mark.acceptance
def test_the_frame_says_what_the_change_of_solver_gave() -> None:
    run = converting(("rubber",), {0: at(2.0)}, frames=6)
    seen = list(run.frames())
    assert [f.health.converted for f in seen] == [0, 0, 0, *[len(run.particles)] * 3]
    for one, other in pairwise(seen):
        a, b = one.health, other.health
        gain = b.energy - a.energy - b.work - b.injected + b.dissipation
        assert gain <= 1e-3 * a.energy
    assert abs(seen[2].health.injected) < 1e-2 * seen[1].health.energy
    assert [f.converted.sum() for f in seen] == [f.health.converted for f in seen]


@pytest.mark.slow
def test_what_stays_solid_continues_as_it_was() -> None:
    """Apart from the body that leaves, as if that had never been in its solver."""
    alone = converting(("rubber", "rubber"), {0: at(99.0)}, frames=6, stress=True)
    left = converting(("rubber", "rubber"), {0: at(2.0)}, frames=6, stress=True)
    plain, other = list(alone.frames()), list(left.frames())
    assert isinstance(left.now, Coupled)
    mine = np.asarray(left.particles.body) == 1
    h = np.asarray(left.particles.lattice) * 2.0
    for k in (1, 2):
        assert np.allclose(plain[k].particles.x, other[k].particles.x, rtol=0.0, atol=1e-12)
        most = float(plain[k].stress.max())
        assert np.allclose(plain[k].stress[mine], other[k].stress[mine], atol=1e-9 * most)
    # the number of substeps is that of the stiffer solver, so that later frames differ by its order
    for k in (3, 4, 5):
        way = np.abs(plain[k].particles.x[mine] - other[k].particles.x[mine]).max()
        assert way < 1e-4 * h


@pytest.mark.slow
@pytest.mark.parametrize(
    "last", ["powder-snow", pytest.param("honey", marks=pytest.mark.acceptance)]
)
def test_bodies_leave_one_by_one_and_a_flow_is_joined(last: str) -> None:
    run = converting(
        ("rubber", "powder-snow", "rubber"), {0: at(2.0), 2: at(4.0, last)},
        particles=120, frames=7,
    )  # fmt: skip
    body = np.asarray(run.particles.body)
    kinds, seen = [], []
    for frame in run.frames():
        kinds.append(run.flows.tolist())
        seen.append([int(frame.converted[body == k].sum()) for k in range(3)])
        x = np.array([frame.particles.x[body == k].mean(0) for k in range(3)])
        assert np.isfinite(frame.particles.x).all()
        assert x[:, 0] == pytest.approx(1.5 * np.arange(3) + 0.5, abs=0.5)
    count = [int((body == k).sum()) for k in range(3)]
    assert kinds == [[0, 1, 0]] * 2 + [[1, 1, 0]] * 2 + [[1, 1, 1]] * 3
    assert seen == [[0, 0, 0]] * 3 + [[count[0], 0, 0]] * 2 + [[count[0], 0, count[2]]] * 2
    assert isinstance(run.now, UpdatedLagrangian)


@pytest.mark.slow
def test_a_checkpoint_continues_identically_before_and_after() -> None:
    def made() -> Converting:
        return converting(("rubber", "rubber"), {0: at(2.0)}, 120, scatter=True, frames=7)

    run = made()
    whole, saved = [], {}
    for frame in run.frames():
        whole.append(frame)
        saved[frame.index] = run.save()
    for since in (1, 2, 4):
        other = made()
        other.load(saved[since])
        again = list(other.frames_after(since, whole[since].health))
        for one, two in zip(whole[since + 1 :], again, strict=True):
            assert np.array_equal(one.particles.x, two.particles.x)
            assert np.array_equal(one.particles.v, two.particles.v)
            assert np.array_equal(one.converted, two.converted)


@pytest.mark.slow
def test_plastic_strain_goes_along() -> None:
    """A block of wax, beyond its yield stress, of which the strain makes a flow."""
    run = converting(
        ("wax",), {0: ("dry-sand", Limit(kind=STRAIN, value=0.002))}, frames=4,
        velocity=lambda X: X * [8.0, -4.0, -4.0],
    )  # fmt: skip
    frames = run.frames()
    next(frames)
    one = read_solid(solid_of(run.now), 0)
    names = set(one.internal)
    assert names, "the law has internal variables"
    next(frames)
    flow = run.now
    assert isinstance(flow, UpdatedLagrangian)
    known = flow.body.law.internal(flow.state.rows("history", flow.body.law.set.history))
    assert names <= set(known)


def test_matched_motion_has_the_momenta_that_were_asked_for() -> None:
    rng = np.random.default_rng(3)
    body = converting(("rubber",), {0: at(9.0)})
    one = read_solid(solid_of(body.now), 0)
    m = rng.uniform(1.0, 2.0, len(one.x))
    one = replace(one, momentum=np.array([1.0, 2.0, 3.0]), spin=np.array([-3.0, 5.0, 4.0]))
    v, C = conserving_velocities(one, m, 0.3)
    spread = 0.25 * 0.3**2
    axial = np.stack([C[:, 2, 1] - C[:, 1, 2], C[:, 0, 2] - C[:, 2, 0], C[:, 1, 0] - C[:, 0, 1]], 1)
    assert m @ v == pytest.approx(one.momentum, abs=1e-11)
    assert m @ (np.cross(one.x, v) + spread * axial) == pytest.approx(one.spin, abs=1e-10)


def test_pins_are_refused() -> None:
    run = converting(("rubber",), {0: at(9.0)})
    held = Pin(
        name="top", inside=lambda X: X[:, 1] > 0.5, nearest=lambda X: X,
        anchors=np.zeros((1, 3)), path=np.zeros((1, 1, 3)),
    )  # fmt: skip
    with pytest.raises(UsageError, match="does not support pins"):
        Converting(
            run.particles, run._materials, run.settings, samples=run._samples,
            contact_setup=run._setup, pins=[held],
        )  # fmt: skip
