"""Particles of a solid that begin to flow: what is kept, what is lost, what is gone back on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from slow_parameters import longest_but

from gf_usd.core.frames.particles import SurfaceSamples
from gf_usd.core.materials.conversion import STRAIN, STRESS, TIME, Conversion, Limit
from gf_usd.core.materials.material import Material
from gf_usd.core.materials.physical import PHYSICAL
from gf_usd.physics.updated_lagrangian.solver import UpdatedLagrangian
from gf_usd.verify.bodies import block, settings

SOLID = Material(
    name="solid", law="neoHookean", density=1000.0, youngs_modulus=1e5, poissons_ratio=0.3
)
HALF = slice(0, 32)
STILL = (0.0, 0.0, 0.0)
FAST = {"fps": 480.0, "time_codes_per_second": 480.0, "start": 1.0}


def turning(X):
    """[m/s] of what turns and contracts."""
    return np.cross([0.0, 0.0, 3.0], X) - 2.0 * X


def solver(limit: Limit, name: str = "honey", which=HALF, velocity=turning, floor=None, **changes):
    """A block of 64 elastic particles, some of which become a preset beyond a limit."""
    body = block((0.0, 0.05, 0.0), (2, 2, 2), 0.1)
    becomes = Conversion(particles=np.arange(64)[which], material=1, limit=limit)
    body = replace(body, conversions=(becomes,))
    grains = SurfaceSamples(X=body.X, area=body.V0 / body.spacing)
    return UpdatedLagrangian(
        body, [SOLID, PHYSICAL[name].material(1.0)],
        settings("cpu", **{"gravity": (0.0, 0.0, 0.0), "floor": floor, "solver": "ul", **changes}),
        samples=None if floor is None else grains,
        velocity=velocity, real=np.float64,
    )  # fmt: skip


def frames(run: UpdatedLagrangian, count: int):
    """Frames 0 to count."""
    walk = run.frames()
    return [next(walk) for _ in range(count + 1)]


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    longest_but(["honey", "powder-snow", "dry-sand", "toothpaste"], "powder-snow"),
)
def test_momenta_are_kept_and_the_energy_lost_is_counted(name: str) -> None:
    """The block implodes and turns; half of it is converted after two frames."""
    run = solver(Limit(kind=TIME, value=3.0), name, **FAST, frames=8)
    seen = frames(run, 3)
    before, now = seen[2].health, seen[3].health
    assert [f.health.converted for f in seen] == [0, 0, 0, 32]
    assert now.conversion_dissipation is not None
    assert now.conversion_dissipation > 0.0
    m, v = before.mass, np.linalg.norm(seen[2].particles.v, axis=1).max()
    # sums of some 64 x 27 float64 in each of a few hundred substeps
    rounding = 1e-11 * m * v
    assert now.momentum == pytest.approx(before.momentum, abs=rounding)
    assert now.angular_momentum == pytest.approx(before.angular_momentum, abs=rounding)
    # what APIC and viscosity take is not counted, so that no more is missing than is lost
    assert now.energy - before.energy + now.dissipation <= 1e-3 * before.energy


@pytest.mark.slow
def test_a_conversion_loses_what_the_stored_energies_differ_by() -> None:
    run = solver(Limit(kind=TIME, value=2.0), "powder-snow", **FAST, frames=4)
    frames(run, 1)
    run.conversions.frame(1)
    assert run.conversions.dissipated == 0.0
    elastic = run.read(1).health.elastic
    run.conversions.frame(2)
    lost = run.conversions.dissipated
    assert 0.0 < lost < elastic
    assert run.read(1).health.elastic == pytest.approx(elastic - lost, rel=1e-12)


def test_pressure_is_kept_by_what_is_stiffer_than_the_solid() -> None:
    """Honey with K = 10 K of the solid, compressed by a tenth of a percent."""
    run = solver(Limit(kind=TIME, value=1.0), which=slice(0, 64), frames=4, velocity=STILL)
    J = 0.999
    F = np.tile((np.cbrt(J) * np.eye(3)).ravel(), 64)
    run.state.put("F", F)
    history = run.state.rows("history", run.body.law.set.history)
    history[:, :9] = F.reshape(64, 9)
    run.state.put("history", history)
    K = (run.body.law.q[1] + 2.0 / 3.0 * run.body.law.q[0])[0]
    run.conversions.frame(1)
    after = (run.body.law.q[1] + 2.0 / 3.0 * run.body.law.q[0])[0]
    assert after > 2.0 * K
    J_e = np.linalg.det(run.state.elastic)
    # p = K (1 - J) to first order, whose error is some J - 1 of it
    assert after * (1.0 - J_e) == pytest.approx(K * (1.0 - J), rel=20.0 * (1.0 - J))


@pytest.mark.slow
def test_only_what_passes_its_limit_is_converted() -> None:
    stretched = np.diag([1.3, 1.0, 1.0])
    for limit, many in (
        (Limit(kind=STRAIN, value=np.log(1.31)), 0),
        (Limit(kind=STRAIN, value=np.log(1.29)), 5),
        (Limit(kind=STRESS, value=1e9), 0),
        (Limit(kind=STRESS, value=1e4), 5),
    ):
        run = solver(limit, which=slice(0, 64), frames=4, velocity=STILL)
        history = run.state.rows("history", run.body.law.set.history)
        history[10:15, :9] = stretched.ravel()
        run.state.put("history", history)
        F = run.state.rows("F", 9)
        F[10:15] = stretched.ravel()
        run.state.put("F", F)
        run.conversions.frame(1)
        assert np.flatnonzero(run.conversions.done).tolist() == list(range(10, 10 + many))
        assert run.body.law.of[10:15].tolist() == [int(many > 0)] * 5


def test_a_state_that_is_loaded_takes_conversions_back_and_does_them_again() -> None:
    run = solver(Limit(kind=TIME, value=2.0), "powder-snow", **FAST, frames=6)
    walk = run.frames()
    next(walk)
    first = next(walk)
    saved = run.save()
    rest = [next(walk) for _ in range(3)]
    assert rest[0].health.converted == 32
    run.load(saved)
    assert not run.conversions.done.any()
    again = list(zip(range(3), run.frames_after(1, first.health)))
    for one, (_, other) in zip(rest, again, strict=True):
        assert np.array_equal(one.particles.x, other.particles.x)
        assert np.array_equal(one.particles.F, other.particles.F)
        assert one.health == other.health
    other = solver(Limit(kind=TIME, value=2.0), "powder-snow", **FAST, frames=6)
    middle = run.save()
    other.load(middle)
    assert np.array_equal(other.conversions.done, run.conversions.done)
    assert np.array_equal(other.state.get("constants"), run.state.get("constants"))
    assert np.array_equal(other.state.get("viscosity"), run.state.get("viscosity"))


def test_the_floor_meets_a_particle_with_the_friction_of_what_it_became() -> None:
    run = solver(Limit(kind=TIME, value=1.0), "dry-sand", floor=0.0, frames=4)
    run.conversions.frame(1)
    assert run.body.contact is not None
    mu = run.body.contact.friction
    assert set(mu[:32]) == {PHYSICAL["dry-sand"].material(1.0).friction}
    assert set(mu[32:]) == {SOLID.friction}
    assert np.array_equal(run.state.rows("sample_constants", 7)[:, 3], mu)


@pytest.mark.slow
def test_the_step_is_short_enough_for_what_particles_become() -> None:
    stiff = replace(PHYSICAL["dry-sand"].material(1.0), youngs_modulus=1e8)
    body = block((0.0, 0.05, 0.0), (2, 2, 2), 0.1)
    chosen = settings("cpu", gravity=(0.0, 0.0, 0.0), floor=None, solver="ul")
    becomes = Conversion(particles=np.arange(8), material=1, limit=Limit(kind=TIME, value=1e9))
    plain = UpdatedLagrangian(body, [SOLID], chosen)
    ready = UpdatedLagrangian(replace(body, conversions=(becomes,)), [SOLID, stiff], chosen)
    ratio = stiff.youngs_modulus / SOLID.youngs_modulus
    assert ready.coarse > 0.5 * np.sqrt(ratio) * plain.coarse
