"""Limbs that are close to each other at rest: two teeth of a comb, a fraction of a cell apart.

Each tooth is a cantilever that must vibrate as without the other.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.frames.particles import Particles
from gf_usd.core.stage import Pin
from gf_usd.geometry.connected.copies import find_limbs
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import box_particles, comb, elastic, iterate_states, make_solid, settings
from gf_usd.verify.case import RELATIVE, Case, Measure, fit_frequency

E, DENSITY = 1e5, 1000.0  # [Pa], [kg/m^3]; cells are 1 m wide
WIDTH, LENGTH, ROOT, DEPTH = 2.0, 12.0, 2.0, 2.0  # [m] of a tooth and of what it hangs from
GAPS = (0.25, 2.75)  # [m] the first lies within a cell, across the second nodes are not shared
CORNER = (-0.5, 0.0, 0.0)  # [m] where a cell begins
SPEED = 1e-3  # of the first vibration's, by its frequency and a length of 1 m: small strains
FRAMES = 48  # a period
# [rad/s] of a slender cantilever's first vibration, 1.8751^2 sqrt(E I / rho A) / L^2
OMEGA = 1.87510**2 * float(np.sqrt(E / DENSITY / 12.0)) * WIDTH / LENGTH**2


def comb_particles(which: tuple[int, ...], gap: float) -> Particles:
    """Teeth of a comb, or one alone, with particles that integrate every cell exactly."""
    step = WIDTH + gap
    bounds = [((k * step, 0, 0), (k * step + WIDTH, LENGTH, DEPTH)) for k in which]
    left, right = bounds[0][0][0], bounds[-1][1][0]
    body = box_particles([*bounds, ((left, LENGTH, 0), (right, LENGTH + ROOT, DEPTH))], 1.0, CORNER)
    surface = comb(len(which), WIDTH, gap, LENGTH, ROOT, DEPTH)
    moved = replace(surface, points=surface.points + [left, 0.0, 0.0])
    limbs = find_limbs(make_solid(moved), body, np.zeros(1, np.int64))
    return replace(body, copies=limbs.copies if limbs else None)


def root_pin() -> Pin:
    """A pin that holds all that lies over the teeth."""

    def nearest(X: Floats) -> Floats:
        return np.c_[X[:, 0], np.full(len(X), LENGTH), X[:, 2]]

    anchors = [0.0, LENGTH, 0.0] + np.vstack([np.zeros(3), np.eye(3)])
    return Pin(
        name="root", inside=lambda X: X[:, 1] > LENGTH, nearest=nearest, anchors=anchors,
        path=anchors[None],
    )  # fmt: skip


def swing_teeth(which: tuple[int, ...], gap: float, device: str) -> tuple[Floats, list[Floats]]:
    """Times [s], and how far [m] the end of each tooth is then; neighbors start in antiphase."""
    body = comb_particles(which, gap)
    tooth = np.floor(body.X[:, 0] / (WIDTH + gap)).astype(int)
    solver = TotalLagrangian(
        body, [elastic(E=E, nu=0.0, density=DENSITY)],
        settings(device, frames=2 * FRAMES, fps=FRAMES * OMEGA / (2.0 * np.pi), safety=0.8),
        pins=[root_pin()],
    )  # fmt: skip
    # By the teeth of the particles: the position of a node does not determine its tooth.
    deflection = (-1.0) ** tooth * np.maximum(0.0, 1.0 - body.X[:, 1] / LENGTH) ** 2
    nodes = solver.body.stencil
    W = solver.body.rows.combined[:, : nodes.free_count]
    v = np.zeros((nodes.node_count, 3))
    v[: nodes.free_count, 0] = SPEED * OMEGA * (W.T @ (solver.body.m * deflection)) / nodes.mass
    v[nodes.free_count :] = nodes.follow @ v[: nodes.free_count]
    solver.state.load({**solver.state.save(), "v": v})
    ends = [(tooth == k) & (body.X[:, 1] < 1.0) for k in which]
    t, results = [], []
    for time, state in iterate_states(solver):
        t.append(time)
        moved = state.particles.x[:, 0] - body.X[:, 0]
        results.append([np.average(moved[end], weights=body.V0[end]) for end in ends])
    return np.array(t), list(np.array(results).T)


WHY = (
    "the same cells, except at the root: there the two share nodes, and a pinned node mirrors its"
    " surroundings; h = 1/12 of the length, squared"
)


def two_teeth(device: str) -> Iterator[Measure]:
    """Frequency and swing of each tooth over those of the same tooth alone."""
    for gap in GAPS:
        t, pair = swing_teeth((0, 1), gap, device)
        for k in (0, 1):
            _, (single,) = swing_teeth((k,), gap, device)
            pairs = {
                "frequency": [fit_frequency(t, q, OMEGA) for q in (pair[k], single)],
                "swing": [float(np.ptp(q)) for q in (pair[k], single)],
            }
            for name, (value, target) in pairs.items():
                yield Measure(
                    name=f"{name}.{gap:g}.{k}", value=value / target, target=1.0,
                    bound=1.0 / LENGTH**2, kind=RELATIVE, why=WHY,
                )  # fmt: skip


CASES = (
    Case(
        name="limbs",
        what=(
            "Two teeth of a comb, 6 times as long as thick, swing against each other, a quarter of"
            " a cell and 2.75 cells apart.  Frequency and amplitude of each relative to those of a"
            " single tooth."
        ),
        source="the same tooth without the other, which shares no node with anything",
        quick=two_teeth,
    ),
)
