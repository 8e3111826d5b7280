"""Runs jobs concurrently on this machine, each in its own process.

Also determines how many bakes fit on this machine at once.
"""

from __future__ import annotations

import os
import queue
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from gf_usd.batch.job import Job, Outcome
from gf_usd.batch.record import InputTable, input_paths
from gf_usd.batch.task import Limits, finished_event, run_job, unexpected_error_outcome
from gf_usd.core.errors import UsageError
from gf_usd.pipeline.cost.budget import PARTICLE_MEMORY, PROCESS_MEMORY
from gf_usd.prepare.settings import DEFAULT_PARTICLES, FINEST, PAPER_PARTICLES
from gf_usd.system.processes import Children
from gf_usd.system.resources import cores, free_memory
from gf_usd.system.warm.workers import commands

POLL_INTERVAL = 0.25  # [s] between events None, with which a display updates its clock

Event = dict[str, Any]
PROCESSES = os.name == "posix"


def require_processes() -> None:
    """Raise UsageError on systems whose processes do not inherit files and receive signals."""
    if not PROCESSES:
        raise UsageError(
            "gf-usd batch needs POSIX processes, which this system does not support",
            "run it under Linux, macOS or the Windows Subsystem for Linux",
        )


def run_locally(
    jobs: Sequence[Job], limits: Limits, *, at_once: int, children: Children, warm: bool = True
) -> Iterator[Event | None]:
    """The events of all jobs as they happen, and None while there are none.

    Ends when every job has ended; each job has one event `finished`, with its outcome.
    `children.stop` ends the running jobs and prevents the others from starting.

    warm : consecutive bakes share worker processes; False: each has its own process.
    """
    events: queue.Queue[Event] = queue.Queue()
    table = InputTable(children)
    with (
        commands(children, warm=warm) as running,
        ThreadPoolExecutor(max_workers=at_once) as pool,
    ):
        # one child reads the assets of all jobs: starting it takes longer than reading most assets
        pool.submit(table.read, [path for job in jobs for path in input_paths(job)])
        for job in jobs:
            future = pool.submit(
                run_job, job, limits, commands=running, table=table, emit=events.put
            )
            future.add_done_callback(lambda done, job=job: events.put(_end(job, done)))
        yield from read_events(events, len(jobs))


def _end(job: Job, done: Future[Outcome]) -> Event:
    """The event of a job's end, also for a job that could not be started."""
    error = done.exception()
    return finished_event(done.result() if error is None else unexpected_error_outcome(job, error))


def read_events(events: queue.Queue[Event], jobs: int) -> Iterator[Event | None]:
    """Events from a queue until this number of jobs has finished."""
    left = jobs
    while left:
        try:
            event = events.get(timeout=POLL_INTERVAL)
        except queue.Empty:
            yield None
            continue
        left -= event["event"] == "finished"
        yield event


def collect_outcomes(
    events: Iterator[Event | None], handle: Callable[[Event | None], None]
) -> list[Outcome]:
    """Pass all events to `handle`; returns the outcomes in the order of their ends."""
    outcomes = []
    for event in events:
        handle(event)
        if event is not None and event["event"] == "finished":
            outcomes.append(Outcome.of(event))
    return outcomes


# Bodies with fewer particles are computed by one thread.
ONE_THREAD = 3_000
# over the process and the particles, for vertices and textures: with 8000 particles the peak is
# 1.02 of those two for the duck, 1.01 for 5000 vertices of OBJ, 1.17 for a chair of 9200
MARGIN = 1.5


def memory_of(options: Mapping[str, Any]) -> float:
    """[bytes] estimated for a bake with these options; its shape and vertices are not known yet."""
    paper = options.get("preset") == "paper"
    default = PAPER_PARTICLES if paper else FINEST * DEFAULT_PARTICLES
    each = max(PARTICLE_MEMORY.values())
    return MARGIN * (PROCESS_MEMORY + each * (options.get("particles") or default))


def process_count(jobs: Sequence[Job], *, memory: float | None = None) -> int:
    """Number of concurrent jobs: one per core, as far as memory suffices for the largest.

    memory : [bytes] of a job, instead of the estimate.
    """
    most = memory or max((memory_of(job.options) for job in jobs), default=PROCESS_MEMORY)
    return max(1, min(cores(), len(jobs), int(free_memory() / most)))


def threads_per_bake(jobs: Sequence[Job], at_once: int) -> int:
    """CPU threads of a bake without --threads: 1, or for large bodies its share of the cores."""
    largest = max((job.options.get("particles") or 0 for job in jobs), default=0)
    return max(1, cores() // at_once) if largest >= ONE_THREAD else 1
