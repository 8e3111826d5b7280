"""What a detection remembers of the one before, sample by sample."""

from __future__ import annotations

import numpy as np
import pytest
from contact_scenes import contact_solver, half_space
from two_legs import legs

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
