"""How many substeps the contact of bodies takes that are next to each other from the start.

Links of a chain, gears and a lid on its pot touch all the time, or as soon as the bake begins. The
springs between them are therefore known before: one detection at the initial state gives what each
sample faces, and `stability` the substeps that all these springs take together.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.physics.contact.pairs import BodyContact
from gf_usd.physics.contact.planes.contact_planes import ContactPlanes
from gf_usd.physics.contact.stability import CROWD, PairSprings
from gf_usd.physics.frame_loop import Solver
from gf_usd.physics.time_step import StableStep
from gf_usd.physics.total_lagrangian.solver import TotalLagrangian
from gf_usd.physics.total_lagrangian.state import State, StateView


class _Probe(BodyContact):
    """Contact of a body whose detections reach no kernel."""

    ratio = 1.0

    def _upload(
        self,
        state: State,
        now: StateView,
        values: Mapping[str, Floats],
        dt: float,
        f: ContactPlanes,
    ) -> None:
        del state, dt, f
        x, v = self._joined(now, self._detected)
        of, faced = self.planes.bodies(self._of), self.planes.partner
        faces = self.planes.facing
        others = (self.planes.obstacle[faces] >= 0) | (of[faces] != self._of[faced[faces]])
        springs = PairSprings(
            planes=self.planes.only(faces[others]), k=self._k, values=values,
            hardening=self._hardening, spacing=self._spacing, x=x, v=np.zeros_like(v), span=0.0,
            fall=0.0, calm=np.zeros(len(x), bool), nearly=np.inf,
        )  # fmt: skip
        body = self._body
        none = np.zeros(0, np.int64)
        self.ratio = springs.step_ratio(body, self.contact, none, body.step.dt, np.inf)


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
    probe = _Probe(solver.body)
    probe.detect(solver.state, 1, step.dt, 0, solver.coarse)
    return min(probe.ratio, most), most


def step_of(solver: Solver) -> StableStep | None:
    """The stable step of an elastic body at rest; None of other solvers."""
    return solver.body.step if isinstance(solver, TotalLagrangian) else None
