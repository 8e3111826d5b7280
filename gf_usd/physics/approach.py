"""Which contact samples may meet the floor before the next frame: only those are looked at."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from gf_usd.physics.solver import TotalLagrangian


def watch(solver: TotalLagrangian, lift: float) -> int:
    """List the samples within reach and clear what they noticed; returns how many there are.

    lift : [m] of the moving frame of u along the floor's normal.
    """
    if solver.contact is None:
        return 0
    rows, normal, span = solver.contact.rows, solver.normal, solver.frame_time
    u, v = solver.state()
    speed = float(np.abs(v @ normal).max())
    g = abs(float(np.dot(solver.settings.gravity, normal)))
    reach = 2.0 * span * (speed + g * span) + solver.particles.spacing
    height = rows.X @ normal - (solver.settings.floor or 0.0)
    if solver.contact.constants is not None:
        c, rate = solver.constants()
        height = height + solver.contact.constants @ ((c + 0.5 * span * rate) @ normal)
        solver.arrays["sample_height"].from_numpy(height.astype(solver.real))
    height = height + lift + rows.W @ (u @ normal)
    near = np.flatnonzero(height < reach)
    active = np.zeros(len(height), np.int32)
    active[: len(near)] = near
    solver.arrays["sample_active"].from_numpy(active)
    for name in ("sample_force", "sample_depth", "sample_capped"):
        solver.arrays[name].fill(0)
    return len(near)
