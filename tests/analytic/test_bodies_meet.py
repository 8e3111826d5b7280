"""Contact between bodies, with obstacles and of a body with itself."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import trimesh
from contact_scenes import bricks, contact_solver, depth, half_space, momenta, obstacle, tilted
from solids import cube, sphere, surface

from gf_usd.core.materials.dimensionless import G0
from gf_usd.physics.contact.planes.rest_gaps import APART
from gf_usd.physics.contact.self_contact.search import OFFSET
from gf_usd.pipeline.health.log import gain_of_frames

LEFT = sphere(center=(-1.3, 0.0, 0.0), path="/Left")
RIGHT = sphere(center=(1.3, 0.2, 0.0), path="/Right")  # a little off the line: they spin too
SPEED = 3.0  # [m/s] of each: a fall of half a meter
ROUNDING = 1e-6  # of m v: float32 sums over some hundred substeps; measured up to 1.3e-7


@cache
def crash(material: str):
    """Two balls that run into each other, and their frames."""
    solver = contact_solver(
        LEFT, RIGHT, particles=600, material=material, frames=20,
        velocity=[(SPEED, 0.0, 0.0), (-SPEED, 0.0, 0.0)],
    )  # fmt: skip
    return solver, list(solver.frames())


@pytest.mark.slow
@pytest.mark.parametrize("material", ["rubber", "jelly"])
def test_what_one_body_loses_another_gains(material):
    solver, frames = crash(material)
    p = np.array([momenta(solver, f) for f in frames])
    scale = 0.5 * solver.body.m.sum() * SPEED
    change = p - p[0]
    assert np.abs(change[-1]).max() > scale, "they met: each was turned around"
    assert np.abs(change.sum(1)).max() <= ROUNDING * scale


@pytest.mark.slow
def test_angular_momentum_is_kept_to_rounding():
    """Not collinear, with friction, sliding and deep: the forces of a pair act along one line."""
    # The filter keeps that of the rest shape, sum X x m v; without it only contact could change it.
    solver = contact_solver(
        LEFT, RIGHT, particles=600, frames=20, velocity=[(SPEED, 0.0, 0.0), (-SPEED, 0.0, 0.0)],
        filter_rate=0.0,
    )  # fmt: skip
    frames = list(solver.frames())
    x = [frames[k].particles.x[solver.particles.body == 0].mean(0) for k in (0, -1)]
    assert np.linalg.norm(x[1] - x[0]) > 0.5, "they met and parted"
    L = np.array([f.health.angular_momentum for f in frames])
    assert max(f.health.overlap for f in frames) > 0.0
    assert np.abs(L - L[0]).max() <= ROUNDING * solver.body.m.sum() * SPEED


@pytest.mark.slow
@pytest.mark.parametrize("material", ["rubber", "jelly"])
def test_bodies_overlap_by_half_a_spacing_at_most(material):
    solver, frames = crash(material)
    recorded = [f.health.overlap for f in frames]
    seen = [depth(f, LEFT, RIGHT) for f in frames]
    s = solver.particles.spacing
    assert 0.0 <= max(recorded) <= (0.5 - APART) * s, "they push before they touch"
    assert max(seen) <= (0.5 - APART) * s
    # Samples lie a spacing apart and frames show moments: of one depth, not of one place and time.
    assert max(seen) == pytest.approx(max(recorded), abs=0.2 * s)


@pytest.mark.parametrize("material", ["rubber", "jelly"])
def test_energy_is_never_made_out_of_nothing(material):
    _, frames = crash(material)
    h = [f.health for f in frames]
    scale = h[0].kinetic
    # What new planes store is reported apart (injected); 1e-5 is rounding of energies in float32.
    assert max(gain_of_frames(h)) <= 1e-5 * scale
    # ... and none is put in: where nothing presses bodies together there is no budget.  Springs
    # of friction whose samples face something else are lost: each holds (mu k d)^2 / 2 k of the
    # k d^2 / 2 of its plane, and a detection loses few of them.
    assert sum(max(0.0, f.injected) for f in h) <= 1e-5 * scale
    assert sum(abs(f.injected) for f in h) <= 0.01 * max(f.contact for f in h) * len(h)
    assert h[-1].kinetic + h[-1].elastic < h[0].kinetic


@pytest.mark.parametrize("g", [0.0, 10.0 * G0])
def test_new_planes_store_what_the_old_ones_did(g):
    """A detection moves nothing: all that it changes of the contact energy is injected."""
    solver = contact_solver(
        LEFT, RIGHT, particles=300, frames=7, gravity=(0.0, 0.0, -g),
        velocity=[(SPEED, 0.0, 0.0), (-SPEED, 0.0, 0.0)],
    )  # fmt: skip
    last = list(solver.frames())[-1].health
    assert last.contact > 0.0
    pairs = solver.pairs
    assert pairs is not None
    # They are those of a detection some substeps ago.
    before = pairs.planes
    pairs.begin(solver.state)
    pairs.detect(solver.state, 7, solver.dt, 0, solver.substeps)
    met = (before.partner >= 0) & (pairs.planes.partner >= 0)
    assert np.abs(pairs.planes.normal - before.normal)[met].max() > 1e-3
    change = solver.read(6).health.contact - last.contact
    assert pairs.injected == pytest.approx(change, abs=1e-9 * last.contact)
    if g == 0.0:
        assert abs(change) <= 1e-9 * last.contact
    else:  # a budget of 1e-4 m g r in T for each of two pairs, and T is .32 s
        budget = 1e-4 * last.mass * g * solver.particles.radius / 0.32
        assert 0.0 < abs(change) <= 2.0 * budget * solver.frame_time


@pytest.mark.slow
def test_equal_bodies_swap_velocities_up_to_restitution():
    right = sphere(center=(1.3, 0.0, 0.0), path="/Right")
    solver = contact_solver(
        LEFT, right, particles=600, frames=20, velocity=[(SPEED, 0.0, 0.0), (0.0, 0.0, 0.0)]
    )
    v = momenta(solver, list(solver.frames())[-1]) / (0.5 * solver.body.m.sum())
    e = (v[1, 0] - v[0, 0]) / SPEED
    # A ball trades part of the impact for vibration, as in `test_drop`.
    assert 0.5 < e < 0.95
    # 1 % of the speed: the two are filled by other random numbers, so of slightly other mass.
    np.testing.assert_allclose(v[:, 0], [SPEED * (1 - e) / 2, SPEED * (1 + e) / 2], atol=0.03)
    assert np.abs(v[:, 1:]).max() < 0.03


def test_bodies_that_are_filtered_pass_through_each_other():
    solver = contact_solver(
        LEFT, RIGHT, particles=300, frames=12, through=frozenset({(0, 1)}),
        velocity=[(SPEED, 0.0, 0.0), (-SPEED, 0.0, 0.0)],
    )  # fmt: skip
    frames = list(solver.frames())
    assert max(depth(f, LEFT, RIGHT) for f in frames) > 0.5
    assert max(f.health.overlap for f in frames) == 0.0
    change = momenta(solver, frames[-1]) - momenta(solver, frames[0])
    assert np.abs(change).max() <= ROUNDING * solver.body.m.sum() * SPEED


@pytest.mark.slow
def test_a_body_at_rest_on_another_does_not_stand_in_it():
    """Springs yield by a tenth of a spacing at most, as on the floor, and begin APART above."""
    lower = cube((-0.5, 0.0, -0.5), path="/Lower")
    upper = cube((-0.5, 1.1, -0.5), path="/Upper")
    solver = contact_solver(
        lower, upper, particles=400, frames=36, gravity=(0.0, -G0, 0.0), floor=0.0, drag=8.0,
        velocity=[(0.0, 0.0, 0.0)] * 2,
    )  # fmt: skip
    frames = list(solver.frames())
    last, s = frames[-1], solver.particles.spacing
    assert last.health.kinetic < 1e-4 * solver.body.m.sum() * G0, "they have come to rest"
    assert last.health.overlap == 0.0
    assert depth(last, lower, upper) == 0.0
    gap = last.embedded["/Upper"].x[:, 1].min() - last.embedded["/Lower"].x[:, 1].max()
    assert (APART - 0.1) * s <= gap < APART * s
    assert last.embedded["/Upper"].x[:, 1].min() > 0.8


@pytest.mark.slow
@pytest.mark.parametrize("gap", [-0.02, 0.0, 0.01])
def test_bodies_that_are_near_at_rest_stay_where_they_are(gap):
    """What touches, overlaps or is nearer than APART in the asset is not pushed."""
    lower = cube((-0.5, 0.0, -0.5), path="/Lower")
    upper = cube((-0.5, 1.0 + gap, -0.5), path="/Upper")
    solver = contact_solver(lower, upper, particles=200, frames=3)
    assert gap < APART * solver.particles.spacing
    first, *_, last = solver.frames()
    assert last.health.kinetic <= 1e-12 * solver.body.m.sum()
    for path, pose in first.embedded.items():
        np.testing.assert_allclose(last.embedded[path].x, pose.x, atol=1e-6)


def plate(degrees: float, **options):
    """A tilted plate whose upper face goes through the origin."""
    box = trimesh.creation.box(extents=(4.0, 0.4, 4.0)).subdivide().subdivide()
    return obstacle(tilted(box.vertices - [0.0, 0.2, 0.0], degrees), box.faces, **options)


@pytest.mark.slow
def test_a_moving_obstacle_is_a_resting_one_seen_by_a_moving_observer():
    """A tilted plate that hits a ball, and the ball that hits the plate: Galilei."""
    count, w = 16, np.array([0.8, 3.0, 0.0])
    ball = sphere(center=1.4 * tilted([[0.0, 1.0, 0.0]], 25.0)[0], path="/Ball")
    track = np.arange(count)[:, None] / 24.0 * w
    hit = contact_solver(
        ball, particles=300, frames=count, velocity=[(0.0, 0.0, 0.0)],
        colliders=(plate(25.0, offset=track),),
    )  # fmt: skip
    hits = contact_solver(
        ball, particles=300, frames=count, velocity=[tuple(-w)], colliders=(plate(25.0),)
    )
    one, other = list(hit.frames()), list(hits.frames())
    assert np.linalg.norm(one[-1].health.momentum) > 3.0 * hit.body.m.sum(), "it was hit"
    for a, b in zip(one, other):
        # Rounding, grown by an impact of some hundred substeps (measured: 1.5e-7 m).
        np.testing.assert_allclose(a.particles.x, b.particles.x + a.time * w, atol=1e-5)
    scale = other[0].health.kinetic
    gained = one[-1].health.kinetic + one[-1].health.elastic
    work = sum(f.health.work for f in one)
    assert work > gained, "the plate pays for the ball's motion and for what is lost"
    assert sum(f.health.work for f in other) == 0.0
    # ... exactly: the same loss is seen by both, since the ball in the plate's frame starts with
    # `scale`. 1e-3 for forces at half steps and velocities at whole ones.
    lost = scale - (other[-1].health.kinetic + other[-1].health.elastic)
    assert work - gained == pytest.approx(lost, abs=1e-3 * scale)
    for frames in (one, other):
        assert max(gain_of_frames([f.health for f in frames])) <= 1e-5 * scale
        assert 0.0 < max(f.health.overlap for f in frames) <= 0.5 * hit.particles.spacing


def test_a_plane_without_friction_leaves_what_is_along_it():
    slope = half_space(25.0, friction=0.0)
    along, out = tilted([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], 25.0)
    # Far from the corners that define the plane: it has no end.
    ball = sphere(center=1.3 * out + 50.0 * along, path="/Ball")
    solver = contact_solver(
        ball, particles=300, frames=16, colliders=(slope,), velocity=[tuple(along - 2.0 * out)]
    )
    frames = list(solver.frames())
    v = np.asarray(frames[-1].health.momentum) / solver.body.m.sum()
    assert v @ along == pytest.approx(1.0, abs=1e-3)  # 1e-3: normals and points of float32 at 50 m
    assert 1.0 < v @ out < 2.0
    lowest = min(float((f.embedded["/Ball"].x @ out).min()) for f in frames)
    assert -0.5 * solver.particles.spacing <= lowest < 0.0


def slope(degrees: float, frames: int = 36) -> np.ndarray:
    """Speed [m/s] between frames of a box put on a slope with friction 0.5, down along it."""
    box = cube((-0.5, 0.002, -0.5), path="/Box")
    box = surface(tilted(box.points, degrees), box.triangles, path="/Box")
    solver = contact_solver(
        box, particles=200, frames=frames, gravity=(0.0, -G0, 0.0), velocity=[(0.0, 0.0, 0.0)],
        changes={"restitution": 0.1}, colliders=(half_space(degrees, friction=0.5),),
    )  # fmt: skip
    x = np.array([f.particles.x.mean(0) for f in solver.frames()])
    return np.diff(x @ tilted([[-1.0, 0.0, 0.0]], degrees)[0]) * 24.0


@pytest.mark.slow
def test_a_box_slides_above_the_friction_angle_and_sticks_below():
    # The angle is atan(0.5) = 26.6 degrees.
    sliding = slope(35.0)
    expected = G0 * (np.sin(np.radians(35.0)) - 0.5 * np.cos(np.radians(35.0)))
    # 10 %: the box trembles on its contact springs, so that a second's mean is not exact.
    assert (sliding[-1] - sliding[-25]) == pytest.approx(expected, rel=0.1)
    sticking = slope(20.0, frames=72)
    # Creep in the third second, when the box has ceased to tremble: a thousandth of the speed that
    # gravity alone would have given it (measured: 2e-5).
    assert abs(sticking[-24:].mean()) < 1e-3 * G0 * np.sin(np.radians(20.0)) * 2.5


def tongs():
    """A U of two prongs 3 m long with a gap of 1 m."""
    shape = np.ones((8, 14, 2), bool)
    shape[2:6, 2:] = False
    made = bricks(shape, 0.25)
    return surface(made.points - [1.0, 0.5, 0.0], made.triangles, path="/Tongs")


@pytest.mark.slow
@pytest.mark.parametrize(("material", "rate"), [("rubber", 1.0), ("jelly", 0.5)])
def test_a_body_that_closes_has_self_contact_on_request(material, rate):
    body = tongs()
    left = (body.points[:, 0] < 0.0) & (body.points[:, 1] > 0.5)
    right = (body.points[:, 0] > 0.0) & (body.points[:, 1] > 0.5)

    def close(X):
        speed = -rate * np.sign(X[:, 0]) * np.maximum(X[:, 1], 0.0)
        return np.stack([speed, 0.0 * speed, 0.0 * speed], -1)

    gap = {}
    for meets_itself in (True, False):
        solver = contact_solver(
            body,
            particles=500,
            material=material,
            self_contact=meets_itself,
            velocity=[close],
            frames=12,
        )
        frames = list(solver.frames())
        x = [f.embedded["/Tongs"].x[:, 0] for f in frames]
        gap[meets_itself] = [(a[right].min() - a[left].max()) / solver.particles.spacing for a in x]
        p = np.array([f.health.momentum for f in frames])
        assert np.abs(p - p[0]).max() <= ROUNDING * solver.body.m.sum() * 3.0 * rate
        assert (max(f.health.contact for f in frames) > 0.0) == meets_itself
        assert max(f.health.overlap for f in frames) == 0.0
    assert gap[False][-1] < -1.0, "nothing else keeps the prongs apart"
    # Springs push from OFFSET on, and yield by less than that: measured 0.21 and 0.22.
    assert 0.0 <= min(gap[True]) < OFFSET


@pytest.mark.slow
@pytest.mark.parametrize("material", ["rubber", "jelly"])
@pytest.mark.parametrize("rate", [0.5, 1.0, 2.0])
def test_no_sample_of_two_closing_arms_is_released(material, rate):
    """Tips at 1.5, 3 and 6 m/s: nothing passes, and the planes give no energy."""

    def close(X):
        speed = -rate * np.sign(X[:, 0]) * np.maximum(X[:, 1], 0.0)
        return np.stack([speed, 0.0 * speed, 0.0 * speed], -1)

    solver = contact_solver(
        tongs(), particles=500, material=material, self_contact=True, velocity=[close], frames=14
    )
    h = [f.health for f in solver.frames()]
    assert max(x.let_go for x in h) == 0
    given = np.cumsum([x.injected for x in h])
    assert given.max() < 1e-3 * h[0].kinetic
    # Of the whole motion, for a frame may end half a substep after samples came into their springs,
    # whose force acts at the next: rounding, as of two balls.
    assert np.cumsum(gain_of_frames(h)).max() <= 1e-5 * h[0].kinetic
    assert max(x.contact for x in h) > 0.0
    # Two bodies yield by half a spacing at most; this one is pushed sooner.
    assert max(x.overlap for x in h) <= (0.5 - OFFSET) * solver.particles.spacing


@pytest.mark.slow
def test_boxes_of_twelve_triangles_do_not_sink_into_each_other():
    """Their faces are flat between eight vertices, however the landing bends them."""
    boxes = [
        cube(low=(x, y, z), edge=(1.0, 0.5, 1.0), path=path)
        for path, (x, y, z) in {
            "/A": (0.0, 0.0, 0.0), "/B": (0.1, 0.53, 0.0), "/C": (0.0, 1.06, 0.1),
        }.items()
    ]  # fmt: skip
    solver = contact_solver(
        *boxes, particles=900, frames=16, floor=0.0, up=(0.0, 1.0, 0.0), gravity=(0.0, -9.81, 0.0),
        velocity=[(0.0, -6.0, 0.0)] * 3,
    )  # fmt: skip
    h = [frame.health for frame in solver.frames()]
    assert max(x.min_J for x in h) > 0.0
    assert h[0].kinetic > 2.0 * h[-1].kinetic, "they have landed"
    assert max(x.overlap for x in h) < 0.2 * solver.particles.spacing
