"""The stiffest vibration of contact, against the whole matrix of its springs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from contact_scenes import contact_solver
from scipy.sparse.linalg import eigs
from solids import cube, sphere

from gf_usd.core.arrays import Floats, Ints
from gf_usd.physics.contact.planes.contact_planes import ContactPlanes, nothing
from gf_usd.physics.contact.planes.persistence import Persistence
from gf_usd.physics.contact.stability import (
    ACCURACY,
    COLUMN,
    PairSprings,
    largest_depth,
    levers,
    stiffest,
    stretches,
)
from gf_usd.physics.grid.mass import NodalMass
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian

LEFT = sphere(center=(-1.05, 0.0, 0.0), path="/Left")
RIGHT = sphere(center=(1.05, 0.2, 0.0), path="/Right")
HARDENING = 25.0  # [1/m^2]


@cache
def crash() -> tuple[TotalLagrangian, Floats, ContactPlanes, Ints]:
    """Two balls that are pressed into each other: x (n, 3), their planes and who is deep."""
    solver = contact_solver(
        LEFT, RIGHT, particles=300, frames=4, velocity=[(2.0, 0.0, 0.0), (-2.0, 0.0, 0.0)]
    )
    list(solver.frames())
    assert solver.pairs is not None
    x = solver.pairs.motion(solver.state.view())[0]
    planes = solver.pairs.planes
    rows = np.flatnonzero(planes.depth(x, 0.0) > 0.0)
    assert len(rows) > 10
    return solver, x, planes, rows


def whole(x: Floats, planes: ContactPlanes, rows: Ints, k: Floats, W: Floats) -> Floats:
    """(3 nodes, 3 nodes) [N/m] of springs k in all directions, with planes that turn.

    A unit force f on sample s comes back to carrier j as -w_j f + alpha x r_j, with
    J alpha = -(x_s - sum w x) x f (`planes.support_triangles`).
    """
    out = np.zeros((3 * W.shape[1], 3 * W.shape[1]))
    for s, stiffness in zip(rows, k):
        who, w = planes.carriers[s], planes.weights[s]
        r = x[who] - x[who].mean(0)
        J = sum((d @ d) * np.eye(3) - np.outer(d, d) for d in r)
        arm = x[s] - w @ x[who]
        for f in np.eye(3):
            alpha = np.linalg.solve(J, -np.cross(arm, f))
            forces = np.zeros((len(W), 3))
            forces[s] += f
            np.add.at(forces, who, [-wk * f + np.cross(alpha, d) for wk, d in zip(w, r)])
            nodal = (W.T @ forces).ravel()
            out += stiffness * np.outer(nodal, nodal)
    return out


def largest(K: Floats, mass: NodalMass) -> float:
    """[1/s^2] the largest eigenvalue of M^-1 K; K : see `whole`."""
    inverse = np.kron(mass.acceleration(np.eye(len(mass.lumped))), np.eye(3))
    start = np.random.default_rng(0).normal(size=len(K))
    return float(eigs(inverse @ K, 1, v0=start, return_eigenvectors=False)[0].real)


@pytest.mark.slow
@pytest.mark.parametrize("alike", [True, False])
def test_it_is_that_of_the_whole_matrix_or_a_little_more(alike: bool) -> None:
    solver, x, planes, rows = crash()
    contact = solver.body.contact
    assert contact is not None
    mass = solver.body.mass
    k = contact.pair_stiffness[rows]
    if not alike:
        k = k * np.linspace(0.1, 3.0, len(k))
    B = stretches(contact.rows.W, planes, rows, rows[:0])
    found = stiffest(B, mass, k * levers(planes, rows, x, len(x)))
    value = largest(whole(x, planes, rows, k, contact.rows.W.toarray()), mass)
    # Lanczos' residual is added; levers act in one direction and count in all.
    assert value <= 1.001 * found
    assert found <= (1.35 + ACCURACY) * value


def test_it_counts_places_far_outside_of_their_support_triangle() -> None:
    solver, x, planes, rows = crash()
    contact = solver.body.contact
    assert contact is not None
    assert contact.samples.body is not None
    rows = rows[contact.samples.body[rows] == 0]
    shift = np.where((contact.samples.body == 0)[:, None], (0.0, 1.0, 0.0), 0.0)
    x = x + shift  # of one body: its samples leave the carriers of their planes
    lever = levers(planes, rows, x, len(x))
    assert lever.max() > 10.0
    k = contact.pair_stiffness[rows]
    B = stretches(contact.rows.W, planes, rows, rows[:0])
    value = largest(whole(x, planes, rows, k, contact.rows.W.toarray()), solver.body.mass)
    assert stiffest(B, solver.body.mass, k) < 0.5 * value  # as it was: such a frame gained energy
    assert value <= 1.001 * stiffest(B, solver.body.mass, k * lever)


@pytest.mark.slow
def test_planes_of_coarse_meshes_have_carriers_away_from_their_place(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Bars of twelve triangles bend around each other: in a flat face between their vertices the
    places were up to two spacings off what carried them, which made springs a hundred times as
    stiff."""
    most, share = [1.0], PairSprings.share

    def watched(springs: PairSprings, *arguments: Any) -> Callable[[float], float]:
        x, faces = springs.x, springs.planes.on_bodies
        touching = faces[springs.planes.depth(x, 0.0)[faces] > 0.0]
        most.append(float(levers(springs.planes, touching, x, len(x)).max(initial=1.0)))
        return share(springs, *arguments)

    monkeypatch.setattr(PairSprings, "share", watched)
    bars = (
        cube(low=(-2.0, 0.0, -0.25), edge=(4.0, 0.5, 0.5), path="/Along"),
        cube(low=(-0.25, 0.7, -2.0), edge=(0.5, 0.5, 4.0), path="/Across"),
    )
    solver = contact_solver(
        *bars, particles=1000, frames=10, material="jelly",
        velocity=[(0.0, 3.0, 0.0), (0.0, -3.0, 0.0)],
    )  # fmt: skip
    frames = list(solver.frames())
    assert max(frame.health.contact for frame in frames) > 0.0
    assert max(most) < 4.0


@pytest.mark.slow
def test_substeps_of_contact_halve_with_the_step_of_a_failed_frame(monkeypatch) -> None:
    solver = contact_solver(
        LEFT, RIGHT, particles=300, frames=4, velocity=[(2.0, 0.0, 0.0), (-2.0, 0.0, 0.0)]
    )
    # springs that are far stiffer than the bodies, so that contact alone limits the substeps
    stiff = replace(solver.body.step, contact=30.0 * solver.body.step.elastic)
    monkeypatch.setattr(PairSprings, "share", lambda *_: stiff.contact_share)
    list(solver.frames())
    saved, run = solver.state.save(), solver.launches.run
    lengths: list[float] = []

    def noted(state: Any, substeps: int, dt: float, *more: Any) -> None:
        lengths.append(dt)
        run(state, substeps, dt, *more)

    monkeypatch.setattr(solver.launches, "run", noted)
    for halvings in range(3):
        solver.state.load(saved)
        solver.guard.halvings = halvings
        first = len(lengths)
        solver.advance(3, solver.substeps)
        lengths[first + 1 :] = []
    assert lengths[0] < 0.1 * solver.frame_time / solver.coarse
    assert lengths[1] == pytest.approx(0.5 * lengths[0], rel=0.1)
    assert lengths[2] == pytest.approx(0.25 * lengths[0], rel=0.1)


@pytest.mark.slow
def test_springs_of_the_floor_count_where_it_may_be_touched_before_the_next_detection(
    monkeypatch,
) -> None:
    """Two balls meet above the floor and come to it within the same frame of half a second."""
    solver = contact_solver(
        LEFT, RIGHT, particles=300, frames=2, fps=2.0, floor=-1.6, gravity=(0.0, -9.81, 0.0),
        velocity=[(2.0, 0.0, 0.0), (-2.0, 0.0, 0.0)],
    )  # fmt: skip
    counted: list[tuple[int, float]] = []  # samples whose springs count, and the lowest of all [m]
    share = PairSprings.share

    def noted(springs, contact, mass, near) -> Callable[[float], float]:
        height, span = springs.x[:, 1] + 1.6, springs.span
        lowest = height - span * (np.abs(springs.v[:, 1]).max() + 9.81 * span)
        assert set(np.flatnonzero(lowest < 0.0)) <= set(near), "none that touches it is left out"
        counted.append((len(near), float(height.min())))
        return share(springs, contact, mass, near)

    monkeypatch.setattr(PairSprings, "share", noted)
    list(solver.frames())
    high = [near for near, height in counted if height > 0.5]
    low = [near for near, height in counted if height < 0.0]
    assert high
    assert min(high) == 0
    assert low
    assert all(low)


def test_over_the_floor_alone_it_is_the_floors() -> None:
    solver = crash()[0]
    contact = solver.body.contact
    assert contact is not None
    every = np.arange(len(contact.mass))
    B = stretches(contact.rows.W, nothing(len(every)), every[:0], every)
    found = stiffest(B, solver.body.mass, contact.stiffness)
    assert found == pytest.approx(contact.omega2, rel=ACCURACY + 0.01)  # Lanczos' of both


def test_no_springs_no_vibration() -> None:
    contact, planes = crash()[0].body.contact, crash()[2]
    assert contact is not None
    none = np.zeros(0, np.int64)
    B = stretches(contact.rows.W, planes, none, none)
    assert stiffest(B, crash()[0].body.mass, np.zeros(0)) == 0.0


def test_a_sample_stops_where_its_spring_has_taken_its_energy() -> None:
    k, mass = np.full(4, 3.0), np.full(4, 0.01)
    speed, span = np.array([-1.0, 0.1, 0.5, 2.0]), 1e3
    d = largest_depth(np.zeros(4), speed, np.zeros(4), span, k, mass, HARDENING)
    stored = 0.5 * k * d**2 * (1.0 + 0.5 * HARDENING * d**2)
    assert stored == pytest.approx(0.5 * COLUMN * mass * np.maximum(speed, 0.0) ** 2, abs=1e-15)


def test_in_a_short_span_it_comes_no_farther_than_it_moves() -> None:
    depth = np.array([-0.2, -0.01, 0.3])
    d = largest_depth(depth, np.full(3, 2.0), np.zeros(3), 0.01, np.ones(3), np.ones(3), HARDENING)
    assert d == pytest.approx(depth + 0.02)


def test_a_sample_in_free_fall_comes_as_far_as_it_falls() -> None:
    depth, speed, span, g = np.full(3, -1.0), np.array([-0.5, 0.0, 0.5]), 0.1, 9.81
    d = largest_depth(depth, speed, np.full(3, g * span), span, np.ones(3), np.ones(3), HARDENING)
    fallen = speed * span + 0.5 * g * span**2
    assert d == pytest.approx(depth + np.maximum(fallen, 0.0))


@pytest.mark.slow
def test_the_kernels_have_the_planes_that_are_touched_and_their_results_are_those_of_all(
    monkeypatch,
) -> None:
    """Two balls that collide and fall on a floor, with the planes that samples may touch and with
    all planes."""

    def run() -> tuple[Floats, int]:
        solver = contact_solver(
            LEFT, RIGHT, particles=300, frames=20, floor=-1.6, gravity=(0.0, -9.81, 0.0),
            velocity=[(2.0, 0.0, 0.0), (-2.0, 0.0, 0.0)],
        )  # fmt: skip
        assert solver.pairs is not None
        x, held = solver.particles.X, 0
        for frame in solver.frames():
            x, held = frame.particles.x, held + len(solver.pairs.active)
        return x, held

    monkeypatch.setattr(Persistence, "kept", lambda self, planes, now: np.zeros(2, bool))
    some, few = run()
    monkeypatch.setattr(ContactPlanes, "only", lambda self, rows: self)
    every, many = run()
    assert 0 < few < 0.6 * many
    assert np.array_equal(some, every)
