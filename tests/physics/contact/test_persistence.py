"""Planes of bodies that hardly move are kept, and found anew where that is no longer right."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from contact_scenes import contact_solver, half_space
from solids import cube, sphere

from gf_usd.core.arrays import Floats
from gf_usd.physics.contact.detection.pair_search import PairSearch
from gf_usd.physics.contact.planes.contact_planes import nothing
from gf_usd.physics.contact.planes.persistence import APPROACH, DEFORMED, Outlook, Persistence
from gf_usd.physics.contact.stability import PairSprings
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian

DOWN = (0.0, -9.81, 0.0)


def stack(frames: int = 60, **options: Any) -> TotalLagrangian:
    """A box on a box on a half space, which settle under gravity."""
    return contact_solver(
        cube(path="/Low"), cube((0.0, 1.25, 0.0), path="/High"), particles=250, frames=frames,
        gravity=DOWN, colliders=(half_space(),), changes={"damping_time": 0.03, "restitution": 0.2},
        **options,
    )  # fmt: skip


def never(monkeypatch: pytest.MonkeyPatch) -> None:
    """Search from all bodies at every detection."""
    monkeypatch.setattr(Persistence, "kept", lambda self, planes, now: np.zeros(2, bool))


@dataclass
class Run:
    """A stack that settles, searched `searches` times after frame 40."""

    solver: TotalLagrangian
    searches: int = 0
    injected: float = 0.0  # [J]
    health: Any = None  # of frame 50
    saved: Any = None  # after frame 50
    kept: Any = None  # the bodies that were not searched from then
    x: Any = None  # at the end


def settled() -> Run:
    run, search = Run(stack()), PairSearch.bodies

    def counted(self, offered: Any, searched: dict[int, list[int]], *more: Any) -> None:
        run.searches += len(searched)
        search(self, offered, searched, *more)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PairSearch, "bodies", counted)
        for frame in run.solver.frames():
            if frame.index == 40:
                run.searches = 0
            if frame.index == 50:
                assert run.solver.pairs is not None
                run.kept = run.solver.pairs._kept.copy()
                run.health, run.saved = frame.health, run.solver.save()
            run.x, run.injected = frame.particles.x, run.injected + frame.health.injected
    return run


@pytest.fixture(scope="module")
def at_rest() -> Run:
    return settled()


@pytest.mark.slow
def test_a_stack_at_rest_is_searched_seldom_and_stays_where_it_is(monkeypatch, at_rest) -> None:
    never(monkeypatch)
    usual = settled()
    assert at_rest.searches < 0.5 * usual.searches
    spacing = usual.solver.particles.spacing
    assert np.abs(at_rest.x - usual.x).max() < 0.05 * spacing
    scale = usual.solver.body.m.sum() * 9.81  # [J] m g r, of 1 m
    assert abs(at_rest.injected) < 1.1 * abs(usual.injected) + 1e-4 * scale


def test_a_state_with_kept_planes_continues_bit_identically(at_rest) -> None:
    assert at_rest.kept.any()
    other = stack()
    other.load(at_rest.saved)
    *_, end = other.frames_after(50, at_rest.health)
    assert np.array_equal(at_rest.solver.state.view().u, other.state.view().u)
    assert end.index == 59


def test_what_is_thrown_is_searched_from_again(at_rest) -> None:
    assert at_rest.kept.all()
    solver = stack()
    solver.load(at_rest.saved)
    pairs = solver.pairs
    assert pairs is not None
    before = pairs._persistence.x[pairs.members[1]].copy()
    high = solver.body.stencil.node_body[: solver.body.stencil.free_count] == 1

    def moved(speed: float) -> bool:
        solver.throw(np.where(high[:, None], (speed, 0.0, 0.0), 0.0))
        solver.advance(51, solver.substeps)
        return bool((pairs._persistence.x[pairs.members[1]] != before).any())

    assert not moved(0.0), "it is not searched from at rest"
    solver.load(at_rest.saved)
    assert moved(3.0)


@pytest.mark.slow
def test_a_plane_that_the_kernels_lack_is_noticed_and_the_frame_repeated(monkeypatch) -> None:
    """In first attempts at a frame no plane is given to the kernels, so that balls go through each
    other."""
    watched, left_out = PairSprings.watched.func, []

    def lacking(springs: PairSprings) -> Any:
        if solver.lateness is not None and solver.lateness.repeats:
            return watched(springs)
        left_out.append(1)
        return np.zeros(0, np.int64)

    monkeypatch.setattr(PairSprings, "watched", property(lacking))
    left, right = (sphere(center=(x, 0.0, 0.0), path=p) for x, p in ((-1.05, "/L"), (1.05, "/R")))
    solver = contact_solver(
        left, right, particles=300, frames=12, velocity=[(2.0, 0.0, 0.0), (-2.0, 0.0, 0.0)]
    )
    *_, last = solver.frames()
    assert left_out
    center = [last.particles.v[solver.particles.body_of == k].mean(0)[0] for k in (0, 1)]
    assert center[0] < 0.0 < center[1], "they rebound"


def facing(x: Floats) -> Any:
    """Planes of sample 0, of the first body, carried by samples 1 to 3 of the second."""
    planes = nothing(4)
    planes.partner[0], planes.carriers[0], planes.weights[0] = 1, (1, 2, 3), 1.0 / 3.0
    planes.normal[0] = (0.0, 0.0, 1.0)
    planes.point[0] = (0.0, 0.0, 0.05)
    return planes


X = np.array([[0.3, 0.3, 0.2], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def outlook(x: Floats, v: Floats, span: float, **more: Any) -> Outlook:
    return Outlook(
        x=x, v=v, mean=np.array([v[0], v[1:].mean(0)]), spread=np.zeros(2),
        near=np.array([[False, True], [True, False]]), moving=np.zeros(0, bool),
        **{"pull": 0.0, "time": 0.0, "span": span, **more},
    )  # fmt: skip


def noted(spacing: float = 0.5) -> tuple[Persistence, Any]:
    kept = Persistence(
        [np.array([0]), np.array([1, 2, 3])], 0, X, reach=2.0 * spacing, spacing=spacing
    )
    planes, still = facing(X), np.zeros_like(X)
    gap = np.array([0.15, 1.0, 1.0, 1.0])
    kept.note(
        np.array([0, 1]), planes, gap, outlook(X, still, 0.1),
        slide=np.full(4, 0.25), shift=np.zeros(4), own_until=np.full(2, np.inf),
    )  # fmt: skip
    return kept, planes


def test_what_moves_as_one_has_not_slid() -> None:
    kept, planes = noted()
    x = X + (3.0, -2.0, 1.0)
    kept.follow(x)
    assert kept.slid(planes, x) == pytest.approx(np.zeros(4), abs=1e-12)
    assert kept.gaps(planes, x)[0] == pytest.approx(0.15)
    assert kept.approaches(x) == pytest.approx(np.zeros(2), abs=1e-12)
    still = np.zeros_like(X)
    assert kept.kept(planes, outlook(x, still, 0.1)).all()


@pytest.mark.parametrize("axis", range(3))
def test_motions_add_up_over_detections(axis: int) -> None:
    kept, planes = noted()
    x, still = X.copy(), np.zeros_like(X)
    for step in (0.06, 0.06, 0.06, 0.06, 0.06):
        x = x.copy()
        x[0, axis] += step
        kept.follow(x)
    assert kept.slid(planes, x)[0] == pytest.approx(0.3)
    assert kept.approaches(x)[0] == pytest.approx(0.3)
    assert kept.gaps(planes, x)[0] == pytest.approx(0.15 + (0.3 if axis == 2 else 0.0))
    assert not kept.kept(planes, outlook(x, still, 0.1))[0]


@pytest.mark.parametrize(("speed", "stays"), [(0.4, True), (0.6, False)])
def test_speeds_count_until_the_next_detection(speed: float, stays: bool) -> None:
    kept, planes = noted()
    v = np.zeros_like(X)
    v[0, 0] = speed
    assert kept.kept(planes, outlook(X, v, 0.1)).tolist() == [stays, True]


def test_gravity_and_new_neighbors_and_moving_obstacles_and_time_count() -> None:
    kept, planes = noted()
    still = np.zeros_like(X)
    assert kept.kept(planes, outlook(X, still, 0.1, pull=199.0)).all()
    assert not kept.kept(planes, outlook(X, still, 0.1, pull=201.0)).any()  # 0.5 a t^2 > reach
    kept.near[0] = False
    assert kept.kept(planes, outlook(X, still, 0.1)).tolist() == [False, True]
    kept, planes = noted()
    kept.own_until[1] = 1.0
    assert kept.kept(planes, outlook(X, still, 0.1, time=0.8)).tolist() == [True, True]
    assert kept.kept(planes, outlook(X, still, 0.1, time=0.95)).tolist() == [True, False]


def test_a_body_that_is_deformed_is_searched_from_again() -> None:
    kept, planes = noted()
    kept.near[:] = False
    x, still = X.copy(), np.zeros_like(X)
    x[3, 0] += 1.5 * 0.9 * DEFORMED * 0.5  # 2/3 of it is relative to the mean of three samples
    kept.follow(x)
    alone = replace(outlook(x, still, 0.01), near=kept.near)
    assert kept.kept(planes, alone)[1]
    x = x.copy()
    x[3, 0] -= 1.5 * 0.2 * DEFORMED * 0.5
    kept.follow(x)
    assert not kept.kept(planes, replace(alone, x=x))[1]


@pytest.mark.parametrize(("way", "stays"), [(0.9, True), (1.1, False)])
def test_what_is_near_may_approach_by_a_bounded_way(way: float, stays: bool) -> None:
    kept, planes = noted()
    kept.mean[1, 0] = X[0] + (way * APPROACH * 0.5, 0.0, 0.0)  # where the other was
    assert kept.kept(planes, outlook(X, np.zeros_like(X), 0.01))[1] == stays


def test_planes_shifted_from_the_surface_are_found_anew() -> None:
    kept, planes = noted()
    kept.note(
        np.array([0]), planes, np.full(4, 0.1), outlook(X, np.zeros_like(X), 0.1),
        slide=np.full(4, 0.25), shift=np.array([0.04, 0.0, 0.0, 0.0]),
        own_until=np.full(2, np.inf),
    )  # fmt: skip
    assert kept.valid.tolist() == [False, True]


def test_planes_of_an_obstacle_that_moved_are_found_anew() -> None:
    """The frame after the last in which it moved."""
    kept = Persistence([np.array([0]), np.array([1, 2, 3])], 1, X, reach=1.0, spacing=0.5)
    planes, still = facing(X), np.zeros_like(X)
    near = np.array([[True, False, False], [False, False, False]])
    for moving in (True, False):
        now = replace(outlook(X, still, 0.1), near=near, moving=np.array([moving]))
        assert not kept.kept(planes, now)[0]
        kept.note(
            np.array([0, 1]), planes, np.full(4, 0.1), now,
            slide=np.full(4, 0.25), shift=np.zeros(4), own_until=np.full(2, np.inf),
        )  # fmt: skip
    assert kept.kept(planes, now)[0]


@pytest.mark.slow
def test_a_body_that_slides_slowly_over_another_is_not_held_by_kept_planes(monkeypatch) -> None:
    """Near the edges of the upper one planes are tilted: kept for long, they were a wall."""

    def way() -> float:
        low = cube((-1.5, -0.5, -0.5), edge=(3.0, 0.5, 1.0), path="/Low")
        high = cube((-1.0, 0.2, -0.25), edge=0.5, path="/High")
        solver = contact_solver(
            low, high, particles=250, frames=42, gravity=DOWN, changes={"friction": 0.0},
            colliders=(half_space(height=-0.502, friction=5.0),),
            velocity=[(0.0, 0.0, 0.0), (0.15, 0.0, 0.0)],
        )  # fmt: skip
        *_, last = solver.frames()
        mine = solver.particles.body_of == 1
        return float((last.particles.x - solver.particles.X)[mine, 0].mean())

    some = way()
    never(monkeypatch)
    usual = way()
    assert usual > 0.2
    assert some == pytest.approx(usual, rel=0.05)
