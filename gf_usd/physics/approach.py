"""Which contact samples may meet the floor before the next frame: only those are looked at."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gf_usd.model import Ints
from gf_usd.physics import host
from gf_usd.physics.anchoring import constants
from gf_usd.physics.setup import floor_height

if TYPE_CHECKING:
    from gf_usd.physics.solver import TotalLagrangian


def watch(solver: TotalLagrangian, lift: float) -> Ints:
    """The samples within reach of the floor; clears what all of them noticed.

    lift : [m] of the moving frame of u along the floor's normal.
    """
    if solver.contact is None:
        return np.zeros(0, np.int64)
    rows, normal, span = solver.contact.rows, solver.normal, solver.frame_time
    u, v = solver.state()
    speed = float(np.abs(v @ normal).max())
    g = abs(float(np.dot(solver.settings.gravity, normal)))
    reach = 2.0 * span * (speed + g * span) + solver.particles.spacing
    height = rows.X @ normal - floor_height(solver.settings)
    if solver.contact.constants is not None:
        c, rate = constants(solver)
        height = height + solver.contact.constants @ ((c + 0.5 * span * rate) @ normal)
        host.put(solver.arrays["sample_height"], height.astype(solver.real))
    height = height + lift + rows.W @ (u @ normal)
    for name in ("sample_force", "sample_depth", "sample_capped"):
        host.clear(solver.arrays[name])
    return np.flatnonzero(height < reach)


def attend(solver: TotalLagrangian, samples: Ints) -> int:
    """Have the kernels look at these samples and no others; returns how many there are."""
    if solver.contact is None:
        return 0
    active = np.zeros(len(solver.contact.mass), np.int32)
    active[: len(samples)] = samples
    host.put(solver.arrays["sample_active"], active)
    host.clear(solver.arrays["sample_force"])
    return len(samples)
