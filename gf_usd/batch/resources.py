"""How many bakes fit on this machine at once."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from typing import Any

from gf_usd.batch.job import Job
from gf_usd.estimate import PARTICLE_MEMORY, PROCESS_MEMORY
from gf_usd.planning import DEFAULT_PARTICLES, PAPER_PARTICLES
from gf_usd.room import free_memory, system_file

CPU_LIMIT = "/sys/fs/cgroup/cpu.max"
# Bodies under that many particles are computed by one thread.
ONE_THREAD = 3_000
# over the process and the particles, for vertices and textures: with 8000 particles the peak was
# 1.02 of those two for the duck, 1.01 for 5000 vertices of OBJ, 1.17 for a chair of 9200
MARGIN = 1.5


def cores() -> int:
    """Cores that this process may use, those of its control group where that has a limit."""
    if hasattr(os, "sched_getaffinity"):
        found = len(os.sched_getaffinity(0))
    else:
        found = os.cpu_count() or 1
    quota, _, period = system_file(CPU_LIMIT).partition(" ")  # [us] of CPU in a period [us], or max
    if quota.isdigit() and period.isdigit():
        found = min(found, math.ceil(int(quota) / int(period)))
    return found


def memory_of(options: Mapping[str, Any]) -> float:
    """[bytes] that a bake with these options may take; vertices are not known before it is read."""
    default = PAPER_PARTICLES if options.get("preset") == "paper" else DEFAULT_PARTICLES
    return MARGIN * (PROCESS_MEMORY + PARTICLE_MEMORY * (options.get("particles") or default))


def processes(jobs: Sequence[Job], *, memory: float | None = None) -> int:
    """How many jobs to run at once: one for each core, as far as memory goes for the largest.

    memory : [bytes] of a job, in place of the estimate.
    """
    most = memory or max((memory_of(job.options) for job in jobs), default=PROCESS_MEMORY)
    return max(1, min(cores(), len(jobs), int(free_memory() / most)))


def threads(jobs: Sequence[Job], at_once: int) -> int:
    """CPU threads for a bake that asks for none: one, but for large bodies the share of cores."""
    largest = max((job.options.get("particles") or 0 for job in jobs), default=0)
    return max(1, cores() // at_once) if largest >= ONE_THREAD else 1
