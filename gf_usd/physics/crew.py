"""How many threads share a launch, and how many substeps it takes.

Threads of a launch wait for each other without sleeping (`relay_kernel`): quickest where each has a
core, slow where one waits for a core that another program uses.  So the time that threads ran is
compared with the time that passed, and where cores were lacking fewer threads share the launches
that follow.  No result depends on it.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from gf_usd.beside import at_work
from gf_usd.runtime import cores

MOMENT = 0.1  # [s] of a launch; between launches Ctrl-C is heard and threads are counted anew
FEW = 1_500  # particles for each thread, at least: with fewer they wait more than they work
GUESS = 1e-7  # [s] of a particle and substep, until one is measured
BUSY = 0.75  # of the time that passed: threads that ran for less lacked a core
SHORT = 1e-3  # [s] launches that say nothing of that
REST = 2  # launches of fewer threads before more are tried; doubled each time they lack cores
LONGEST_REST = 512


class Crew:
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
        others: Callable[[], int] = at_work,
    ) -> None:
        self.most = max(1, min(threads, particles // FEW))
        self.size = self.most
        self._clock, self._ran, self._others = clock, ran, others
        self._pace = GUESS * max(1, particles)
        self._fresh = True
        self._rest, self._left = REST, 0

    def fitting(self, substeps: int) -> int:
        """How many of so many substeps the next launch takes."""
        return max(1, min(substeps, int(MOMENT / self._pace)))

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
