"""What a detection keeps of the one before, sample by sample."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from contact_scenes import contact_solver, half_space
from solids import cube
from two_legs import legs

from gf_usd.physics.contact.pairs import BodyContact
from gf_usd.physics.contact.planes import layout
from gf_usd.physics.contact.planes.contact_planes import OBSTACLE
from gf_usd.physics.contact.planes.intervals import LATE, REPEATS, Lateness, until_stopped

GAP = 0.5  # [m]
FLAT = 0.05  # of its height: 0.6 spacings of 12


def put(solver, y: float) -> None:
    """Squeeze legs flat, their underside at a height y [m], with the tips near each other."""
    X, u = solver.body.stencil.free_X, solver.state.rows("u")
    u[: len(X), 1] = y + FLAT * X[:, 1] - X[:, 1]
    over = (GAP - 0.1) * np.clip(X[:, 1] - 0.2, 0.0, 1.0)
    u[: len(X), 0] = np.where(X[:, 0] > 0.4 + 0.5 * GAP, -over, 0.0)
    solver.state.put("u", u)


@pytest.mark.slow
def test_what_is_inside_something_else_is_not_held_to_be_inside_its_own_body():
    """The other side of a body squeezed flat lies behind a sample; it never came through it."""
    solver = contact_solver(
        legs(GAP), particles=400, self_contact=True, colliders=(half_space(),), frames=2
    )
    pairs, s = solver.pairs, solver.particles.spacing
    assert pairs is not None
    for y in (-0.05 * s, -0.1 * s):
        put(solver, y)
        pairs.detect(solver.state, 1, solver.dt, 0, solver.substeps)
    faces, contact = pairs.planes, solver.body.contact
    assert contact is not None
    under = contact.samples.X[:, 1] < 1e-9
    assert (faces.obstacle[under] == 0).all()
    assert pairs.totals(solver.state)[2] < 0.11 * s


@pytest.mark.slow
def test_faced_springs_are_those_to_other_bodies_and_obstacles():
    """Not those of a body to itself, which its legs squeezed together have."""
    solver = contact_solver(
        legs(GAP), particles=400, self_contact=True, colliders=(half_space(),), frames=2
    )
    s = solver.particles.spacing
    put(solver, 0.1 * s)
    contact = BodyContact(solver.body)
    springs = contact.faced_springs(solver.state, solver.dt)
    assert springs is not None
    facing = springs.planes.facing
    assert 0 < len(facing) < len(contact.planes.facing)
    assert (springs.planes.obstacle[facing] == 0).all()
    assert np.array_equal(springs.touching[0], facing), "all count as in contact"
    put(solver, 10.0 * s)
    springs = BodyContact(solver.body).faced_springs(solver.state, solver.dt)
    assert springs is not None
    assert len(springs.planes.facing) == 0


def test_a_frame_that_blows_up_ends_at_once_and_without_a_warning(monkeypatch):
    """Planes do not follow what is no number; the frame loop throws the frame away."""
    solver = contact_solver(
        cube(path="/Low"), cube((0.0, 1.4, 0.0), path="/High"), particles=130, frames=2, fps=2.0,
        gravity=(0.0, -9.81, 0.0), velocity=[(0.0, 0.0, 0.0), (0.0, -4.0, 0.0)],
    )  # fmt: skip
    pairs, run = solver.pairs, solver._run
    assert pairs is not None
    after = []

    def blow_up(*args):
        run(*args)
        if len(pairs.planes.active):
            after.append(args)
            solver.state.put("u", np.full_like(solver.state.rows("u"), np.nan))

    monkeypatch.setattr(solver, "_run", blow_up)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solver.advance(1, solver.substeps)
    assert len(after) == 1
    assert "finite" in solver.not_finite()[1]


@pytest.mark.parametrize("body", [0, 1])
def test_a_body_that_blows_up_is_named_and_no_other(body: int, monkeypatch) -> None:
    """Its mean was subtracted from the others, and the first of all was reported; and without
    planes the frame continued, in which the others met a body that is nowhere."""
    solver = contact_solver(
        cube(path="/Low"), cube((0.0, 3.0, 0.0), path="/High"), particles=130, frames=2, fps=3.0,
        gravity=(0.0, -9.81, 0.0), velocity=[(0.0, 0.0, 0.0), (0.0, -30.0, 0.0)],
    )  # fmt: skip
    run, after = solver._run, []

    def blow_up(*args):
        run(*args)
        after.append(args)
        u = solver.state.rows("u")
        mine = solver.body.stencil.node_body[: solver.body.stencil.free_count]
        u[np.flatnonzero(mine == body)[0]] = np.nan
        solver.state.put("u", u)

    monkeypatch.setattr(solver, "_run", blow_up)
    solver.advance(1, solver.substeps)
    assert len(after) == 1
    particle, why = solver.not_finite()
    assert solver.particles.body[particle] == body
    assert why.startswith("1 of ")


FAR = 1e5  # [m]: positions there are 1/128 m apart in single precision


def test_contact_knows_where_samples_are_far_from_the_origin(monkeypatch):
    """A jelly torus at 5 km never came to rest, and at 200 km its bake failed."""
    solver = contact_solver(
        cube((FAR, 0.0, 0.0), path="/Low"), cube((FAR, 1.2, 0.0), path="/High"),
        colliders=(half_space(),), particles=130, frames=3, fps=8.0, gravity=(0.0, -9.81, 0.0),
        velocity=[(0.0, 0.0, 0.0), (0.0, -2.0, 0.0)],
    )  # fmt: skip
    pairs, contact, settle = solver.pairs, solver.body.contact, solver.settling.frame
    assert pairs is not None
    assert contact is not None
    seen = []

    def look_around(state):
        ground = pairs.planes.only(pairs.watched).partner == OBSTACLE
        offset = state.view().offset + layout.origin_of(contact.samples.X)
        place = state.part("pair", layout.ROW, layout.PLACE, layout.RATE) + offset
        point = state.part("pair", layout.ROW, layout.POINT, layout.NORMAL) + offset
        below = (place - point)[ground]
        (held,) = solver.settling._supports(state).values()
        found = pairs.motion(state.view())[0]
        seen.append(((place - found)[pairs.active], below, held.point))
        return settle(state)

    monkeypatch.setattr(solver.settling, "frame", look_around)
    solver.advance(1, solver.substeps)
    ((off, below, held),) = seen
    assert np.abs(off[:, [0, 2]]).max() < 5e-4  # of half a substep
    assert len(below)
    np.testing.assert_allclose(below, 0.0, atol=0.5)  # planes start beneath their samples
    assert np.abs(held - (FAR + 0.5, 0.0, 0.5))[[0, 2]].max() < 1e-3


def test_scenes_around_the_origin_keep_it():
    X = np.array([[-1.0, 0.0, 0.0], [3.0, 1.0, 2.0]])
    np.testing.assert_array_equal(layout.origin_of(X), 0.0)
    np.testing.assert_array_equal(layout.origin_of(X[:0]), 0.0)
    np.testing.assert_allclose(layout.origin_of(X + (0.0, 1000.0, 0.0)), (0.0, 992.0, 0.0))


@pytest.mark.parametrize("material", ["jelly", pytest.param("clay", marks=pytest.mark.slow)])
def test_what_falls_along_with_a_body_meets_it_when_the_floor_stops_it(material):
    """They had no relative velocity, so that contact was not detected before the end of the frame.

    Fruits fell through the bowl of rubber that they were in.
    """
    solver = contact_solver(
        cube((0.0, 0.2, 0.0), (1.0, 0.3, 1.0), path="/Low"),
        cube((0.3, 0.7, 0.3), 0.4, path="/High"),
        particles=400, material=material, frames=2, fps=8.0, gravity=(0.0, -9.81, 0.0),
        velocity=(0.0, -4.0, 0.0), floor=0.0,
    )  # fmt: skip
    pairs, s = solver.pairs, solver.particles.spacing
    assert pairs is not None
    solver.advance(1, solver.substeps)
    place, (low, high) = pairs.motion(solver.state.view())[0], pairs.members
    beneath = low[(np.abs(place[low][:, [0, 2]] - 0.5) < 0.25).all(1)]
    assert place[high, 1].min() > place[beneath, 1].max() - 0.25 * s
    assert pairs.released == 0


def test_a_stop_is_awaited_and_then_a_distance_at_the_speed_of_it():
    def until(height, closing, pull=0.0):
        return until_stopped(np.array(height), np.array(closing), pull, 0.1)

    assert until([2.0], [4.0]) == pytest.approx(0.5 + 0.1 / 4.0)
    assert until([2.0, -0.01], [4.0, 10.0]) == pytest.approx(0.01)  # this one is in the floor
    assert until([2.0], [0.0], 9.0) == pytest.approx(2.0 / 3.0 + 0.1 / 6.0)
    assert until([0.0, 2.0], [0.0, -1.0]) > 1e9  # at rest, and upward
    assert until([], []) == np.inf


def squeezed(by: float, gap: float, **changes):
    """A cube at rest on the floor, by a factor as high as it was, and a slab at a gap [m] above."""
    solver = contact_solver(
        cube(path="/Low"), cube((-0.5, by + gap, -0.5), (2.0, 0.3, 2.0), path="/High"),
        particles=800, frames=3, fps=8.0, floor=0.0, **changes,
    )  # fmt: skip
    X, u = solver.body.stencil.free_X, solver.state.rows("u")
    low = solver.body.stencil.node_body[: len(X)] == 0
    u[: len(X), 1] = np.where(low, (by - 1.0) * X[:, 1], 0.0)
    solver.state.put("u", u)
    return solver


def test_what_rebounds_meets_what_was_at_rest_above_it():
    """Nothing moved when it was last looked for, and the frame lasts longer than the rebound.

    It went through by two spacings, and its samples were released.
    """
    solver = squeezed(0.8, 0.35)
    pairs, s = solver.pairs, solver.particles.spacing
    assert pairs is not None
    last = solver.read(0).health
    for index in (1, 2):
        last = solver.next(index, last).health
        assert pairs.released == 0
        place, (low, high) = pairs.motion(solver.state.view())[0], pairs.members
        beneath = low[(np.abs(place[low][:, [0, 2]] - 0.5) < 0.25).all(1)]
        over = high[(np.abs(place[high][:, [0, 2]] - 0.5) < 0.5).all(1)]
        assert place[over, 1].min() > place[beneath, 1].max() - 0.5 * s


def test_a_frame_done_again_for_its_contact_is_forgotten_after_it():
    solver = squeezed(0.8, 0.35)
    pairs, attempts, advance = solver.pairs, [], solver.advance
    assert pairs is not None

    def counted(*args):
        attempts.append(args)
        return advance(*args)

    solver.advance = counted
    frame = solver.next(1, solver.read(0).health)
    assert 1 < len(attempts) <= 1 + REPEATS
    assert frame.health.rollbacks == 0  # it did not fail
    pairs.lateness.renew()
    assert pairs.lateness.bound(solver.state.time) == np.inf


@pytest.mark.slow
def test_an_attempt_that_ended_with_an_exception_leaves_no_trace():
    """Another state that is loaded after it continues as in a solver that never failed."""
    straight, broken = squeezed(0.8, 0.35), squeezed(0.8, 0.35)
    start = straight.read(0).health
    first = straight.next(1, start).health
    kept = straight.save()
    advance, attempts = broken.advance, []

    def failing(*args):
        attempts.append(args)
        if len(attempts) == 2:
            raise KeyboardInterrupt
        return advance(*args)

    broken.advance = failing
    with pytest.raises(KeyboardInterrupt):
        broken.next(1, start)
    broken.load(kept)
    again, frame = broken.next(2, first), straight.next(2, first)
    np.testing.assert_array_equal(again.particles.x, frame.particles.x)
    assert again.health == frame.health


def test_a_late_detection_is_made_sooner_the_next_time():
    late = Lateness()
    late.begin()
    late.note(1.0, took=LATE * 0.1, held=0.1, dt=0.001)
    late.note(1.0, took=0.3, held=0.2, dt=0.3)  # there is none sooner than after a substep
    assert not late.repeat()
    late.note(1.0, took=0.3, held=0.2, dt=0.001)
    late.note(2.0, took=0.3, held=0.01, dt=0.001)  # what follows a late one is no reason
    assert late.repeat()
    assert late.bound(0.9) == np.inf
    assert late.bound(1.0) == pytest.approx(0.8 * 0.2)
    late.begin()
    late.note(0.5, took=1.0, held=1e-9, dt=0.001)  # as in a frame that blows up
    assert late.repeat()
    assert late.bound(0.5) == pytest.approx(0.8 * 0.2)
    for _ in range(REPEATS - 2):
        late.note(0.5, took=0.1, held=0.01, dt=0.001)
        assert late.repeat()
    assert late.bound(0.5) == pytest.approx(0.025)
    late.note(0.5, took=0.1, held=0.01, dt=0.001)
    assert not late.repeat()
    late.renew()
    assert late.bound(0.5) == np.inf
    assert not late.repeat()
