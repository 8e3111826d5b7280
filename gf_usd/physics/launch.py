"""Substeps as launches of kernels: a small body's in one, a large one's each over all threads.

Both take the same sums in the same order and agree to the bit, so that one thread alone, which
gains nothing from a launch for each substep, may take the first for any body.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gf_usd.runtime import cores

if TYPE_CHECKING:
    from gf_usd.physics.solver import TotalLagrangian

SERIAL_BELOW = 12_000  # particles; smaller bodies run all substeps in one launch
LAUNCHED = ("serial", "parallel", "start")  # kernels of a substep
FILTER_STEP = 0.2  # the filter acts once r dt has added up to this


def run(solver: TotalLagrangian, substeps: int, dt: float, active: int) -> None:
    """So many substeps of dt [s] in which `active` contact samples are looked at."""
    s = solver.settings
    every, alpha = filter_of(s.filter_rate, dt)
    keep = float(np.exp(-s.drag * dt))
    g, up = solver.vector(s.gravity), solver.vector(solver.normal)
    lift = float(solver.offset @ solver.normal)
    free = solver.stencil.free_count
    counts = (solver.batches.groups, free, solver.stencil.node_count - free, active)
    tail = (g, up, lift, dt, keep, 1.0 / solver.h, solver.converged)
    alone = len(solver.particles) < SERIAL_BELOW or (s.threads or cores()) == 1
    if s.device == "cpu" and alone:
        phase = solver.done % every if every else 0
        solver.launch["serial"](*counts, substeps, every, phase, alpha, *tail)
    else:
        solver.launch["start"](*counts[1:3], 0.5 * dt)
        for k in range(substeps):
            drift = dt if k < substeps - 1 else 0.5 * dt
            due = int(every > 0 and (solver.done + k) % every == 0)
            solver.launch["parallel"](*counts, due, alpha, *tail, drift)
    solver.done += substeps


def filter_of(rate: float, dt: float) -> tuple[int, float]:
    """Substeps between filters and the strength of one: alpha = 1 - exp(-r k dt)."""
    if rate <= 0.0:
        return 0, 0.0
    if np.isinf(rate):
        return 1, 1.0
    every = max(1, int(FILTER_STEP / (rate * dt)))
    return every, float(1.0 - np.exp(-rate * every * dt))
