"""The same jobs on a dask.distributed cluster whose workers see the same files.

A worker bakes in a child of its own, as a batch here does.  A worker that dies takes its child with
it; the scheduler gives its job to another, which waits for the lock until the child is gone.
"""

from __future__ import annotations

import queue
import uuid
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from gf_usd.batch.job import Job, Outcome
from gf_usd.batch.record import InputTable
from gf_usd.batch.run import BEAT, Event
from gf_usd.batch.task import Limits, finished_event, run_job, unforeseen
from gf_usd.core.errors import UsageError
from gf_usd.system.fingerprint import program
from gf_usd.system.processes import Children
from gf_usd.system.warm.workers import Commands

if TYPE_CHECKING:
    from distributed import Client, Future


PATIENCE = 60.0  # [s] for the child of a worker that died: it looks for its parent twice a second
CONNECT = 20.0  # [s] to find the scheduler
# A result is lost with the worker that holds it; the scheduler has its task done again by another.
PENDING = ("pending", "lost")
HINT = (
    "start one with dask scheduler, and run dask worker ADDRESS --nthreads 1 for each"
    " concurrent bake"
)

# of this process where it is a worker: what runs now, by batch
_running: dict[str, Children] = {}
_tables: dict[str, InputTable] = {}


def run_there(
    jobs: Sequence[Job],
    limits: Limits,
    *,
    address: str,
    resources: Sequence[str],
    children: Children,
) -> Iterator[Event | None]:
    """The events of all jobs as they happen, as `run.run_here` has them.

    resources : NAME=AMOUNT that a job takes of a worker's.
    children : its `stop` ends the bakes on the workers as well.

    Raises UsageError where distributed is not installed or no scheduler answers.
    """
    client = _connect(address)
    batch = uuid.uuid4().hex
    events: queue.Queue[Event] = queue.Queue()
    topic = f"gf-usd-{batch}"
    client.subscribe_topic(topic, lambda event: events.put(event[1]))
    amounts = dict(_amount(word) for word in resources)
    futures = {
        client.submit(
            _work, job.as_json(), _plain(limits), program(), batch, topic,
            key=f"{job.name}-{batch}", resources=amounts or None, pure=False,
        ): job
        for job in jobs
    }  # fmt: skip
    try:
        yield from _follow(client, futures, events, batch, children)
    finally:
        client.unsubscribe_topic(topic)
        client.close()


def _connect(address: str) -> Client:
    try:
        from distributed import Client
    except ImportError as error:
        raise UsageError(
            "--scheduler needs dask.distributed, which is not installed",
            "install it: pip install distributed",
        ) from error
    try:
        return Client(address, timeout=CONNECT, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise UsageError(f"no scheduler answers at {address}: {error}", HINT) from error


def _follow(
    client: Client,
    futures: Mapping[Future, Job],
    events: queue.Queue[Event],
    batch: str,
    children: Children,
) -> Iterator[Event | None]:
    """Events until every future has come to an end, one way or another."""
    left, stopping = dict(futures), False
    while left:
        if children.stopping and not stopping:
            stopping = True
            # first what runs, so that it can say how it ended
            client.run(_stop, batch, on_error="ignore")
        try:
            yield events.get(timeout=BEAT)
            continue
        except queue.Empty:
            yield None
        for future in [future for future in left if future.status not in PENDING]:
            yield finished_event(_outcome(future, left.pop(future)))
        if stopping and client.status != "running":
            for job in left.values():
                yield finished_event(_lost(job, "stopped", "interrupted before it ended"))
            return


def _outcome(future: Future, job: Job) -> Outcome:
    """What came of a job whose future has ended."""
    if future.status == "finished":
        return Outcome.of(future.result())
    if future.status == "cancelled":
        return _lost(job, "crashed", "its task was canceled on the scheduler")
    error: Any = future.exception()
    return unforeseen(job, error)


def _lost(job: Job, state: str, message: str) -> Outcome:
    return Outcome(
        job=job.name, state=state, message=message, root=str(job.root), command=job.command
    )


def _plain(limits: Limits) -> dict[str, Any]:
    return {name: getattr(limits, name) for name in limits.__dataclass_fields__}


def _amount(word: str) -> tuple[str, float]:
    name, _, text = word.partition("=")
    try:
        return name, float(text)
    except ValueError:
        raise UsageError(
            f"--resource {word}: {text!r} is not a number", "give NAME=AMOUNT, e.g. memory=2e9"
        ) from None


def _work(
    job: Mapping[str, Any],
    limits: Mapping[str, Any],
    caller: Mapping[str, Any],
    batch: str,
    topic: str,
) -> dict[str, Any]:
    """A job, on a worker."""
    from distributed import get_worker

    worker = get_worker()
    this = Job.of(job)
    if program() != caller:
        differ = [key for key, value in program().items() if value != caller.get(key)]
        return _lost(
            this, "failed", f"the gf-usd of worker {worker.address} differs: {', '.join(differ)}"
        ).as_json()
    children = _running.setdefault(batch, Children())
    table = _tables.setdefault(batch, InputTable(children))
    outcome = run_job(
        this,
        Limits(**{**limits, "patience": PATIENCE}),
        commands=Commands(children),
        table=table,
        emit=lambda event: worker.log_event(topic, event),
    )
    return outcome.as_json()


def _stop(batch: str) -> None:
    """End the bakes of a batch on this worker, and start no more."""
    _running.setdefault(batch, Children()).stop()
