"""Kernel launches for the substeps, and the number of threads that share a launch.

A launch covers about `LAUNCH_SECONDS` of substeps. On the CPU, threads take pieces of its stages
from a work queue; on a GPU each thread processes fixed items of each stage, with a grid barrier
between stages. Both sum in the same order: the division of substeps into launches and among threads
does not change a bit of the result.

Threads of a launch wait for each other by spinning (`kernels.work_queue`). This is fastest where
every thread has a core, and slow where a thread waits for a core that another program uses. The CPU
time of the threads is therefore compared with the wall time, and if cores were missing, the next
launches use fewer threads. The result does not depend on the number of threads.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from gf_usd.core.errors import GfUsdError
from gf_usd.physics.taichi_arrays import DeviceState, Launcher
from gf_usd.physics.total_lagrangian.layout import LANES
from gf_usd.physics.total_lagrangian.setup.body import Body
from gf_usd.physics.total_lagrangian.stages import BLOCK, CLOSES, OPENS, STUCK
from gf_usd.physics.total_lagrangian.state import State
from gf_usd.system.background import running_threads
from gf_usd.system.resources import cores

FILTER_STEP = 0.2  # r dt between two applications of the filter of rate r
NEVER = 2**31 - 1  # the largest substep count of a kernel


class Launches:
    """Launches the substeps of a body.

    kernel : "queued", for a CPU, or "resident", for a GPU; None: by the device.
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
        """Run `substeps` substeps of dt [s] with `active` contact samples; on_launch : see
        `Solver`.
        """
        s, nodes = self._body.settings, self._body.stencil
        free = nodes.free_count
        every, alpha = filter_schedule(s.filter_rate, dt)
        alpha = min(alpha, 1.0 / self._body.mass.lightest)  # above it velocities change sign
        counts = (self._body.layout.groups, free, nodes.node_count - free, active)
        lift = float(state.offset @ s.normal)
        numbers = (alpha, *self._vectors, lift, dt, float(np.exp(-s.drag * dt)))
        done = 0
        while done < substeps:
            many = self._substeps_per_launch(substeps - done)
            ends = ends_of(done, many, substeps)
            when = (every, (state.done + done) % every if every else 0)
            if self.thread_count:
                tail = (many, ends, *when, *numbers)
                self.thread_count.launch(partial(self._launch_queued, counts, tail), many)
            else:
                self._launch_resident(
                    state, (*counts, self._blocks(counts)), (many, ends, *when, *numbers)
                )
            done += many
            if on_launch:
                on_launch()
        state.done += substeps

    def _substeps_per_launch(self, substeps: int) -> int:
        """The number of the remaining substeps that the next launch runs."""
        if self.thread_count:
            return self.thread_count.fitting(substeps)
        return fitting(substeps, self._pace)

    def _blocks(self, counts: tuple[int, ...]) -> int:
        """Number of thread blocks for these item counts: a barrier is faster with fewer blocks."""
        groups, free, dependent, active = counts
        most = max(LANES * groups, free + dependent, active)
        return min(self._body.kernels.held, -(-most // BLOCK))

    def _launch_resident(
        self, state: State, counts: tuple[int, ...], tail: tuple[Any, ...]
    ) -> None:
        """Launch the resident kernel. Raises GfUsdError where a block did not start."""
        began = time.perf_counter()
        self._kernel(*counts, *tail)
        require_resident(state, counts[-1])
        self._pace = (time.perf_counter() - began) / tail[0]

    def _launch_queued(self, counts: tuple[int, ...], tail: tuple[Any, ...], threads: int) -> None:
        self._kernel(*counts, threads, *tail)


def fitting(substeps: int, pace: float) -> int:
    """The number of the remaining substeps that the next launch runs; pace : [s] of one."""
    return max(1, min(substeps, int(LAUNCH_SECONDS / pace)))


def ends_of(done: int, many: int, substeps: int) -> int:
    """OPENS and CLOSES of a launch of `many` of `substeps` substeps, after `done` of them."""
    return (OPENS if done == 0 else 0) | (CLOSES if done + many == substeps else 0)


def require_resident(state: DeviceState, blocks: int) -> None:
    """Wait for a launch of resident blocks to end. Raises GfUsdError where one did not start."""
    if state.get("queue")[STUCK]:
        raise GfUsdError(
            f"the GPU did not run {blocks} blocks of {BLOCK} threads at once",
            "close what else runs on the GPU, or use --device cpu",
        )


def filter_schedule(rate: float, dt: float) -> tuple[int, float]:
    """Substeps between two applications of the filter, and alpha = 1 - exp(-r k dt) of each."""
    if rate <= 0.0:
        return 0, 0.0
    if np.isinf(rate):
        return 1, 1.0
    every = max(1, int(min(FILTER_STEP / (rate * dt), NEVER)))
    return every, float(1.0 - np.exp(-rate * every * dt))


LAUNCH_SECONDS = 0.1  # [s] target duration; Ctrl-C and thread count changes wait for its end
FEW = 1_500  # least number of particles per thread: with fewer, waiting dominates
GUESS = 1e-7  # [s] per particle and substep, before the first measurement
BUSY = 0.75  # ratio of CPU to wall time below which threads had to wait for a core
SHORT = 1e-3  # [s] shorter launches are not used for that measurement
REST = 2  # launches with fewer threads before more are tried; doubled after each failure
LONGEST_REST = 512


class ThreadCount:
    """Chooses the number of threads of a body's launches.

    threads : the number available; particles : of the body, which bounds the useful number.
    clock, ran : wall clock and CPU time of this process [s].
    others : number of threads of this process that do other work.
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
        """The number of the remaining substeps that the next launch runs."""
        return fitting(substeps, self._pace)

    def launch(self, work: Callable[[int], None], substeps: int) -> None:
        """Call `work` with the number of threads for which cores seem to be available."""
        if self._left:
            self._left -= 1
            self.size = self.size if self._left else self.most
        others = self._others()
        size = min(self.size, max(1, cores() - others)) if others else self.size
        wall, ran = self._clock(), self._ran()
        work(size)
        wall, ran = self._clock() - wall, self._ran() - ran
        if self._fresh:  # the time includes compilation
            self._fresh = False
            return
        self._pace = wall / substeps
        if self.size > 1 and wall > SHORT and not others:  # `ran` would include their time
            self._judge(wall, ran)

    def _judge(self, wall: float, ran: float) -> None:
        """Use fewer threads for some launches where these had less CPU time than wall time."""
        if ran >= BUSY * self.size * wall:
            self._rest = REST
            return
        self.size = max(1, min(self.size - 1, round(ran / wall)))
        self._left = self._rest
        self._rest = min(2 * self._rest, LONGEST_REST)
