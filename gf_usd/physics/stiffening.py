"""How much stiffer a strained material is: what the step of the next frame has to follow.

A wave in direction N that moves matter along n changes F by n (x) N, along which J is linear.  So
of a law psi = (shear part) + U(J) it feels at most (`Law.shear`, `Law.bulk`)

    k = shear(mu) + U''(J) (J / s_min)^2,        s_min the smallest singular value of F

which at rest is lam + 2 mu.  A node's frequency is that of all the particles in its cells, so that
the mean of k over a cell is what counts, not a single particle.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from gf_usd.model import Floats
from gf_usd.physics.meeting import CROWD
from gf_usd.physics.setup import per_cell
from gf_usd.physics.timestep import StableStep, grid_frequency

if TYPE_CHECKING:
    from gf_usd.physics.laws import Law
    from gf_usd.physics.solver import TotalLagrangian

SMALLEST = 1e-3  # a stretch below this counts as this: the guard sees to what is flat


def stiffness(law: Law, stretch: Floats, J: Floats, mu: Floats, lam: Floats) -> Floats:
    """k (N,) [Pa] of stretches (N, 3), ascending, and J (N,); mu as `laws.moduli`."""
    area = J / np.maximum(stretch[:, 0], SMALLEST)
    return law.shear(mu) + np.maximum(law.bulk(J, mu, lam), 0.0) * area**2


def wave_speed(k: Floats, density: Floats, order: np.ndarray, cell_start: np.ndarray) -> float:
    """Largest over cells of sqrt(mean k / mean density) [m/s]; order, cell_start : see Stencil."""
    k, density = (np.add.reduceat(v[order], cell_start[:-1]) for v in (k, density))
    return float(np.sqrt((k / density).max()))


def strained_step(rest: StableStep, speed: float, h: float, per_cell: float) -> float:
    """The stable step [s] with waves of this speed [m/s]; contact and damping as at rest.

    No safety is taken off: the mean over a cell is on the safe side, and the guard behind it.
    """
    elastic = grid_frequency(per_cell) * speed / h
    strained = replace(rest, elastic=max(elastic, rest.elastic))
    return strained.limit


def strained_substeps(solver: TotalLagrangian, stretch: Floats, J: Floats) -> int:
    """Substeps a frame that a body as strained now asks for; 1 where they are given."""
    if solver.settings.substeps:
        return 1
    step = solver.step
    if solver.meeting and solver.meeting.imminent(solver):
        step = step.crowded(CROWD)
    k = stiffness(solver.law, stretch, J, solver.per["signed_mu"], solver.per["lam"])
    nodes = solver.stencil
    speed = wave_speed(k, solver.per["density"], nodes.order, nodes.cell_start)
    dt = strained_step(step, speed, solver.h, per_cell(solver.particles, solver.h))
    return int(np.ceil(solver.frame_time / dt))
