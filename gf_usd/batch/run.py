"""Jobs side by side on this machine, each in a process of its own."""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from gf_usd.batch.child import Children
from gf_usd.batch.identity import read_by
from gf_usd.batch.inputs import InputTable
from gf_usd.batch.job import Job, Outcome
from gf_usd.batch.task import Limits, finished_event, run_job, unforeseen

BEAT = 0.25  # [s] between looks at the clock, for whoever draws

Event = dict[str, Any]


def run_here(
    jobs: Sequence[Job], limits: Limits, *, at_once: int, children: Children
) -> Iterator[Event | None]:
    """The events of all jobs as they happen, and None now and then where nothing does.

    It ends when every job has: each has one event `finished`, with its outcome.  `children.stop`
    ends those that run and keeps the others from starting.
    """
    events: queue.Queue[Event] = queue.Queue()
    table = InputTable(children)
    with ThreadPoolExecutor(max_workers=at_once) as pool:
        # one child reads the assets of all jobs: starting it costs more than most assets do
        pool.submit(table.read, [path for job in jobs for path in read_by(job)])
        for job in jobs:
            future = pool.submit(
                run_job, job, limits, children=children, table=table, emit=events.put
            )
            future.add_done_callback(lambda done, job=job: events.put(_end(job, done)))
        yield from hear(events, len(jobs))


def _end(job: Job, done: Future[Outcome]) -> Event:
    """The event of a job's end, also where it could not even be started."""
    error = done.exception()
    return finished_event(done.result() if error is None else unforeseen(job, error))


def hear(events: queue.Queue[Event], jobs: int) -> Iterator[Event | None]:
    """Events out of a queue until that many jobs have finished."""
    left = jobs
    while left:
        try:
            event = events.get(timeout=BEAT)
        except queue.Empty:
            yield None
            continue
        left -= event["event"] == "finished"
        yield event


def collect(events: Iterator[Event | None], heard: Callable[[Event | None], None]) -> list[Outcome]:
    """Let everything happen, and return what came of the jobs, in the order of their ends."""
    outcomes = []
    for event in events:
        heard(event)
        if event is not None and event["event"] == "finished":
            outcomes.append(Outcome.of(event))
    return outcomes
