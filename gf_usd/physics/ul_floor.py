"""The floor between the frames of the Updated Lagrangian solver: who is near, what it stores."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gf_usd.physics import host

if TYPE_CHECKING:
    from gf_usd.physics.updated_lagrangian import UpdatedLagrangian


def watch(solver: UpdatedLagrangian, lift: float) -> int:
    """List the samples that may meet the floor in a frame, clear what they noticed; how many.

    lift : [m] of the moving frame of x above the floor.
    """
    if solver.ride is None:
        return 0
    pose = solver.ride.pose(*solver.state())
    normal, span = solver.settings.normal, solver.frame_time
    speed = float(np.abs(pose.v @ normal).max())
    g = abs(float(np.dot(solver.settings.gravity, normal)))
    reach = 2.0 * span * (speed + g * span) + solver.particles.spacing
    near = np.flatnonzero(lift + pose.x @ normal < reach)
    active = np.zeros(len(pose.x), np.int32)
    active[: len(near)] = near
    solver.arrays["sample_active"].from_numpy(active)
    for name in ("sample_force", "sample_depth", "sample_capped"):
        host.clear(solver.arrays[name])
    return len(near)


def contact_energy(solver: UpdatedLagrangian) -> float:
    """sum_s k d^2 / 2 [J] stored in the floor's springs."""
    if solver.ride is None or solver.contact is None:
        return 0.0
    x = solver.ride.pose(*solver.state()).x + solver.offset
    height = x @ solver.settings.normal - (solver.settings.floor or 0.0)
    return float(0.5 * solver.contact.stiffness @ np.maximum(0.0, -height) ** 2)
