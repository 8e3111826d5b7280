"""Edges and corners of obstacles hold bodies up between their contact samples."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from contact_scenes import contact_solver, obstacle
from solids import CUBE_POINTS, cube

from gf_usd.core.stage import Collider
from gf_usd.physics.contact.obstacles import edge_points
from gf_usd.physics.contact.obstacles.edge_points import LEAST_CAPACITY, SHARE, capacity
from gf_usd.physics.contact.obstacles.edge_search import EdgeContacts
from gf_usd.physics.contact.planes.contact_planes import NOBODY, ContactPlanes, nothing
from gf_usd.physics.total_lagrangian.setup import contact
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian

GRAVITY = (0.0, -9.81, 0.0)
SHALLOW = 0.35  # [spacings] of a point in a body: what its springs yield, in spacings of samples


def slab(thick: float, height: float, width: float = 1.0) -> Any:
    """Its underside at a height [m]."""
    box = cube((-0.5 * width, height, -0.5 * width), (width, thick, width), path="/Slab")
    return replace(box, points=np.asarray(box.points))


def post(top: float, half: float, **options: Any) -> Collider:
    """A box that ends at a height [m], half its width [m]."""
    points = (2.0 * CUBE_POINTS - 1.0) * half + [0.0, top - half, 0.0]
    return obstacle(points, cube().triangles, **options)


def deepest(solver: TotalLagrangian) -> float:
    """[spacings] that an edge or a corner was in a body at a measurement."""
    found = [frame.health.pierced or 0.0 for frame in solver.frames()]
    return max(found) / solver.particles.spacing


@pytest.mark.slow
@pytest.mark.parametrize(
    ("thick", "half"), [(0.3, 0.2), (0.3, 0.045), (0.06, 0.2)], ids=["body", "small", "cloth"]
)
def test_a_body_that_falls_on_corners_is_held_up_by_them(thick: float, half: float) -> None:
    """Without points of their own, corners were 0.8 to 1.7 spacings deep, or came through."""
    solver = contact_solver(
        slab(thick, 0.5), colliders=(post(0.45, half),), particles=600, material="jelly",
        frames=13, fps=24.0, gravity=GRAVITY, floor=None,
    )  # fmt: skip
    assert deepest(solver) < SHALLOW


def test_a_point_that_came_past_the_middle_of_a_thin_body_is_pushed_back() -> None:
    """The nearest place of the surface is on the other side, and faces away from the obstacle."""
    solver = contact_solver(
        slab(0.06, 0.5), colliders=(post(0.45, 0.2),), particles=600, frames=2, gravity=GRAVITY,
        floor=None,
    )  # fmt: skip
    assert solver.pairs is not None
    now, spacing = solver.state.view(), solver.particles.spacing
    skin, search = solver.pairs._skins[0], solver.pairs._edges._search
    x = np.array([[0.2, height, 0.2] for height in (0.49, 0.51, 0.54)])
    inward = np.tile([-1.0, -1.0, -1.0], (3, 1)) / np.sqrt(3.0)

    def near(X: Any, known: Any) -> Any:
        return skin.near(X, known, now.nodes[0], now.offset, 2.0 * spacing)

    for had, found in ((True, [0, 1, 2]), (False, [0, 1])):
        rows, normal, place, _ = search._faced(
            x, inward, np.zeros((3, 3)), np.zeros(3), np.full(3, had), near
        )
        assert sorted(rows.tolist()) == found
        assert normal == pytest.approx(np.tile([0.0, -1.0, 0.0], (len(rows), 1)), abs=1e-6)
        assert place[:, 1] == pytest.approx(0.5, abs=1e-6)


def struck(**options: Any) -> TotalLagrangian:
    """A slab at rest, without gravity, that a thin post strikes from below, between samples."""
    speed, fps, frames = 1.0, 48.0, 13
    way = np.zeros((frames, 3))
    way[:, 1] = speed * np.arange(frames) / fps
    way[8:] = way[7]
    return contact_solver(
        slab(0.3, 0.5), colliders=(post(0.48, 0.02, offset=way, friction=0.0, restitution=1.0),),
        particles=600, frames=frames, fps=fps, gravity=(0.0, 0.0, 0.0), floor=None,
        filter_rate=0.0, changes={"damping_time": 0.0}, **options,
    )  # fmt: skip


@pytest.mark.slow
def test_the_work_of_a_moving_corner_is_what_a_body_gains() -> None:
    solver = struck()
    assert solver.pairs is not None
    seen, faced = [], 0
    for frame in solver.frames():
        seen.append(frame.health)
        planes = solver.pairs.planes
        faced += int((planes.partner[len(solver.pairs._X) :] >= 0).sum())
    energy = [h.energy for h in seen]
    work = sum(h.work for h in seen)
    given = sum(h.injected for h in seen)
    gain = energy[-1] - energy[0]
    assert faced > 0
    assert work > 0.01 * seen[0].mass
    assert gain == pytest.approx(work + given, rel=0.02)


def test_what_is_in_a_body_at_the_start_does_not_push_it() -> None:
    solver = contact_solver(
        slab(0.3, 0.5), colliders=(post(0.6, 0.1),), particles=600, frames=4, fps=24.0,
        gravity=(0.0, 0.0, 0.0), floor=None,
    )  # fmt: skip
    speed = [np.abs(frame.particles.v).max() for frame in solver.frames()]
    assert max(speed) < 1e-5  # rounding


@pytest.mark.slow
def test_a_saved_state_has_the_points() -> None:
    """The frames after a save are those of a run without a stop, to the bit."""
    straight, other = struck(), struck()
    health = straight.read(0).health
    for number in range(1, 6):
        health = straight.next(number, health).health
    assert straight.pairs is not None
    assert (straight.pairs._edges.key >= 0).any()
    other.load(straight.save())
    for number in range(6, 9):
        frame, again = straight.next(number, health), other.next(number, health)
        np.testing.assert_array_equal(again.particles.x, frame.particles.x)
        assert again.health == frame.health
        health = frame.health


@pytest.mark.slow
def test_points_beyond_the_capacity_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """The deepest have a plane."""
    monkeypatch.setattr(contact, "capacity", lambda *_: 2)
    solver = contact_solver(
        slab(0.3, 0.5), colliders=(post(0.45, 0.2),), particles=600, material="jelly",
        frames=8, fps=24.0, gravity=GRAVITY, floor=None,
    )  # fmt: skip
    left = [frame.health.let_go for frame in solver.frames()]
    assert max(left) > 0
    assert solver.pairs is not None
    assert (solver.pairs._edges.key >= 0).sum() == 2


def test_the_capacity_suffices_for_the_edges_that_a_body_can_touch() -> None:
    box = post(0.45, 0.2)
    assert capacity([], 1000, 0.1) == 0
    assert capacity([box], 10_000, 0.1) == 8 + np.ceil(0.5 * 12 * (0.8 + np.sqrt(0.32)) / 0.1)
    assert capacity([box], 10_000, 1e-4) == 10_000 // SHARE
    assert capacity([box], 10, 1e-3) == LEAST_CAPACITY
    assert capacity([replace(box, shape="plane")], 1000, 0.1) == 0


def points_at(*keys: int) -> edge_points.EdgePoints:
    """Two samples and places of points, which move at 1 m/s."""

    def unused(_: int) -> Any:
        raise AssertionError

    points = edge_points.EdgePoints(2, len(keys), [], unused, unused, 0.1)
    points.key[:], points.v[:], points.start_gap[:] = keys, 1.0, -0.05
    return points


def planes_of(partner: list[int]) -> ContactPlanes:
    planes = nothing(len(partner))
    planes.partner[:] = partner
    return planes


def found(key: list[int], depth: list[float], x: list[float], body: int = 0) -> EdgeContacts:
    """Points on a line at x [m]."""
    n = len(key)
    return EdgeContacts(
        key=np.array(key), obstacle=np.zeros(n, int), body=np.full(n, body),
        x=np.column_stack([x, np.zeros((n, 2))]), v=np.zeros((n, 3)), depth=np.array(depth),
        start_gap=np.zeros(n), normal=np.tile([0.0, 1.0, 0.0], (n, 1)), point=np.zeros((n, 3)),
        rest=np.zeros((n, 3)),
    )  # fmt: skip


def test_a_place_is_free_once_its_point_has_no_plane() -> None:
    points = points_at(7, 8, 9)
    depth = np.array([0.0, 0.0, 0.01, 0.0, 0.0])
    points.begin(0.5, planes_of([NOBODY, NOBODY, 0, NOBODY, 1]), depth, np.zeros(5, bool))
    assert points.key.tolist() == [7, -1, 9]
    assert points.start_gap.tolist() == [-0.05, 0.0, -0.05]
    assert (points.x == 0.5).all()
    place, new = points._placed(np.array([7, 11]))
    assert place.tolist() == [0, 1]
    assert new.tolist() == [1]
    # the point at the last place was outside, and it is not searched any more
    assert points.key.tolist() == [7, 11, -1]


def test_points_in_contact_keep_their_places_and_the_deepest_get_the_others() -> None:
    points = points_at(7, 8, 9)
    depth = np.array([0.0, 0.0, 0.01, 0.0, 0.0])
    points.begin(0.0, planes_of([NOBODY, NOBODY, 0, 1, 1]), depth, np.zeros(5, bool))
    deep = found([8, 11, 12, 7, 13], [-0.01, 0.05, 0.04, 0.001, 0.03], [0.1, 0.3, 0.5, 0.7, 0.9])
    some = points._chosen(deep)
    assert some.key.tolist() == [7, 11, 12]
    assert points.left_out == 1, "13; 8 is outside of the body"


def test_points_close_together_are_thinned() -> None:
    """The one in contact stays, then the deepest; another body has points of its own."""
    points = points_at(7, 8, 9, -1, -1, -1)
    depth = np.array([0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0])
    faces = planes_of([NOBODY, NOBODY, 0, 1, 1, NOBODY, NOBODY, NOBODY])
    points.begin(0.0, faces, depth, np.zeros(8, bool))
    one = found([7, 8, 9, 10], [0.01, 0.02, 0.03, 0.04], [0.001, 0.005, 0.1, 0.105])
    other = found([9, 11], [0.05, 0.001], [0.1, 0.002], body=1)
    some = points._chosen(EdgeContacts.joined([one, other]))
    assert sorted(zip(some.key.tolist(), some.body.tolist())) == [(7, 0), (9, 1), (10, 0), (11, 1)]
    assert points.left_out == 0


def ridge(z: float) -> Collider:
    """A long prism along x without friction, whose upper edge is at height 0."""
    section = [[0.0, 0.0], [-0.1, -0.1], [-0.1, 0.1]]  # y and z
    points = [[x, y, z + across] for x in (-2.0, 4.0) for y, across in section]
    sides = [[0, 4, 1], [0, 3, 4], [1, 5, 2], [1, 4, 5], [2, 3, 0], [2, 5, 3]]
    return obstacle(points, [[0, 1, 2], [3, 5, 4], *sides], friction=0.0)


@pytest.mark.slow
def test_a_body_slides_along_edges_without_being_braked() -> None:
    """The surface in front of a point faces along the edge: with its normal the body lost 8 % of
    its speed in 30 frames, or gained 3 %."""
    box = cube((-0.2, 0.005, -0.2), (0.4, 0.2, 0.4))
    solver = contact_solver(
        box, particles=400, material="jelly", velocity=(2.0, 0.0, 0.0), frames=13, fps=24.0,
        colliders=(ridge(-0.1), ridge(0.1)), gravity=GRAVITY, floor=None,
    )  # fmt: skip
    assert solver.pairs is not None
    m, met = solver.body.m, 0
    for frame in solver.frames():
        speed = float(m @ frame.particles.v[:, 0] / m.sum())
        met += int((solver.pairs._edges.key >= 0).sum())
        assert frame.health.let_go == 0
    assert met > 0
    assert speed == pytest.approx(2.0, rel=2e-3)


def test_an_obstacle_that_leaves_the_body_it_began_in_no_longer_overlaps_it() -> None:
    """The depth at the start counted as overlap for ever."""
    way = [(0.0, -0.15 * k, 0.0) for k in range(7)]
    solver = contact_solver(
        slab(0.3, 0.5), colliders=(post(0.6, 0.1, offset=way),), particles=600, frames=7,
        fps=24.0, gravity=(0.0, 0.0, 0.0), floor=None,
    )  # fmt: skip
    health = [frame.health for frame in solver.frames()]
    assert health[1].overlap > 0.05
    assert health[-1].overlap == 0.0
    assert max(h.let_go for h in health) == 0


@pytest.mark.slow
def test_a_finely_divided_edge_holds_as_a_whole_one_does() -> None:
    """Each of its vertices stands out; they took all places, and made contact stiffer."""
    t = np.linspace(-0.2, 0.2, 161)
    corner = [[-0.2, 0.45], [0.2, 0.45], [0.2, 0.05], [-0.2, 0.05]]  # x and y
    rows = np.array([[[x, y, z] for x, y in corner] for z in t])
    k = np.arange(160)[:, None]
    a, b = np.arange(4), np.roll(np.arange(4), -1)
    lower = np.stack([4 * k + a, 4 * k + b, 4 * k + 4 + b], 2).reshape(-1, 3)
    upper = np.stack([4 * k + a, 4 * k + 4 + b, 4 * k + 4 + a], 2).reshape(-1, 3)
    ends = [[0, 3, 2], [0, 2, 1], [640, 641, 642], [640, 642, 643]]
    fine = obstacle(rows.reshape(-1, 3), np.concatenate([lower, upper, ends])[:, ::-1])
    steps = []
    for wall in (fine, post(0.45, 0.2)):
        solver = contact_solver(
            slab(0.3, 0.5), colliders=(wall,), particles=600, material="jelly", frames=13,
            fps=24.0, gravity=GRAVITY, floor=None,
        )  # fmt: skip
        health = [frame.health for frame in solver.frames()]
        spacing = solver.particles.spacing
        assert max(h.let_go for h in health) == 0
        assert max(h.pierced or 0.0 for h in health) < SHALLOW * spacing
        steps.append(sum(h.substeps for h in health))
    assert steps[0] < 1.15 * steps[1]
