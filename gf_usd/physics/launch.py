"""Substeps as launches of kernels.

On the CPU a launch is as many substeps as take a moment, shared among threads inside it; on a GPU
it is one substep, over all threads.  Both take the same sums in the same order: how substeps are
cut into launches, and among threads, changes no bit.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.physics.crew import Crew
from gf_usd.physics.launcher import Launcher
from gf_usd.physics.stages import CLOSES, OPENS
from gf_usd.runtime import cores

if TYPE_CHECKING:
    from gf_usd.physics.solver import TotalLagrangian

FILTER_STEP = 0.2  # the filter acts once r dt has added up to this


class Launches:
    """The launches of a body's substeps.

    over_all : each substep is a launch over all threads; None: on a GPU.
    """

    def __init__(self, solver: TotalLagrangian, over_all: bool | None = None) -> None:
        gpu = solver.settings.device != "cpu"
        self.crew = None
        self._vectors = (solver.vector(solver.settings.gravity), solver.vector(solver.normal))
        if gpu if over_all is None else over_all:
            self._kernel = Launcher(solver.kernels.parallel, solver.pack)
        else:
            self._kernel = Launcher(solver.kernels.relay, solver.pack)
            self.crew = Crew(solver.settings.threads or cores(), len(solver.particles))

    def run(self, solver: TotalLagrangian, substeps: int, dt: float, active: int) -> None:
        """So many substeps of dt [s] in which `active` contact samples are looked at."""
        s, free = solver.settings, solver.stencil.free_count
        every, alpha = filter_of(s.filter_rate, dt)
        counts = (solver.batches.groups, free, solver.stencil.node_count - free, active)
        lift = float(solver.offset @ solver.normal)
        numbers = (alpha, *self._vectors, lift, dt, float(np.exp(-s.drag * dt)))
        done = 0
        while done < substeps:
            many = self.crew.fitting(substeps - done) if self.crew else 1
            ends = (OPENS if done == 0 else 0) | (CLOSES if done + many == substeps else 0)
            when = (every, (solver.done + done) % every if every else 0)
            if self.crew:
                tail = (many, ends, *when, *numbers)
                self.crew.launch(partial(self._draw, counts, tail), many)
            else:
                self._kernel(*counts, ends, *when, *numbers)
            done += many
        solver.done += substeps

    def _draw(self, counts: tuple[int, ...], tail: tuple[Any, ...], threads: int) -> None:
        self._kernel(*counts, threads, *tail)


def filter_of(rate: float, dt: float) -> tuple[int, float]:
    """Substeps between filters and the strength of one: alpha = 1 - exp(-r k dt)."""
    if rate <= 0.0:
        return 0, 0.0
    if np.isinf(rate):
        return 1, 1.0
    every = max(1, int(FILTER_STEP / (rate * dt)))
    return every, float(1.0 - np.exp(-rate * every * dt))
