"""Substeps as launches of kernels.

A launch has the substeps of `LAUNCH_SECONDS`.  On the CPU threads take pieces of its stages from a
queue; on a GPU every thread has its items of each stage, and waits for the others between stages.
Both take the same sums in the same order: how substeps are cut into launches, and among threads,
changes no bit.

How many threads share a launch, and how many substeps it takes.

Threads of a launch wait for each other without sleeping (`kernels.work_queue`).  This is fastest if
every thread has a core, and slow if a thread waits for a core that another program uses.  So the
CPU time of the threads is compared with the wall time, and if cores were lacking, fewer threads
share the following launches.  No result depends on it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from gf_usd.core.errors import GfUsdError
from gf_usd.physics.taichi_arrays import Launcher
from gf_usd.physics.total_lagrangian.layout import LANES
from gf_usd.physics.total_lagrangian.setup import Body
from gf_usd.physics.total_lagrangian.stages import BLOCK, CLOSES, OPENS, STUCK
from gf_usd.physics.total_lagrangian.state import State
from gf_usd.system.background import running_threads
from gf_usd.system.taichi_runtime import cores

FILTER_STEP = 0.2  # the filter acts once r dt has added up to this
NEVER = 2**31 - 1  # substeps that a kernel can count


class Launches:
    """The launches of a body's substeps.

    kernel : "queued", as on the CPU, or "resident", as on a GPU; None: what the device asks for.
    """

    def __init__(self, body: Body, state: State, kernel: str | None = None) -> None:
        import taichi as ti

        s = body.settings
        vector = ti.types.vector(3, ti.f64 if body.real is np.float64 else ti.f32)
        self._vectors = tuple(
            vector([float(v) for v in values]) for values in (s.gravity, s.normal)
        )
        kernel = kernel or ("queued" if s.device == "cpu" else "resident")
        self._body, self.thread_count = body, None
        self._kernel = Launcher(getattr(body.kernels, kernel), state.pack)
        self._pace = GUESS * len(body.particles)
        if kernel == "queued":
            self.thread_count = ThreadCount(s.threads or cores(), len(body.particles))

    def run(
        self,
        state: State,
        substeps: int,
        dt: float,
        active: int,
        on_launch: Callable[[], None] | None = None,
    ) -> None:
        """So many substeps of dt [s] with `active` contact samples; on_launch : see `Solver`."""
        s, nodes = self._body.settings, self._body.stencil
        free = nodes.free_count
        every, alpha = filter_of(s.filter_rate, dt)
        alpha = min(alpha, 1.0 / self._body.mass.lightest)  # beyond it motions change their sign
        counts = (self._body.layout.groups, free, nodes.node_count - free, active)
        lift = float(state.offset @ s.normal)
        numbers = (alpha, *self._vectors, lift, dt, float(np.exp(-s.drag * dt)))
        done = 0
        while done < substeps:
            many = self._fitting(substeps - done)
            ends = (OPENS if done == 0 else 0) | (CLOSES if done + many == substeps else 0)
            when = (every, (state.done + done) % every if every else 0)
            if self.thread_count:
                tail = (many, ends, *when, *numbers)
                self.thread_count.launch(partial(self._draw, counts, tail), many)
            else:
                self._stay(state, (*counts, self._blocks(counts)), (many, ends, *when, *numbers))
            done += many
            if on_launch:
                on_launch()
        state.done += substeps

    def _fitting(self, substeps: int) -> int:
        """How many of so many substeps the next launch takes."""
        if self.thread_count:
            return self.thread_count.fitting(substeps)
        return max(1, min(substeps, int(LAUNCH_SECONDS / self._pace)))

    def _blocks(self, counts: tuple[int, ...]) -> int:
        """Blocks of threads for so many items: the fewer there are, the sooner all have arrived."""
        groups, free, followers, active = counts
        most = max(LANES * groups, free + followers, active)
        return min(self._body.kernels.held, -(-most // BLOCK))

    def _stay(self, state: State, counts: tuple[int, ...], tail: tuple[Any, ...]) -> None:
        """A launch of threads that stay.  Raises GfUsdError where they did not all start."""
        began = time.perf_counter()
        self._kernel(*counts, *tail)
        if state.get("queue")[STUCK]:  # read when the launch is done
            raise GfUsdError(
                f"the GPU did not run {counts[-1]} blocks of {BLOCK} threads at once",
                "close what else runs on the GPU, or use --device cpu",
            )
        self._pace = (time.perf_counter() - began) / tail[0]

    def _draw(self, counts: tuple[int, ...], tail: tuple[Any, ...], threads: int) -> None:
        self._kernel(*counts, threads, *tail)


def filter_of(rate: float, dt: float) -> tuple[int, float]:
    """Substeps between filters and the strength of one: alpha = 1 - exp(-r k dt)."""
    if rate <= 0.0:
        return 0, 0.0
    if np.isinf(rate):
        return 1, 1.0
    every = max(1, int(min(FILTER_STEP / (rate * dt), NEVER)))
    return every, float(1.0 - np.exp(-rate * every * dt))


LAUNCH_SECONDS = 0.1  # [s] of a launch; Ctrl-C and a change of the thread count wait for its end
FEW = 1_500  # particles for each thread, at least: with fewer they wait more than they work
GUESS = 1e-7  # [s] of a particle and substep, until one is measured
BUSY = 0.75  # of the time that passed: threads that ran for less lacked a core
SHORT = 1e-3  # [s] launches that say nothing of that
REST = 2  # launches of fewer threads before more are tried; doubled each time they lack cores
LONGEST_REST = 512


class ThreadCount:
    """The threads of a body's launches.

    threads : as many as there are; particles : of the body, which may ask for fewer.
    clock, ran : [s] that passed, and that the threads of this process ran.
    others : threads of this process that work at something else.
    """

    def __init__(
        self,
        threads: int,
        particles: int,
        clock: Callable[[], float] = time.perf_counter,
        ran: Callable[[], float] = time.process_time,
        others: Callable[[], int] = running_threads,
    ) -> None:
        self.most = max(1, min(threads, particles // FEW))
        self.size = self.most
        self._clock, self._ran, self._others = clock, ran, others
        self._pace = GUESS * max(1, particles)
        self._fresh = True
        self._rest, self._left = REST, 0

    def fitting(self, substeps: int) -> int:
        """How many of so many substeps the next launch takes."""
        return max(1, min(substeps, int(LAUNCH_SECONDS / self._pace)))

    def launch(self, work: Callable[[int], None], substeps: int) -> None:
        """`work` with as many threads as there seem to be cores for."""
        if self._left:
            self._left -= 1
            self.size = self.size if self._left else self.most
        others = self._others()
        size = min(self.size, max(1, cores() - others)) if others else self.size
        wall, ran = self._clock(), self._ran()
        work(size)
        wall, ran = self._clock() - wall, self._ran() - ran
        if self._fresh:  # it was compiled in that time
            self._fresh = False
            return
        self._pace = wall / substeps
        if self.size > 1 and wall > SHORT and not others:  # their time would count
            self._judge(wall, ran)

    def _judge(self, wall: float, ran: float) -> None:
        """Take fewer threads for a while if these ran for less than the time that passed."""
        if ran >= BUSY * self.size * wall:
            self._rest = REST
            return
        self.size = max(1, min(self.size - 1, round(ran / wall)))
        self._left = self._rest
        self._rest = min(2 * self._rest, LONGEST_REST)
