"""Cases side by side, each in one of a few processes.

Taichi runs once in a process, and most of a case's time is one thread's: reading kernels, building
bodies, measuring frames.  Figures do not depend on the number of processes, because no case reads
what another one wrote.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor

from gf_usd.system.taichi_runtime import init_taichi
from gf_usd.verify.case import Case, Measure, Result

# (name, full, device) -> measures and [s]
Run = Callable[[str, bool, str], tuple[tuple[Measure, ...], float]]


def verify_in(
    cases: Sequence[Case], run: Run, *, full: bool, device: str, processes: int
) -> Iterator[Result]:
    """Results of cases, in their order.

    run : what runs a case by its name; a function of a module, which another process can find.
    """
    # A fork of a process with threads may stop in a lock; what is spawned starts clean.
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(
        processes, mp_context=spawn, initializer=init_taichi, initargs=(device,)
    ) as pool:
        done = [pool.submit(run, case.name, full, device) for case in cases]
        for case, future in zip(cases, done):
            measures, seconds = future.result()
            yield Result(case=case, measures=measures, seconds=seconds)
