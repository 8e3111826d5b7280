"""Edges and corners of obstacles hold bodies up between their contact samples."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from contact_scenes import contact_solver, obstacle
from solids import CUBE_POINTS, cube

from gf_usd.core.stage import Collider
from gf_usd.physics.contact.obstacles import edges
from gf_usd.physics.contact.obstacles.edges import FEWEST, SHARE, capacity
from gf_usd.physics.contact.planes.contact_planes import NOBODY, ContactPlanes
from gf_usd.physics.total_lagrangian import setup
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
    skin, points = solver.pairs._skin(0), solver.pairs._edges
    x = np.array([[0.2, height, 0.2] for height in (0.49, 0.51, 0.54)])
    inward = np.tile([-1.0, -1.0, -1.0], (3, 1)) / np.sqrt(3.0)

    def near(X: Any, known: Any) -> Any:
        return skin.near(X, known, now.nodes[0], now.offset, 2.0 * spacing)

    for had, found in ((True, [2, 1, 0]), (False, [1, 0])):
        rows, depth, normal, place, _ = points._faced(x, inward, np.zeros(3), np.full(3, had), near)
        assert rows.tolist() == found
        assert depth == pytest.approx(x[rows, 1] - 0.5, abs=1e-6)
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


def test_the_work_of_a_moving_corner_is_what_a_body_gains() -> None:
    solver = struck()
    assert solver.pairs is not None
    seen, faced = [], 0
    for frame in solver.frames():
        seen.append(frame.health)
        planes = solver.pairs.planes
        faced += int((planes.partner[len(solver.pairs._X) :] >= 0).sum())
    energy = [h.kinetic + h.elastic + h.potential + h.contact for h in seen]
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


def test_points_for_which_there_is_no_room_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """The deepest have a plane."""
    monkeypatch.setattr(setup, "capacity", lambda *_: 2)
    solver = contact_solver(
        slab(0.3, 0.5), colliders=(post(0.45, 0.2),), particles=600, material="jelly",
        frames=8, fps=24.0, gravity=GRAVITY, floor=None,
    )  # fmt: skip
    left = [frame.health.let_go for frame in solver.frames()]
    assert max(left) > 0
    assert solver.pairs is not None
    assert (solver.pairs._edges.key >= 0).sum() == 2


def test_there_is_room_for_the_edges_that_a_body_can_meet() -> None:
    box = post(0.45, 0.2)
    assert capacity([], 1000, 0.1) == 0
    assert capacity([box], 10_000, 0.1) == 8 + np.ceil(0.5 * 12 * (0.8 + np.sqrt(0.32)) / 0.1)
    assert capacity([box], 10_000, 1e-4) == 10_000 // SHARE
    assert capacity([box], 10, 1e-3) == FEWEST
    assert capacity([replace(box, shape="plane")], 1000, 0.1) == 0


def test_a_place_is_free_once_its_point_has_no_plane() -> None:
    def unused(_: int) -> Any:
        raise AssertionError

    points = edges.EdgePoints(2, 3, [], unused, unused, 0.1)
    planes = ContactPlanes(
        partner=np.array([NOBODY, NOBODY, 0, NOBODY, 1]), carriers=np.zeros((5, 3), int),
        weights=np.zeros((5, 3)), obstacle=np.zeros(5, int), normal=np.zeros((5, 3)),
        point=np.zeros((5, 3)), velocity=np.zeros((5, 3)), spring=np.zeros((5, 3)),
    )  # fmt: skip
    points.key[:] = 7, 8, 9
    points.v[:] = 1.0
    points.begin(0.5, planes)
    assert points.key.tolist() == [7, -1, 9]
    assert (points.x == 0.5).all()
    place = points._placed(np.array([9, 11, 7, 12]), np.array([0.2, 0.1, 0.0, 0.1]))
    assert place.tolist() == [2, 1, 0, -1]
    assert points.key.tolist() == [7, 11, 9]
    assert points.left_out == 1
