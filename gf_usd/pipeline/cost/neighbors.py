"""How many substeps the contact of bodies takes that are next to each other from the start.

Links of a chain, gears and a lid on its pot touch all the time, or as soon as the bake begins. The
springs between them are therefore known before: one detection at the initial state gives what each
sample faces, and `stability` the substeps that all these springs take together.
"""

from __future__ import annotations

import numpy as np

from gf_usd.physics.contact.pairs import BodyContact
from gf_usd.physics.contact.stability import CROWD
from gf_usd.physics.frame_loop import Solver
from gf_usd.physics.time_step import StableStep
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian


def contact_factors(solver: Solver) -> tuple[float, float]:
    """Substeps of bodies in contact, relative to those of `solver.substeps`: while they touch all
    that they face in the initial state, and at most, with CROWD springs on every sample.

    (1, inf) where bodies cannot touch, and with other solvers. Leaves the solver as it is.
    """
    if not isinstance(solver, TotalLagrangian) or solver.pairs is None:
        return 1.0, np.inf
    step, contact = solver.body.step, solver.body.contact
    assert contact is not None
    crowded = step.crowded(CROWD * contact.pair_ratio)
    most = step.substeps_with_contact(step.dt, crowded.contact_share)
    springs = BodyContact(solver.body).faced_springs(solver.state, solver.coarse * step.dt)
    if springs is None:
        return min(1.0, most), most
    none = np.zeros(0, np.int64)
    return min(springs.step_ratio(solver.body, contact, none, step.dt, np.inf), most), most


def step_of(solver: Solver) -> StableStep | None:
    """The stable step of an elastic body at rest; None of other solvers."""
    return solver.body.step if isinstance(solver, TotalLagrangian) else None
