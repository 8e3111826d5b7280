"""How much CPU time this machine needs, relative to the machine on which costs were measured.

A fixed piece of work takes `REFERENCE_SECONDS` there; the quotient scales the seconds of `budget`.
It is of the kinds of a bake: array operations of NumPy on what a core's cache holds, as of the
kernels and of frames, and the interpreter, as of the start.  Only estimates use it: no result of
a bake depends on it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import cache

import numpy as np

# [s] of `_work` where the constants of `budget` hold, which is not measured but follows from an
# Intel Xeon at 2.5 GHz: it takes 0.27 ms there, and seven bakes of `tools.bench.estimates` took 1.9
# to 2.8 times the CPU time that they take on the AMD EPYC of the constants, 2.2 in the mean.
REFERENCE_SECONDS = 1.25e-4
# At each of two times. The shortest counts: a cold cache or another program makes others longer.
REPEATS = 4


@cache
def cpu_time_ratio() -> float:
    """CPU time of a piece of work here, over that on the machine of the constants of `budget`.

    Measured once in a process: all its estimates have one ratio.
    """
    return min(first_seconds(), least_seconds(_work, REPEATS)) / REFERENCE_SECONDS


@cache
def first_seconds() -> float:
    """[s] of the piece of work, measured once in a process, earlier than `cpu_time_ratio` if a bake
    calls it as it begins.

    A core of a cloud machine can be half as fast for some milliseconds, as it was in one process of
    eight: rarely so at both times.
    """
    return least_seconds(_work, REPEATS)


def least_seconds(
    work: Callable[[], object], repeats: int, clock: Callable[[], float] = time.perf_counter
) -> float:
    """[s] of the quickest of several runs; clock : [s].

    The clock is that of elapsed time, as CPU time has a resolution of 16 ms on Windows. A run is
    shorter than the time that a scheduler leaves to a process.
    """
    took = []
    for _ in range(repeats):
        began = clock()
        work()
        took.append(clock() - began)
    return min(took)


COUNT = 4096  # numbers: three arrays of them are in the second-level cache of a core
STRIDE = 1237  # odd: its multiples are in another order


def _work() -> None:
    """Multiplications, divisions, a gather, a dependent chain, and a loop of the interpreter."""
    x = np.arange(1, COUNT + 1, dtype=np.float32)
    order = np.arange(COUNT) * STRIDE % COUNT
    for _ in range(4):
        y = x * np.float32(0.5) + np.float32(1.0)
        y /= x
        np.sqrt(y, out=y)
        np.cumsum(y[order])
    total = 0
    for number in range(1500):
        total += number & 7
