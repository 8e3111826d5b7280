"""Jobs side by side on this machine, each in a process of its own."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from gf_usd.batch.child import Children
from gf_usd.batch.identity import read_by
from gf_usd.batch.inputs import InputTable
from gf_usd.batch.job import Job, Outcome
from gf_usd.batch.task import Limits, finished_event, run_job

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
    waiting = queue.SimpleQueue[Job]()
    for job in jobs:
        waiting.put(job)

    def work() -> None:
        while True:
            try:
                job = waiting.get_nowait()
            except queue.Empty:
                return
            outcome = run_job(job, limits, children=children, table=table, emit=events.put)
            events.put(finished_event(outcome))

    def start() -> None:
        # one child reads the assets of all jobs: starting it costs more than most assets do
        table.read(path for job in jobs for path in read_by(job))
        for _ in range(at_once):
            threading.Thread(target=work, daemon=True).start()

    threading.Thread(target=start, daemon=True).start()
    yield from hear(events, len(jobs))


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
