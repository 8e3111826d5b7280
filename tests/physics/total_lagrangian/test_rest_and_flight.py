"""Frames without substeps: what they agree with, and what ends them."""

from __future__ import annotations

from typing import Any

import contact_scenes
import numpy as np
import pytest
from solids import CUBE_POINTS, CUBE_TRIANGLES, cube, sphere

from gf_usd.core.frames.frame import AT_REST
from gf_usd.core.materials.dimensionless import G0
from gf_usd.physics.total_lagrangian.rest_and_flight import FLIGHT

RADIUS = 0.5  # [m]
FPS = 24.0
DOWN = (0.0, -G0, 0.0)
AWAKE = 100.0  # [s] at rest: longer than anyone waits


def contact_solver(*surfaces: Any, **options: Any):
    """As a bake has it, with shortcuts unless they are switched off."""
    return contact_scenes.contact_solver(*surfaces, **{"shortcuts": True, **options})


def ball(height: float, x: float = 0.0, path: str = "/Ball"):
    """Whose lowest point is at a height [m]."""
    return sphere(RADIUS, center=(x, RADIUS + height, 0.0), subdivisions=2, path=path)


def falling(height: float = 2.0, *, frames: int = 20, **options):
    world = {"fps": FPS, "gravity": DOWN, "floor": 0.0}
    return contact_solver(ball(height), particles=250, frames=frames, **world, **options)


def asleep(solver, *bodies: int) -> None:
    """As if they had been at rest for long."""
    solver.shortcuts.at_rest[list(bodies)] = AWAKE


@pytest.mark.slow
def test_a_drop_with_and_without_agrees():
    with_, without = (list(falling(shortcuts=on).frames()) for on in (True, False))
    flew = [frame.health.flying for frame in with_]
    # 2 m take 15 frames; the last of them may touch.
    assert sum(flew) >= 10
    assert not any(frame.health.flying for frame in without)
    assert max(frame.health.penetration for frame in with_) > 0.0, "it has bounced"
    for a, b in zip(with_, without):
        # Both round u and v to single precision at a few meters and meters a second: 1e-7 each
        # frame, and a bounce of a soft ball stretches that by its strain of some tens of percent.
        # A motion at the skin may have a quarter of the lumped mass, and so twice the speed.
        np.testing.assert_allclose(a.particles.x, b.particles.x, atol=2e-5 * RADIUS)
        np.testing.assert_allclose(a.particles.v, b.particles.v, atol=2e-4 * np.sqrt(G0 * RADIUS))


def test_flight_is_the_parabola_and_keeps_energy_and_momentum():
    solver = falling(5.0, frames=12, velocity=(1.0, 2.0, -0.5))
    frames = list(solver.frames())
    first, last = frames[0].health, frames[-1].health
    assert all(f.health.flying == 1 and f.health.substeps == 0 for f in frames[1:])
    t = solver.state.time
    g = np.array([0.0, -G0, 0.0])
    way = t * np.array([1.0, 2.0, -0.5]) + 0.5 * g * t**2
    # v is kept in single precision: 6e-8 of 5 m/s a frame, over half a second and 11 frames.
    moved = frames[-1].particles.x - frames[0].particles.x
    np.testing.assert_allclose(moved, np.broadcast_to(way, moved.shape), atol=1e-6)
    np.testing.assert_allclose(
        np.array(last.momentum), np.array(first.momentum) + last.mass * g * t, rtol=1e-6, atol=1e-3
    )
    total = [h.kinetic + h.potential + h.elastic for h in (first, last)]
    assert total[1] == pytest.approx(total[0], rel=1e-6)
    # About its own middle it does not begin to turn.
    spin = np.array(last.angular_momentum) - np.cross(last.center, last.momentum)
    assert np.abs(spin).max() < 1e-5 * last.mass * RADIUS * 5.0


@pytest.mark.parametrize("what", ["strained", "turning", "dragged", "floor"])
def test_what_is_no_free_flight_is_simulated(what):
    if what == "floor":
        solver = falling(1e-3, frames=2)
    elif what == "turning":
        solver = falling(velocity=lambda X: np.cross([0.0, 0.0, 1.0], X), frames=2)
    elif what == "dragged":
        solver = falling(drag=0.1, frames=2)
    else:
        solver = falling(frames=2)
        X = solver.body.stencil.node_X
        stretch = 3.0 * FLIGHT * (X - X.mean(0))
        solver.state.arrays["u"].from_numpy(stretch.astype(np.float32).ravel())
    frame = list(solver.frames())[-1]
    assert frame.health.flying == 0
    assert frame.health.substeps > 0


def test_a_body_that_came_to_rest_sleeps_and_stays():
    # Damped so much that it settles within two seconds of falling a millimeter (measured).
    solver = contact_solver(
        cube(low=(0.0, 1e-3, 0.0)), particles=64, frames=80, fps=FPS, gravity=DOWN, floor=0.0,
        changes={"damping_time": 0.03, "restitution": 0.0},
    )  # fmt: skip
    frames = list(solver.frames())
    slept = [frame.index for frame in frames if frame.health.sleeping]
    assert slept, [frame.health.kinetic for frame in frames[-3:]]
    begin = slept[0]
    assert slept == list(range(begin, 80)), "nothing woke it"
    before = frames[begin - 1].health
    r = solver.particles.radius
    assert before.kinetic <= AT_REST * before.mass * G0 * r
    # It had been that quiet for T = sqrt(r / g0), 0.25 s or 6 frames.
    assert frames[begin - 6].health.kinetic <= AT_REST * before.mass * G0 * r
    for frame in frames[begin:]:
        assert frame.health.kinetic == 0.0
        assert frame.health.substeps == 0
        assert frame.health.penetration == before.penetration > 0.0
        np.testing.assert_allclose(frame.particles.x, frames[begin - 1].particles.x, atol=1e-6)


@pytest.mark.slow
def test_a_bent_body_flies_sleeps_and_stays_bent_and_is_resumed_to_the_bit():
    def made():
        return contact_solver(
            cube(low=(0.0, 0.6, 0.0)), particles=64, frames=40, fps=FPS, gravity=DOWN, floor=0.0,
            material="clay", changes={"damping_time": 0.03, "restitution": 0.0},
        )  # fmt: skip

    def plastic(solver):
        return solver.state.view().internal(np.ones((64, 3)))["plastic_strain"]

    solver, other = made(), made()
    seen, standing = [], None
    for frame in solver.frames():
        seen.append((frame, plastic(solver)))
        if frame.health.sleeping and standing is None:
            standing = frame.index, solver.save(), frame.health
    assert seen[3][0].health.flying == 1
    assert standing is not None, [frame.health.kinetic for frame, _ in seen[-3:]]
    index, saved, health = standing
    frame, strain = seen[index]
    assert strain.max() > 0.01
    bent = np.abs(np.linalg.svd(frame.particles.F)[1] - 1.0).max()
    assert bent > 0.5 * strain.max(), "of one axis it is all, of shear the root of 3/4"
    for later, kept in seen[index + 1 :]:
        assert later.health.sleeping == 1
        np.testing.assert_array_equal(kept, strain)
        np.testing.assert_array_equal(later.particles.F, frame.particles.F)
    other.load({name: np.array(value) for name, value in saved.items()})
    for (a, kept), b in zip(seen[index + 1 :], other.frames_after(index, health), strict=True):
        np.testing.assert_array_equal(a.particles.x, b.particles.x)
        np.testing.assert_array_equal(kept, plastic(other))
        assert a.health == b.health


def test_without_gravity_nothing_sleeps():
    solver = contact_solver(
        ball(1.0), particles=200, frames=3, fps=FPS, gravity=(0.0, 0.0, 0.0),
        velocity=lambda X: 1e-4 * np.cross([0.0, 0.0, 1.0], X),
    )  # fmt: skip
    asleep(solver, 0)
    assert not any(frame.health.sleeping for frame in solver.frames())


@pytest.mark.slow
def test_a_body_that_falls_on_a_sleeper_wakes_it():
    solver = contact_solver(
        ball(0.0, path="/Sleeper"), ball(3.0, path="/Faller"), particles=250, frames=24, fps=FPS,
        gravity=DOWN, floor=0.0,
    )  # fmt: skip
    body = solver.particles.body
    assert body is not None
    sleeper = 0 if solver.particles.X[body == 0, 1].mean() < 1.5 else 1
    frames = iter(solver.frames())
    rest = next(frames).particles.x[body == sleeper]
    asleep(solver, sleeper)
    still, hit = 0, None
    for frame in frames:
        moved = np.abs(frame.particles.x[body == sleeper] - rest).max()
        if frame.health.sleeping:
            assert (frame.health.flying, frame.health.sleeping) == (1, 1)
            assert moved < 1e-6
            # a faller that is not expected flies on into the sleeper, down to the floor
            assert frame.particles.x[body != sleeper, 1].min() > rest[:, 1].max()
            still += 1
        elif moved > 0.05 * RADIUS and hit is None:
            hit = frame.index
    # 2 m between them: 15 frames, of which the last few may touch.
    assert still >= 10
    assert hit is not None
    assert frame.health.kinetic > 0.0


@pytest.mark.slow
def test_an_obstacle_that_comes_wakes_a_sleeper():
    stays, comes = np.zeros((8, 3)), np.zeros((8, 3))
    comes[4:, 0] = 0.6 * np.arange(1, 5)
    woken = []
    for way in (stays, comes):
        wall = contact_scenes.obstacle(CUBE_POINTS + [-2.2, 0.0, -0.5], CUBE_TRIANGLES, offset=way)
        solver = contact_solver(
            ball(0.0), particles=250, frames=8, fps=FPS, gravity=DOWN, floor=0.0, colliders=(wall,)
        )  # fmt: skip
        asleep(solver, 0)
        woken.append([not frame.health.sleeping for frame in solver.frames()][1:])
    assert not any(woken[0])
    assert not any(woken[1][:3])
    assert woken[1][-1]


@pytest.mark.slow
@pytest.mark.parametrize("at", [4, 13])
def test_resumed_in_flight_or_asleep_it_continues_bit_identically(at):
    def made():
        return contact_solver(
            ball(0.0, x=-1.5, path="/Sleeper"), ball(1.0, x=1.5, path="/Faller"), particles=400,
            frames=18, fps=FPS, gravity=DOWN, floor=0.0,
        )  # fmt: skip

    whole = made()
    asleep(whole, 0, 1)
    whole.shortcuts.at_rest[
        1 if whole.particles.X[whole.particles.body == 1, 1].mean() > 1 else 0
    ] = 0
    frames, standing, health = [], None, None
    for frame in whole.frames():
        frames.append(frame)
        if frame.index == at:
            standing, health = whole.save(), frame.health
    assert frames[at].health.sleeping + frames[at].health.flying == (2 if at == 4 else 0)
    assert standing is not None
    assert health is not None
    other = made()
    other.load({name: np.array(value) for name, value in standing.items()})
    for a, b in zip(frames[at + 1 :], other.frames_after(at, health), strict=True):
        np.testing.assert_array_equal(a.particles.x, b.particles.x)
        np.testing.assert_array_equal(a.particles.v, b.particles.v)
        assert a.health == b.health


def test_the_same_bake_twice_is_the_same():
    one, other = (list(falling(frames=18).frames()) for _ in range(2))
    for a, b in zip(one, other):
        np.testing.assert_array_equal(a.particles.x, b.particles.x)
        assert a.health == b.health
