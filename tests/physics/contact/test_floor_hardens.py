"""Floor springs that harden: how deep a mass goes, what it gets back, and the step it takes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from gf_usd.core.frames.frame import Health
from gf_usd.core.frames.particles import SurfaceSamples
from gf_usd.physics.contact.floor import HARD, STOPPING_DISTANCE
from gf_usd.physics.time_step import MARGIN
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.verify.bodies import elastic, particles_at, settings

SPEED = 3.0  # [m/s]
LATTICE = 0.1  # [m] which is the spacing


def deepest(share: float) -> float:
    """[spacings] where k (d^2 / 2 + e^4 / (4 a^2)) is the energy of a mass, `share` of k its own.

    With the whole of k it would stop at STOPPING_DISTANCE.
    """
    energy = 0.5 * STOPPING_DISTANCE**2 / share

    def missing(d: float) -> float:
        e = max(0.0, d - STOPPING_DISTANCE)
        return 0.5 * d**2 + 0.25 * e**4 / HARD**2 - energy

    deepest: Any = brentq(missing, 0.0, STOPPING_DISTANCE / np.sqrt(share))
    return float(deepest)


def collide(share: float, frame: float) -> list[Health]:
    """A point mass that comes at the floor and goes; frames last `frame` of a spacing's way.

    Its sample stands for `share` of its mass, so that k is so much softer than the impact requires.
    """
    body = particles_at(
        np.full((8, 3), 0.5), volume=8.0 * LATTICE**3, lattice=LATTICE, corner=np.zeros(3)
    )
    made = elastic(E=1.0, nu=0.0, density=1.0, restitution=1.0, friction=0.0)
    way = body.spacing + 2.0 * np.pi * STOPPING_DISTANCE * body.spacing / np.sqrt(share)
    s = settings(
        "cpu", frames=2 + int(way / (frame * body.spacing)), fps=SPEED / (frame * body.spacing),
        floor=0.0, lift=(0.0, 0.5 * body.spacing - 0.5, 0.0), followers=False,
    )  # fmt: skip
    samples = SurfaceSamples(X=body.X[:1], area=np.array([share * body.volume / body.spacing]))
    solver = TotalLagrangian(body, [made], s, samples=samples, velocity=(0.0, -SPEED, 0.0))
    return [frame.health for frame in solver.frames()]


@pytest.mark.slow
@pytest.mark.parametrize("share", [1.0, 1.0 / 16.0, 1.0 / 64.0])
def test_a_mass_that_k_is_too_soft_for_stops_where_the_springs_hold_its_energy(share):
    # Linear springs let it in by .25, 1 and 2 spacings.
    step = 0.01
    seen = collide(share, step)
    start = seen[0].kinetic
    depth = max(h.penetration for h in seen) / LATTICE
    # Of the integrator, with the frequency w at the tangent of the deepest point: (w dt)^2 / 8.
    tangent = 1.0 + 3.0 * max(0.0, deepest(share) - STOPPING_DISTANCE) ** 2 / HARD**2
    error = tangent * share * (step / STOPPING_DISTANCE) ** 2 / 4.0
    assert depth == pytest.approx(deepest(share), rel=2.0 * error + 1e-5)
    assert seen[-1].contact == 0.0
    assert seen[-1].kinetic == pytest.approx(start, rel=2.0 * error + 1e-5)
    # What the springs hold is in the energy of each frame.
    energies = np.array([h.kinetic + h.contact for h in seen])
    assert np.abs(energies / start - 1.0).max() <= 2.0 * error + 1e-5


@pytest.mark.slow
def test_no_step_is_longer_than_the_springs_allow_as_hard_as_they_come_to_be():
    share, frame = 1.0 / 64.0, 1.0
    seen = collide(share, frame)
    for h in seen[1:]:
        e = max(0.0, h.penetration / LATTICE - STOPPING_DISTANCE)
        w2 = share * (1.0 + 3.0 * e**2 / HARD**2) / STOPPING_DISTANCE**2  # in SPEED / spacing
        assert h.substeps >= frame * np.sqrt(w2) / (2.0 * MARGIN)
    substeps = [h.substeps for h in seen[1:]]
    assert max(substeps) > substeps[-1] == 1  # those of springs that are hardly pressed
