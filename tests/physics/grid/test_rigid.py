"""Rigid regions: mass, inertia, momenta, contact, and what they do to the flesh around them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contact_scenes import contact_solver
from solids import cube

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import InputError
from gf_usd.core.frames.particles import Particles
from gf_usd.core.stage import Pin
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import block, elastic, settings

H, TURN = 0.25, np.array([1.0, 2.0, 3.0])  # [m], [1/s]
NOWHERE = np.zeros((1, 4, 3))


def stone(inside) -> Pin:
    return Pin(
        name="stone", inside=inside, nearest=lambda X: X, anchors=NOWHERE[0], path=NOWHERE,
        sharp=False, rigid=True,
    )  # fmt: skip


def bar() -> tuple[Particles, Floats, Floats]:
    """Six cells along x, the masses of its particles [kg] and their center [m]."""
    body = block((0.0, 0.0, 0.0), (6, 3, 2), H)
    m = 1000.0 * body.V0
    return body, m, m @ body.X / m.sum()


@pytest.mark.slow
def test_a_region_with_free_flesh_keeps_the_momenta_of_the_whole() -> None:
    body, m, center = bar()
    solver = TotalLagrangian(
        body, [elastic(E=1e5, nu=0.3, density=1000.0)], settings("cpu", frames=9),
        pins=[stone(lambda X: X[:, 0] < 1.0)],
        velocity=lambda X: np.cross(TURN, X - center) + [1.0, 0.0, 0.0],
    )  # fmt: skip
    seen = [frame.health for frame in solver.frames()]
    assert seen[0].mass == pytest.approx(m.sum(), rel=1e-12)
    np.testing.assert_allclose(seen[0].center, center, atol=1e-6)
    np.testing.assert_allclose(seen[0].momentum, m.sum() * np.eye(3)[0], atol=1e-3)
    # float32 in some hundred substeps
    for name in ("momentum", "angular_momentum"):
        values = np.array([getattr(h, name) for h in seen])
        scale = np.abs(values).max()
        np.testing.assert_allclose(values, values[:1].repeat(9, 0), atol=1e-5 * scale)
    # Mass is lumped where flesh begins: inertia is larger by h^2 / 4 of some cells of six.
    inertia = m @ ((body.X - center) ** 2).sum(1) * np.eye(3)
    inertia -= ((body.X - center) * m[:, None]).T @ (body.X - center)
    spin = inertia @ TURN + np.cross(m.sum() * center, np.eye(3)[0])
    np.testing.assert_allclose(seen[0].angular_momentum, spin, rtol=0.05)
    E = [h.kinetic + h.elastic for h in seen]
    np.testing.assert_allclose(E, E[0], rtol=1e-4)  # (w dt)^2 / 4 of what vibrates


@pytest.mark.slow
def test_a_region_has_the_inertia_of_its_particles() -> None:
    """All but a sliver of a cell at the far end is rigid."""
    body, m, _ = bar()
    mine = body.X[:, 0] > 0.25
    solver = TotalLagrangian(
        replace(body, material=mine.astype(int)),
        [elastic(E=1.0, nu=0.3, density=rho) for rho in (1e-6, 1000.0)],
        settings("cpu", frames=1), pins=[stone(lambda X: X[:, 0] > 0.25)], real=np.float64,
    )  # fmt: skip
    regions = solver.body.regions
    assert regions is not None
    center = m[mine] @ body.X[mine] / m[mine].sum()
    away = body.X[mine] - center
    second = (away * m[mine, None]).T @ away
    inertia = np.trace(second) * np.eye(3) - second
    # what the nodes beyond the sliver have of the block's mass, they have at their own place
    np.testing.assert_allclose(regions.mass, m[mine].sum(), rtol=0.01)
    axes = regions.axes[0]
    np.testing.assert_allclose(
        (axes * regions.moments[0]) @ axes.T, inertia, atol=0.03 * inertia.max()
    )


@pytest.mark.slow
def test_a_region_keeps_its_shape_and_its_stiffness_takes_no_part_in_the_step() -> None:
    body, _, _ = bar()
    inside = body.X[:, 0] < 1.0
    table = [elastic(E=E, nu=0.3, density=1000.0) for E in (1e5, 1e9)]
    s = replace(settings("cpu", frames=9), gravity=(0.0, -9.81, 0.0))
    mixed = replace(body, material=inside.astype(int))
    solver = TotalLagrangian(mixed, table, s, pins=[stone(lambda X: X[:, 0] < 1.0)])
    soft = TotalLagrangian(body, table[:1], s)
    assert solver.coarse <= soft.coarse
    *_, last = TotalLagrangian(
        mixed, table, s, pins=[stone(lambda X: X[:, 0] < 1.0)],
        velocity=lambda X: np.cross(TURN, X),
    ).frames()  # fmt: skip
    F = last.particles.F[body.X[:, 0] < 0.75]
    np.testing.assert_allclose(F.swapaxes(1, 2) @ F, np.eye(3)[None].repeat(len(F), 0), atol=1e-5)
    assert np.abs(F - np.eye(3)).max() > 0.1, "it turned"


@pytest.mark.slow
def test_a_region_at_the_surface_bounces_off_the_floor() -> None:
    """Its lower half is rigid: contact acts on the region, and no energy comes of it."""
    solver = contact_solver(
        cube((0.0, 0.2, 0.0), (1.0, 1.0, 1.0)), particles=250, frames=17, floor=0.0,
        gravity=(0.0, -9.81, 0.0), pins=[stone(lambda X: X[:, 1] < 0.7)],
        changes={"friction": 0.0, "damping_time": 0.0}, filter_rate=0.0,
    )  # fmt: skip
    seen = [frame.health for frame in solver.frames()]
    low = min(h.center[1] for h in seen)
    assert seen[-1].center[1] > low + 0.02, "it came back"
    assert max(h.penetration for h in seen) < 0.5 * solver.particles.spacing
    E = np.array([h.energy for h in seen])
    assert np.diff(E).max() < 2e-3 * E.max()


@pytest.mark.slow
def test_a_region_continues_from_its_saved_state() -> None:
    def made() -> TotalLagrangian:
        body, _, center = bar()
        return TotalLagrangian(
            body, [elastic(E=1e5, nu=0.3, density=1000.0)], settings("cpu", frames=5),
            pins=[stone(lambda X: X[:, 0] < 1.0)],
            velocity=lambda X: np.cross(TURN, X - center),
        )  # fmt: skip

    first = made()
    frames, saved = [], {}
    for frame in first.frames():
        frames.append(frame)
        if frame.index == 2:
            saved = first.save()
    again = made()
    again.load(saved)
    rest = list(again.frames_after(2, frames[2].health))
    assert np.array_equal(rest[-1].particles.x, frames[-1].particles.x)


@pytest.mark.parametrize(("below", "message"), [(9.0, "holds all"), (0.01, "holds no particle")])
def test_a_region_that_holds_all_or_nothing_is_refused(below: float, message: str) -> None:
    body, _, _ = bar()
    table = [elastic(E=1e5, nu=0.3, density=1000.0)]
    region = stone(lambda X: X[:, 0] < below)
    with pytest.raises(InputError, match=message):
        TotalLagrangian(body, table, settings("cpu", frames=1), pins=[region])
