"""Setting and reading the state of a solver from outside."""

from __future__ import annotations

import numpy as np

from gf_usd.model import Floats
from gf_usd.physics.solver import TotalLagrangian


def put(solver: TotalLagrangian, u: Floats, v: Floats | None = None) -> None:
    """Set displacement u and velocity v (M, 3) [m], [m/s] of all nodes; v None: at rest."""
    still = np.zeros_like(u) if v is None else v
    solver.restore(
        {
            **solver.save(),
            "u": u.astype(solver.real).ravel(),
            "v": still.astype(solver.real).ravel(),
            "offset": np.zeros(3),
            "time": 0.0,
            "done": 0,
        }
    )


def force(solver: TotalLagrangian) -> Floats:
    """Force (free, 3) [N] on the free nodes where they are, by the kick of one substep.

    The solver has to be at rest; it moves on by a frame.
    """
    before = solver.state()[1]
    solver.advance(1, 1)
    kick = solver.state()[1] - before
    return solver.stencil.mass[:, None] * kick / solver.frame_time


def virial(solver: TotalLagrangian) -> Floats:
    """P (3, 3) [Pa] of a body that is strained evenly, from the forces on its nodes.

    With every node free sum_i X_i (x) G_ip = I, and so -sum_i f_i (x) X_i = sum_p V0_p P.
    """
    f = force(solver)
    return -f.T @ solver.stencil.free_X / float(solver.particles.V0.sum())


def accelerate(solver: TotalLagrangian, b: Floats) -> None:
    """Replace the body force of the frames to come; b (free, 3) [m/s^2]."""
    solver.acceleration = b
    solver.arrays["acceleration"].from_numpy(np.ascontiguousarray(b, dtype=solver.real).ravel())
