"""Pins: what they hold, where the body ends for them, and how they move it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from slow_parameters import slow_but
from solids import asset, cube, fill, preset_material, resting_pose, settings, solid, surface

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import InputError
from gf_usd.core.frames.particles import Particles, SurfaceSamples
from gf_usd.core.materials.material import Material
from gf_usd.core.stage import Pin, Region
from gf_usd.geometry.regions import box_region, make_pin
from gf_usd.geometry.repair import repair_asset
from gf_usd.geometry.sampling.particles import sample_solid
from gf_usd.geometry.solid import build_solid
from gf_usd.geometry.thin.thicken import thicken_asset
from gf_usd.physics.grid.pins import (
    Motion,
    PinConstraint,
    fully_prescribed,
    interpolation,
    mirror_points,
    pinned_by,
    prescribed_nearby,
)
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.pipeline.health.log import gain_of_frames
from gf_usd.verify.bodies import block, clamp, elastic

BAR = solid(cube((0.0, 0.0, 0.0), (1.0, 0.25, 0.25)))
STILL = np.zeros((1, 0, 3))


def box(text: str, path: Floats = STILL, points: Floats | None = None) -> Pin:
    region = box_region(text, 1.0, np.zeros((0, 3)) if points is None else points, path)
    return make_pin(region, BAR)


def bar(particles: int = 500) -> Particles:
    return fill(BAR, particles)[0]


def soft(**changes: float) -> Material:
    return Material(
        name="soft", law="corotated", density=1000.0, youngs_modulus=1e5, poissons_ratio=0.0,
        **changes,
    )  # fmt: skip


def turn(angle: float) -> Floats:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def test_a_box_holds_what_lies_in_it() -> None:
    pin = box("box:-1,-1,-1,0.5,2,2")
    X = np.array([[0.1, 0.1, 0.1], [0.6, 0.1, 0.1], [0.49, 1.9, 1.9], [-1.1, 0.0, 0.0]])
    assert pinned_by([pin], X).pin.tolist() == [0, -1, 0, -1]
    np.testing.assert_allclose(pin.nearest(X[:1]), [[0.5, 0.1, 0.1]], atol=1e-12)


def test_the_first_pin_that_holds_a_point_has_it() -> None:
    first, second = box("box:-1,-1,-1,0.3,2,2"), box("box:-1,-1,-1,0.6,2,2")
    X = np.array([[0.2, 0.1, 0.1], [0.5, 0.1, 0.1], [0.9, 0.1, 0.1]])
    assert pinned_by([first, second], X).pin.tolist() == [0, 1, -1]


def test_a_patch_holds_the_surface_and_what_is_outside_of_it() -> None:
    # faces of the cube at x = 0: triangles 8 and 9
    surface = BAR.surfaces[0]
    region = Region(
        name="/Body/end", kind="patch", points=surface.points, triangles=surface.triangles[8:10],
        path=surface.points[None], body="/Body",
    )  # fmt: skip
    pin = make_pin(region, BAR)
    X = np.array([[0.0, 0.1, 0.1], [-0.2, 0.1, 0.1], [0.01, 0.1, 0.1], [0.5, 0.3, 0.1]])
    assert pinned_by([pin], X).pin.tolist() == [0, 0, -1, -1]


def test_mirror_points_lie_across_the_boundary_and_deep_nodes_have_none() -> None:
    pin = box("box:-1,-1,-1,0,2,2")
    X = np.array([[-0.05, 0.1, 0.1], [-0.5, 0.1, 0.1], [0.2, 0.1, 0.1]])
    mirror, share = mirror_points([pin], pinned_by([pin], X), X, 0.1)
    np.testing.assert_allclose(mirror[0], [0.05, 0.1, 0.1], atol=1e-12)
    assert share[0] == pytest.approx(-1.0)
    assert np.isnan(mirror[1:]).all()


def test_nodes_on_both_sides_near_a_boundary_lie_on_the_line_through_it() -> None:
    pin = box("box:-1,-1,-1,0,2,2")
    X = np.array([[0.02, 0.1, 0.1], [-0.02, 0.1, 0.1], [-0.08, 0.1, 0.1], [0.0, 0.1, 0.1]])
    held = prescribed_nearby([pin], pinned_by([pin], X), X, 0.1)
    assert held.pin.tolist() == [0, 0, 0, 0]
    across = lambda rows, X: np.where(rows == 2, 0.5, 0.0)  # noqa: E731
    mirror, share = mirror_points([pin], held, X, 0.1, across)
    # depths h + .02, h - .02 and, where nodes there are given themselves, 2 h - .08; at b: u = g
    np.testing.assert_allclose(mirror[:3, 0], [0.12, 0.08, 0.12], atol=1e-12)
    np.testing.assert_allclose(share, [0.02 / 0.12, -0.02 / 0.08, -0.08 / 0.12, 0.0], atol=1e-12)
    # whichever node it is, it has the value of a field that is linear from the boundary on
    np.testing.assert_allclose(share[:3] * mirror[:3, 0], X[:3, 0], atol=1e-12)


def test_all_nodes_of_a_body_that_is_wholly_held_are_held() -> None:
    """They have no mass, and would be light nodes without a free one to follow."""
    pins = [box("box:1.5,-1,-1,1.7,2,2"), box("box:1.7,-1,-1,2.1,2,2")]
    X = np.array([[x, 0.1, 0.1] for x in (0.0, 0.5, 1.4, 1.6, 1.8, 2.3)])
    body, mass = np.array([0, 0, 1, 1, 1, 1]), np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    particles = pinned_by(pins, X[1:5])
    held = fully_prescribed(pinned_by(pins, X), mass, body, X, particles, X[1:5], body[1:5])
    assert held.pin.tolist() == [-1, -1, 0, 0, 1, 1]


def test_nodes_that_pinned_particles_alone_reach_are_held() -> None:
    """The nearest free node may be many cells away: a fit of it would multiply its motion."""
    pins = [
        box("box:0.5,-1,-1,2,2,2"),
        replace(box("box:-2,-1,-1,-1,2,2"), axes=(True, False, True)),
    ]
    X = np.array([[0.1, 0.1, 0.1], [0.6, 3.0, 0.1], [0.9, 3.0, 0.1], [-1.2, 3.0, 0.1]])
    mass = np.array([1.0, 0.1, 0.0, 0.0])
    Xp = np.array([[0.1, 0.1, 0.1], [0.9, 1.9, 0.1], [-1.2, 1.9, 0.1]])
    body = np.zeros(4, int)
    held = fully_prescribed(
        pinned_by(pins, X), mass, body, X, pinned_by(pins, Xp), Xp, np.zeros(3, int)
    )
    assert held.pin.tolist() == [-1, -1, 0, -1]  # free, light, held; and beside a pin that slides


def test_a_pinned_limb_stays_where_it_is_on_all_sides() -> None:
    """Its surface is in the support of nodes outside the pin, ten cells from the free body."""
    trunk, limb = cube((0.0, 0.0, 0.0), (0.3, 1.0, 1.0)), cube((0.3, 0.45, 0.45), (1.0, 0.1, 0.1))
    particles = fill(solid(trunk, limb), 3000)[0]
    inside = particles.X[particles.X[:, 0] > 0.3]  # a pin around these leaves the surface outside
    ends = ",".join(str(v) for v in (*(inside.min(0) - 1e-5), *(inside.max(0) + 1e-5)))
    pin = make_pin(box_region(f"box:{ends}", 1.0, np.zeros((0, 3)), STILL), BAR)
    tip = np.array([[1.3, y, z] for y in (0.45, 0.55) for z in (0.45, 0.55)])
    solver = TotalLagrangian(
        particles, [soft()], settings(frames=2, gravity=(0.0, -9.81, 0.0)), pins=[pin],
        embedded={"/Tip": tip},
    )  # fmt: skip
    *_, last = solver.frames()
    assert np.abs(last.particles.x - particles.X).max() > 1e-3, "the trunk hangs"
    np.testing.assert_allclose(last.embedded["/Tip"].x, tip, atol=1e-6)


def test_the_surface_of_a_pinned_mesh_moves_as_the_mesh_does() -> None:
    """Its own points are on the boundary, not inside: they were pulled off by the body, and had
    velocities of half a frame earlier.
    """
    handle = solid(cube((-0.05, -0.05, -0.05), (0.35, 0.35, 0.35))).surfaces[0]
    points, dt = handle.points, 1.0 / 24.0
    up = 0.5 * 30.0 * (dt * np.arange(5)) ** 2  # [m] at an acceleration of 30 m/s^2
    path = points + up[:, None, None] * [0.0, 1.0, 0.0]
    region = Region(
        name="/Handle", kind="volume", points=points, triangles=handle.triangles, path=path
    )
    solver = TotalLagrangian(
        bar(), [soft()], settings(frames=4, gravity=(0.0, -9.81, 0.0)),
        pins=[make_pin(region, BAR)], embedded={"/Handle": points},
    )  # fmt: skip
    for index, frame in enumerate(solver.frames()):
        np.testing.assert_allclose(frame.embedded["/Handle"].x, path[index], atol=1e-6)
        if index:
            rate = np.broadcast_to([0.0, 30.0 * dt * index, 0.0], points.shape)
            np.testing.assert_allclose(frame.embedded["/Handle"].v, rate, atol=1e-5)


@pytest.mark.slow
def test_a_body_may_be_pinned_wholly_next_to_a_free_one() -> None:
    free = bar(100)
    far = replace(free, X=free.X + [3.0, 0.0, 0.0])
    both = {
        name: np.concatenate([values, getattr(far, name)])
        for name, values in vars(free).items()
        if isinstance(values, np.ndarray) and len(values) == len(free)
    }
    body = np.repeat([0, 1], len(free))
    particles = replace(free, **(both | {"body": body}))
    s = settings(frames=3, gravity=(0.0, -9.81, 0.0))
    pins = [box("box:2.5,-1,-1,5,2,2")]
    *_, last = TotalLagrangian(particles, [soft()], s, pins=pins).frames()
    moved = np.abs(last.particles.x - particles.X).max(1)
    assert moved[body == 1].max() < 1e-6
    assert moved[body == 0].min() > 1e-3


@pytest.mark.parametrize(
    "gap", slow_but([0.0, 0.05, 0.25, 0.45, 0.5, 0.55, 0.75, 0.95], 0.55, 0.75)
)
def test_a_bar_hangs_alike_wherever_nodes_lie(gap: float) -> None:
    # Twice the static sag rho g (2 L y - y^2) / 2 E of its own weight, at half of the period.
    E, density, g, L, h = 1e5, 1000.0, 1.0, 1.0, 0.125
    body = block((0.0, 0.0, 0.0), (2, 8, 2), h)
    body = replace(body, corner=np.array([0.0, gap * h, 0.0]))
    made = elastic(E=E, nu=0.0, density=density)
    period = 4.0 * L / np.sqrt(E / density)
    s = settings(frames=25, fps=24.0 / period, gravity=(0.0, g, 0.0))
    solver = TotalLagrangian(body, [made], s, pins=[clamp(1, 0.0)])
    far = np.argmax(body.X[:, 1])
    y = body.X[far, 1]
    moved = [f.particles.x[far, 1] - y for f in solver.frames()]
    static = density * g / E * (2.0 * L * y - y**2) / 2.0
    assert np.mean(moved[:-1]) == pytest.approx(static, rel=(h / L) ** 2)


def test_interpolation_is_exact_for_linear_fields_and_empty_far_away() -> None:
    nodes = np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij"), -1).reshape(-1, 3)
    field = nodes @ np.array([1.0, -2.0, 0.5]) + 3.0
    at = np.array([[0.3, 1.7, 2.2], [2.0, 2.0, 2.0], [9.0, 9.0, 9.0]])
    w = interpolation(at, nodes)
    np.testing.assert_allclose((w @ field)[:2], at[:2] @ [1.0, -2.0, 0.5] + 3.0, atol=1e-12)
    assert np.diff(w.indptr).tolist() == [8, 1, 0]


def test_anchors_that_fill_space_move_affinely_and_flat_ones_rigidly() -> None:
    rng = np.random.default_rng(0)
    A = turn(0.7) @ np.diag([1.2, 0.9, 1.1])
    shift = np.array([0.3, -2.0, 0.1])
    filled = rng.uniform(size=(40, 3))
    X = rng.uniform(size=(5, 3))
    x, F = Motion(filled, np.stack([filled, filled @ A.T + shift])).at(X, 1.0)
    np.testing.assert_allclose(x, X @ A.T + shift, atol=1e-10)
    np.testing.assert_allclose(F, np.broadcast_to(A, F.shape), atol=1e-10)
    flat = filled * [1.0, 0.0, 1.0]
    R = turn(-1.1)
    x, F = Motion(flat, np.stack([flat, flat @ R.T + shift])).at(X, 1.0)
    np.testing.assert_allclose(x, X @ R.T + shift, atol=1e-10)
    np.testing.assert_allclose(F, np.broadcast_to(R, F.shape), atol=1e-10)


def test_a_point_that_is_an_anchor_goes_where_the_anchor_goes() -> None:
    rng = np.random.default_rng(1)
    anchors = rng.uniform(size=(40, 3))
    goes = rng.uniform(size=(40, 3))
    motion = Motion(anchors, np.stack([anchors, goes]))
    np.testing.assert_allclose(motion.at(anchors, 1.0)[0], goes, atol=1e-15)
    halfway = motion.at(anchors[:1], 0.5)[0]
    np.testing.assert_allclose(halfway, 0.5 * (anchors[:1] + goes[:1]), atol=1e-15)
    assert motion.moving
    assert not Motion(anchors, anchors[None]).moving


@pytest.mark.parametrize(
    ("text", "message"),
    [("box:-9,-9,-9,9,9,9", "contain all"), ("box:0.4,0.1,0.1,0.401,0.101,0.101", "no node")],
)
def test_a_pin_that_holds_all_or_nothing_is_refused(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        TotalLagrangian(bar(), [soft()], settings(), pins=[box(text)])
    assert message in caught.value.message
    assert caught.value.hint


def test_a_patch_smaller_than_a_cell_holds_the_nearest_nodes() -> None:
    # a tenth of a cell, in the middle of the face x = 0
    at, small = np.array([0.0, 0.13, 0.12]), 0.01
    points = at + small * np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    region = Region(name="/Body/spot", kind="patch", points=points, body="/Body",
                    triangles=np.array([[0, 1, 2]]), path=points[None])  # fmt: skip
    pin = make_pin(region, BAR)
    h = 0.2
    X = np.array([[0.07, 0.1, 0.05], [0.07, 0.3, 0.05], [0.27, 0.1, 0.05]])
    free = pinned_by([pin], X)
    assert not free.any
    assert prescribed_nearby([pin], free, X, h).pin.tolist() == [0, -1, -1]
    far = X + [0.05, 0.05, 0.0]  # none within NEAR
    assert prescribed_nearby([pin], pinned_by([pin], far), far, h).pin.tolist() == [0, -1, -1]
    away = X + [1.0, 0.0, 0.0]
    assert not prescribed_nearby([pin], pinned_by([pin], away), away, h).any


@pytest.mark.slow
def test_a_pinned_sheet_hangs_as_its_weight_says() -> None:
    """u(L) = rho g L^2 / 2E as of the bar, of a sheet of one layer of particles."""
    g, length, pinned, n = 2.0, 1.0, 0.25, 4
    x = np.linspace(-pinned, length, n + 2)
    points = np.array([[a, 0.0, z] for a in x for z in (0.0, 0.5)])
    strips = [[2 * k, 2 * k + 1, 2 * k + 2] for k in range(n + 1)]
    strips += [[2 * k + 2, 2 * k + 1, 2 * k + 3] for k in range(n + 1)]
    mended, repairs = repair_asset(asset(surface(points, np.array(strips))))
    filled, _ = thicken_asset(mended, repairs, spacing=0.05, particles=0)
    body = build_solid(filled)
    top = Region(name="/Body/top", kind="patch", points=points, path=points[None],
                 triangles=np.array([strips[0], strips[n + 1]]), body="/Body")  # fmt: skip
    s = settings(frames=40, gravity=(g, 0.0, 0.0), fps=24.0, drag=8.0)
    particles = sample_solid(body, particles=None, spacing=0.05, seed=0)
    moved = []
    for pin in make_pin(top, body, mended.surfaces), box("box:-9,-9,-9,0,9,9"):
        solver = TotalLagrangian(particles, [soft()], s, pins=[pin], embedded={"flag": points})
        *_, last = solver.frames()
        moved.append(last.embedded["flag"].x - points)
    assert np.abs(moved[0][:4]).max() < 1e-12
    # the same place is held, to second order in a cell of 0.1
    np.testing.assert_allclose(moved[0][-2:, 0], moved[1][-2:, 0], rtol=0.1**2)
    # a sheet of one layer is as long as its particles are: to half a spacing, 2 (a / 2) / L
    assert moved[0][-2:, 0] == pytest.approx(1000.0 * g / (2.0 * 1e5), rel=0.05)


@pytest.mark.slow
def test_a_pinned_bar_stretches_as_its_weight_says() -> None:
    """u(L) = rho g L^2 / 2E of a bar that hangs on its end, nu = 0.

    The bar is held at x = 0 and pulled along x; damped until it rests.  The strata are 1/16 of the
    bar: the error of the quadratic stencil is far below the 1 % that jitter leaves.
    """
    g = 2.0
    s = settings(frames=60, gravity=(g, 0.0, 0.0), fps=24.0, drag=8.0)
    solver = TotalLagrangian(
        bar(2000), [soft()], s, pins=[box("box:-1,-1,-1,0,2,2")],
        embedded={"tip": np.array([[1.0, 0.125, 0.125]])},
    )  # fmt: skip
    *_, last = solver.frames()
    u = last.embedded["tip"].x[0, 0] - 1.0
    assert u == pytest.approx(1000.0 * g / (2.0 * 1e5), rel=0.015)


@pytest.mark.slow
def test_the_body_follows_a_moving_region_and_its_work_is_counted() -> None:
    """A slow turn of the held end leaves the rest of a light, damped bar turned by as much."""
    points = np.array(
        [[x, y, z] for x in (0.0, 0.1, 0.2) for y in (0.0, 0.25) for z in (0.0, 0.25)]
    )
    frames = 120
    path = np.stack([points @ turn(0.5 * min(i / 40, 1.0)).T for i in range(frames)])
    body = bar()
    solver = TotalLagrangian(
        body, [soft(damping_time=0.02)], settings(frames=frames, drag=5.0),
        pins=[box("box:-1,-1,-1,0.25,2,2", path, points)],
    )  # fmt: skip
    seen = list(solver.frames())
    R = turn(0.5)
    np.testing.assert_allclose(seen[-1].particles.x, body.X @ R.T, atol=0.01)
    held = body.X[:, 0] < 0.25
    np.testing.assert_allclose(seen[-1].particles.x[held], body.X[held] @ R.T, atol=1e-6)
    assert sum(f.health.rollbacks for f in seen) == 0
    assert sum(f.health.work for f in seen) > 0.0


def test_work_of_the_pins_is_what_the_energy_gains() -> None:
    """Pulled out without damping, the energy of the body is the work of the region, to 2 %.

    Work is summed over substeps by the rectangle rule, of which there are hundreds.
    """
    points = np.array([[x, y, z] for x in (0.0, 0.1) for y in (0.0, 0.25) for z in (0.0, 0.25)])
    frames = 25
    path = np.stack([points - [0.1 * np.sin(0.5 * np.pi * i / 24) ** 2, 0, 0] for i in range(25)])
    solver = TotalLagrangian(
        bar(), [soft()], settings(frames=frames),
        pins=[box("box:-1,-1,-1,0.125,2,2", path, points)],
    )  # fmt: skip
    seen = [f.health for f in solver.frames()]
    # in full motion, where the bar has some energy
    gained = seen[12].kinetic + seen[12].elastic
    assert gained > 0.3
    assert sum(h.work for h in seen[:13]) == pytest.approx(gained, rel=0.02)


def test_a_pin_of_one_body_holds_nothing_of_another_in_the_same_place() -> None:
    X, body = np.zeros((2, 3)), np.array([0, 1])
    own = replace(box("box:-1,-1,-1,1,1,1"), body=1)
    assert pinned_by([own], X, body).pin.tolist() == [-1, 0]
    assert pinned_by([replace(own, body=None)], X, body).pin.tolist() == [0, 0]


def test_a_pin_of_one_body_holds_nodes_of_that_body_only() -> None:
    """A bar in the place of a pinned one had its nodes, particles and surface held as well."""
    one = bar(200)
    count = len(one)
    both = replace(
        one,
        **{
            name: np.concatenate([getattr(one, name)] * 2)
            for name in ("X", "V0", "material", "orientation", "scale", "color", "opacity")
        },
        surface=np.repeat([0, 1], count),
        body=np.repeat([0, 1], count),
        corners=np.tile(one.corner, (2, 1)),
        volume=2.0 * one.volume,
    )
    X = np.array([[0.1, 0.1, 0.1]])
    pin = replace(box("box:-1,-1,-1,0.5,2,2"), body=1)
    made = TotalLagrangian(
        both, [soft()], settings(floor=0.0), pins=[pin],
        samples=SurfaceSamples(X=both.X, area=both.V0, body=both.body),
        embedded={"/A": X, "/B": X}, embedded_body={"/A": 0, "/B": 1},
    ).body  # fmt: skip
    assert set(made.stencil.node_body[made.stencil.held.pin >= 0]) == {1}
    held = made.held[""].pin >= 0
    assert held.sum() == pytest.approx(0.5 * count, rel=0.1)
    assert not held[:count].any()
    assert made.held["/A"].pin.tolist() == [-1]
    assert made.held["/B"].pin.tolist() == [0]
    assert made.contact is not None
    assert len(made.contact.samples.X) == 2 * count - held.sum()


def test_nodes_of_another_body_near_a_pin_are_free() -> None:
    pin = replace(box("box:-1,-1,-1,0,2,2"), body=1)
    X = np.array([[0.01, 0.1, 0.1], [-0.1, 0.1, 0.1], [0.01, 0.1, 0.1]])
    body = np.array([1, 1, 0])
    held = pinned_by([pin], X, body)
    assert prescribed_nearby([pin], held, X, 0.1, body).pin.tolist() == [0, 0, -1]


def test_a_falling_body_without_pins_is_as_it_was() -> None:
    body = bar()
    s = settings(gravity=(0.0, -9.81, 0.0))
    free = TotalLagrangian(body, [preset_material("rubber", body)], s)
    assert free.body.pin_constraint is None
    assert not free.body.stencil.held.any
    assert free.body.stencil.rows(body.X).W.shape[1] == free.body.stencil.free_count


def test_a_holder_tells_moving_regions_from_still_ones() -> None:
    points = np.zeros((4, 3)) + np.eye(4, 3)
    assert not PinConstraint([box("box:-1,-1,-1,0,2,2")], bar().X).moving
    moved = np.stack([points, points + 1.0])
    assert PinConstraint([box("box:-1,-1,-1,0,2,2", moved, points)], bar().X).moving


def test_rates_of_pinned_points_are_exact_for_a_constant_velocity() -> None:
    """At the last frame of an animation the rate was half of it."""
    points = np.zeros((4, 3)) + np.eye(4, 3)
    fast, slow = (
        points + np.arange(count)[:, None, None] * np.array([velocity, 0.0, 0.0])
        for count, velocity in ((3, 0.3), (5, 0.1))
    )
    pins = [box("box:-1,-1,-1,0.2,2,2", fast, points), box("box:0.8,-1,-1,2,2,2", slow, points)]
    constraint = PinConstraint(pins, bar().X)
    X = np.array([[0.1, 0.1, 0.1], [0.9, 0.1, 0.1]])
    held, rates = pinned_by(pins, X), []
    for index in range(6):
        pose = constraint.override(held, X, resting_pose(X), index, 0.1, np.zeros(3))
        rates.append(pose.v[:, 0])
    expected = [[3.0, 1.0], [3.0, 1.0], [3.0, 1.0], [0.0, 1.0], [0.0, 1.0], [0.0, 0.0]]
    np.testing.assert_allclose(rates, expected, atol=1e-9)


def core(name: str, low: float, high: float, path: Floats) -> Pin:
    """A pin that is no boundary: |y|, |z| within 0.08 m of the bar's axis, x between two values."""
    anchors = 0.5 * np.vstack([np.zeros(3), np.eye(3)])
    return Pin(
        name=name,
        inside=lambda X: (
            (X[:, 0] > low) & (X[:, 0] < high) & (np.abs(X[:, 1:] - 0.125) < 0.08).all(1)
        ),
        nearest=lambda X: X,
        anchors=anchors,
        path=anchors + path,
        sharp=False,
    )


def test_pins_work_against_the_filter_too() -> None:
    """Without damping the filter alone takes energy: what the body gains is less than the work.

    Where a core turns against the other, the filter smooths the motion next to it, and the pins go
    on.  Substeps of leapfrog are in error by the square of their length: 1e-4 of the work of a
    frame here.
    """
    anchors = 0.5 * np.vstack([np.zeros(3), np.eye(3)])
    path = np.stack([anchors @ (turn(0.5 * (i / 12) ** 2) - np.eye(3)).T for i in range(13)])
    solver = TotalLagrangian(
        bar(), [soft()], settings(frames=13, filter_rate=300.0),
        pins=[core("near", -1.0, 0.4, np.zeros((1, 1, 3))), core("far", 0.6, 2.0, path)],
    )  # fmt: skip
    seen = [f.health for f in solver.frames()]
    work = np.array([h.work for h in seen[1:]])
    gains = np.array(gain_of_frames(seen))
    assert (gains < 1e-4 * np.abs(work)).all()
    assert gains.sum() < -0.01 * work.sum(), "the filter took nothing"


def test_a_core_holds_nodes_and_leaves_particles_their_mass() -> None:
    solver = TotalLagrangian(
        bar(), [soft()], settings(), pins=[core("A", -1.0, 2.0, np.zeros((1, 1, 3)))]
    )
    held = solver.body.stencil.held.pin >= 0
    assert held.any()
    assert solver.body.m.min() > 0.0
    assert np.isnan(solver.body.stencil.mirror[held]).all()


def test_rigid_motion_of_all_cores_strains_nothing() -> None:
    """A bar that moves at (0.5, 0.2, -0.1) m/s as its two cores do keeps F = I to float32."""
    s = settings(frames=12, gravity=(0.0, 0.0, 0.0))
    v = np.array([0.5, 0.2, -0.1])
    path = (np.arange(12) * s.frame_time)[:, None, None] * v
    pins = [core("A", -1.0, 0.4, path), core("B", 0.6, 2.0, path)]
    for frame in TotalLagrangian(bar(), [soft()], s, velocity=v, pins=pins).frames():
        # u of 0.25 m in float32, over cells of 0.1 m, in 27 terms
        assert np.abs(frame.particles.F - np.eye(3)).max() < 2e-5
        if frame.index:  # the first is before any motion of pins
            assert np.abs(frame.particles.v - v).max() < 1e-4


def test_cores_that_hold_no_node_are_refused() -> None:
    pin = core("A", 5.0, 6.0, np.zeros((1, 1, 3)))
    with pytest.raises(InputError) as caught:
        TotalLagrangian(bar(), [soft()], settings(), pins=[pin])
    assert "none of the 1 bones" in caught.value.message
