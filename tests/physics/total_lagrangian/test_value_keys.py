"""Material values that change with time: what they do to motion, energy and step."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from solids import ball, preset_material, settings

from gf_usd.core.materials.dimensionless import G0
from gf_usd.core.materials.keys import KEYED, ValueKeys
from gf_usd.core.materials.material import lame
from gf_usd.core.stage import ContactSetup, PhysicsMaterialSpec, Skin
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import block, elastic, mirror_plane
from gf_usd.verify.bodies import settings as case_settings
from gf_usd.verify.cases.contact.slope import base, plane


@pytest.fixture(scope="module")
def body():
    return ball(300)[0]


def with_keys(body, made, times, **changes):
    """The body with values over time for all particles; the others stay those of a material."""
    values = {
        name: np.broadcast_to(np.asarray(changes.get(name, getattr(made, name)), float)[..., None],
                              (len(times), 1))
        for name in KEYED
    }  # fmt: skip
    keys = ValueKeys(times=np.asarray(times, float), values=values, of=np.zeros(len(body), int))
    return replace(body, keys=keys)


def rubber(body):
    return preset_material("rubber", body, damping_time=0.0, law="neoHookean")


def keyed(body, times, factors):
    """The body with one factor of Young's modulus for all particles."""
    made = rubber(body)
    young = made.youngs_modulus * np.asarray(factors, float)
    return with_keys(body, made, times, youngs_modulus=young)


def solver(particles, stiffer=1.0, **changes):
    """A ball of rubber without damping that starts to swing."""
    made = rubber(particles)
    made = replace(made, youngs_modulus=stiffer * made.youngs_modulus)
    stretched = np.diag([2.0, -1.0, -1.0])
    return TotalLagrangian(
        particles, [made], settings(**changes), velocity=lambda X: X @ stretched, real=np.float64
    )


def groups(young):
    """Values of groups of particles (K, G), of which Young's modulus changes."""
    young = np.asarray(young, float)
    values = {"poissons_ratio": 0.25, "damping_time": 0.1, "friction": 0.5}
    return {"youngs_modulus": young, **{n: np.full_like(young, v) for n, v in values.items()}}


def test_values_are_straight_between_keys_and_the_same_beyond():
    keys = ValueKeys(
        times=np.array([10.0, 20.0]), values=groups([[1, 2], [3, 1]]), of=np.array([1, 0, 1])
    )
    for code, wanted in ((0.0, [2, 1, 2]), (10.0, [2, 1, 2]), (15.0, [1.5, 2, 1.5]),
                         (20.0, [1, 3, 1]), (99.0, [1, 3, 1])):  # fmt: skip
        now = keys.at(code)
        np.testing.assert_allclose(now["youngs_modulus"], wanted, rtol=1e-15)
        for name, one in zip(("mu", "lam"), lame(np.array(wanted), 0.25), strict=True):
            np.testing.assert_allclose(now[name], one, rtol=1e-15)
    most = keys.most([12.0, 15.0])
    np.testing.assert_allclose(most["youngs_modulus"], [1.8, 2.0, 1.8], rtol=1e-15)
    assert [keys.changes(name) for name in KEYED] == [True, False, False, False]
    alone = ValueKeys(times=np.array([3.0]), values=groups([[2.0]]), of=np.array([0]))
    np.testing.assert_array_equal(alone.at(-1.0)["youngs_modulus"], [2.0])


@pytest.mark.slow
def test_a_factor_that_stays_is_another_material(body):
    """Four times the moduli from the start are four times the moduli."""
    frames = [
        list(one.frames())
        for one in (solver(keyed(body, [0.0, 99.0], [4.0, 4.0])), solver(body, stiffer=4.0))
    ]
    for ours, plain in zip(*frames, strict=True):
        np.testing.assert_allclose(ours.particles.x, plain.particles.x, atol=1e-12)
        assert ours.health.elastic == pytest.approx(plain.health.elastic, rel=1e-9, abs=1e-12)
        assert ours.health.substeps == plain.health.substeps
        assert ours.health.work == 0.0


@pytest.mark.slow
def test_the_work_of_stiffening_is_in_the_energy_book(body):
    """Moduli that rise fourfold give a swinging ball energy, all of which is work.

    What is left in each frame is the error of the integrator, of second order in the step: a
    sixteenth with a quarter of the step, of which half is required.
    """
    left = []
    for safety in (0.5, 0.125):
        frames = list(solver(keyed(body, [1.0, 10.0], [1.0, 4.0]), safety=safety).frames())
        total = frames[0].health.energy
        gains = [
            (now.health.energy - last.health.energy, now.health.work)
            for last, now in pairwise(frames)
        ]
        assert sum(gain for gain, _ in gains) > 0.2 * total
        left.append(max(abs(gain - work) for gain, work in gains) / total)
    assert left[0] < 0.02  # what the guard lets pass
    assert left[1] < left[0] / 8.0


@pytest.mark.slow
def test_the_step_follows_the_stiffest_moduli(body):
    """Waves are twice as fast at four times the moduli, whenever they come."""
    soft = solver(body)
    stiff = solver(keyed(body, [1.0, 10.0], [1.0, 4.0]))
    # The middle of the last way is half a frame before the last key.
    assert soft.body.step.dt / stiff.body.step.dt == pytest.approx(np.sqrt(1 + 3 * 8.5 / 9))
    early = solver(keyed(body, [100.0, 109.0], [1.0, 4.0]))
    assert early.body.step.dt == soft.body.step.dt


@pytest.mark.slow
def test_a_bake_continues_identically_from_a_checkpoint(body):
    particles = keyed(body, [1.0, 10.0], [1.0, 4.0])
    whole = solver(particles)
    frames = list(whole.frames())
    first = solver(particles)
    steps = first.frames()
    for _ in range(5):
        frame = next(steps)
    later = solver(particles)
    later.load(first.save())
    rest = list(later.frames_after(4, frame.health))
    assert np.array_equal(rest[-1].particles.x, frames[-1].particles.x)
    assert [f.health.work for f in rest] == [f.health.work for f in frames[5:]]


CELLS, SPEED = 8, 24.0
H = 1.0 / CELLS


def column(keys_of, made, frames, **more):
    """A column of 1 m between symmetry planes, from one at y = 0: it strains along y only."""
    body = block(np.zeros(3), (1, CELLS, 1), H)
    planes = [mirror_plane(axis, 0.0) for axis in range(3)]
    planes += [
        replace(mirror_plane(axis, H), name=f"above{axis}", inside=lambda X, a=axis: X[:, a] > H)
        for axis in (0, 2)
    ]
    s = case_settings(
        "cpu", frames=frames, **{"gravity": (0.0, 0.0, 0.0), **more.pop("options", {})}
    )
    return TotalLagrangian(keys_of(body), [made], s, pins=planes, real=np.float64, **more)


@pytest.mark.slow
def test_the_sag_of_a_hanging_column_follows_both_moduli():
    """rho g L^2 / (3 M) on average, M = E (1 - nu) / ((1 + nu) (1 - 2 nu)), once it is at rest.

    Straight cells leave out h^2 / 12 of L^2 / 3, 0.4 %.
    """
    made = elastic(E=1e6, nu=0.3, density=1000.0, damping_time=0.03, restitution=0.5, friction=0.5)
    still = 20  # frames, in which what swings decays by more than e^-10
    steps = [(1e6, 0.3), (1e6, 0.45), (2e6, 0.45)]
    times = np.ravel([[k * still, k * still + still - 4] for k in range(len(steps))])
    young, poisson = np.repeat(np.array(steps), 2, axis=0).T
    start = case_settings("cpu").start

    def keys_of(body):
        return with_keys(body, made, start + times, youngs_modulus=young, poissons_ratio=poisson)

    bar = column(keys_of, made, still * len(steps), options={"gravity": (0.0, G0, 0.0)})
    X = bar.particles.X[:, 1]
    sags = [float((f.particles.x[:, 1] - X).mean()) for f in bar.frames()]
    for k, (E, nu) in enumerate(steps):
        M = E * (1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu))
        assert sags[(k + 1) * still - 5] == pytest.approx(1000.0 * G0 / (3.0 * M), rel=0.005)


@pytest.mark.slow
def test_a_vibration_decays_as_the_damping_time_says():
    """ln E falls by w^2 (2 mu / M) times the integral of tau, w = (pi / 2) sqrt(M / rho) / L.

    It wobbles by rate / 2 w around that, twice a period, which is 0.08 at the end.
    """
    made = elastic(E=1e5, nu=0.3, density=1000.0, damping_time=0.0, restitution=0.5, friction=0.5)
    frames, most = 25, 0.016
    start = case_settings("cpu").start

    def keys_of(body):
        return with_keys(
            body, made, [start, start + frames - 1], damping_time=np.array([0.0, most])
        )

    speed = 1e-3

    def swing(X):
        return speed * np.outer(np.sin(0.5 * np.pi * X[:, 1]), [0.0, 1.0, 0.0])

    bar = column(keys_of, made, frames, velocity=swing)
    every = list(bar.frames())
    mu, lam = lame(1e5, 0.3)
    M = lam + 2.0 * mu
    rate = 0.25 * np.pi**2 * M / 1000.0 * 2.0 * mu / M  # per second of tau, and time
    t = np.arange(frames) / SPEED
    T = t[-1]
    held = np.log([(f.health.kinetic + f.health.elastic) / every[0].health.kinetic for f in every])
    wanted = -rate * most * t**2 / (2.0 * T)
    assert wanted[-1] < -1.4
    # 2 % of the exponent: w of eight cells is off by less than 1 %
    np.testing.assert_allclose(held, wanted, rtol=0.02, atol=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("obstacle", [False, True])
def test_what_slides_is_braked_by_the_friction_of_the_moment(obstacle):
    """dv/dt = g (sin - mu(t) cos) on a slope of 35 degrees, mu straight from 0.1 to 0.6."""
    lean, frames = np.radians(35.0), 25
    options = {
        "frames": frames, "floor": None if obstacle else 0.0,
        "gravity": (G0 * np.sin(lean), -G0 * np.cos(lean), 0.0), "rolling": 0.0, "settling": False,
    }  # fmt: skip
    made = elastic(E=1e6, nu=0.3, density=1000.0, friction=0.1, restitution=0.1, damping_time=0.01)
    s = case_settings("cpu", **options)
    body = with_keys(
        block(np.zeros(3), (2, 2, 2), 0.5), made, [s.start, s.start + frames - 1],
        friction=np.array([0.1, 0.6]),
    )  # fmt: skip
    under = replace(plane(), spec=PhysicsMaterialSpec())
    cube = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    skin = Skin(points=cube, triangles=np.array([[0, 4, 5], [0, 5, 1]]))
    setup = ContactSetup(skins=(skin,), colliders=(under,)) if obstacle else None
    one = TotalLagrangian(body, [made], s, samples=base(2), contact_setup=setup)
    m = one.body.stencil.mass
    speeds = []
    for _ in one.frames():
        speeds.append(float(m @ one.state.view().v[:, 0] / m.sum()))
    t = np.arange(frames) / SPEED
    mean = 0.1 + 0.5 * t / (2.0 * t[-1])
    wanted = G0 * t * (np.sin(lean) - mean * np.cos(lean))
    # The block lands softly on its springs: the first few hundredths of a second it weighs less.
    assert np.abs(np.array(speeds) - wanted).max() < 0.03 * wanted.max()


@pytest.mark.slow
def test_damping_and_friction_continue_identically_from_a_checkpoint():
    made = elastic(E=1e5, nu=0.3, density=1000.0, friction=0.1, restitution=0.1, damping_time=0.0)
    s = case_settings("cpu", frames=9, floor=0.0, gravity=(5.0, -8.0, 0.0))
    body = with_keys(
        block(np.zeros(3), (2, 2, 2), 0.5), made, [s.start, s.start + 8],
        friction=np.array([0.1, 0.9]), damping_time=np.array([0.0, 0.02]),
        poissons_ratio=np.array([0.2, 0.4]),
    )  # fmt: skip
    whole, first, later = (TotalLagrangian(body, [made], s, samples=base(2)) for _ in range(3))
    frames = list(whole.frames())
    steps = first.frames()
    for _ in range(4):
        frame = next(steps)
    later.load(first.save())
    rest = list(later.frames_after(3, frame.health))
    assert len(rest) == 5
    for ours, theirs in zip(rest, frames[4:], strict=True):
        np.testing.assert_array_equal(ours.particles.x, theirs.particles.x)
        assert ours.health.work == theirs.health.work
