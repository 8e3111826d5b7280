"""Parallel execution of cases in worker processes.

There is one Taichi runtime per process, and most of the time of a case is spent in one thread:
loading kernels, sampling bodies, evaluating frames.  Cases are independent, so results do not
depend on the number of processes.
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

    run : runs a case by name; a module-level function, which can be pickled.
    """
    # a fork of a process with threads can deadlock
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(
        processes, mp_context=spawn, initializer=init_taichi, initargs=(device,)
    ) as pool:
        futures = [pool.submit(run, case.name, full, device) for case in cases]
        for case, future in zip(cases, futures):
            measures, seconds = future.result()
            yield Result(case=case, measures=measures, seconds=seconds)
