"""Runs the jobs on a dask.distributed cluster whose workers share a file system.

A worker bakes in a child process, as a local batch does.  When a worker dies, so does its child;
the scheduler assigns its job to another worker, which waits for the lock until the child has ended.
"""

from __future__ import annotations

import importlib.util
import logging
import math
import queue
import threading
import time
import uuid
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from gf_usd.batch.job import Job, Outcome
from gf_usd.batch.record import InputTable
from gf_usd.batch.run import POLL_INTERVAL, Event
from gf_usd.batch.task import Limits, finished_event, run_job, unexpected_error_outcome
from gf_usd.core.errors import UsageError
from gf_usd.system.fingerprint import program
from gf_usd.system.processes import GRACE, Children
from gf_usd.system.warm.workers import Commands

if TYPE_CHECKING:
    from distributed import Client, Future


LOCK_TIMEOUT = (
    60.0  # [s] for the end of a dead worker's child, which checks for its parent twice a second
)
CONNECT = 20.0  # [s] to find the scheduler
RESULT = 1.0  # [s] timeout of one request for a result
ANSWER = 5.0  # [s] for the workers to report whether they have gf-usd
POLL_WORKERS = 5.0  # [s] between two queries of the workers
ALONE = 30.0  # [s] without a worker until the note is repeated: a restart takes less
END = GRACE + 5.0  # [s] for the workers to end their bakes, on request
# A worker's results are lost with it; the scheduler then assigns its tasks to another worker.
PENDING = ("pending", "lost")
CLOSED = (OSError, RuntimeError, CancelledError)  # the client has been closed meanwhile
HINT = (
    "start one with dask scheduler, and run dask worker ADDRESS --nthreads 1 for each"
    " concurrent bake"
)

# in a worker process: the running children, by batch
_running: dict[str, Children] = {}
_tables: dict[str, InputTable] = {}


def run_on_cluster(
    jobs: Sequence[Job],
    limits: Limits,
    *,
    address: str,
    resources: Sequence[str],
    children: Children,
) -> Iterator[Event | None]:
    """The events of all jobs as they happen; see `run.run_locally`.

    resources : NAME=AMOUNT of a worker's resources that a job takes.
    children : its `stop` also ends the bakes on the workers.

    Raises UsageError where distributed is not installed, no scheduler answers or a worker has no
    gf-usd.
    """
    amounts = dict(_amount(word) for word in resources)
    client = _connect(address)
    batch = uuid.uuid4().hex
    events: queue.Queue[Event] = queue.Queue()
    topic = f"gf-usd-{batch}"
    ended = threading.Event()
    try:
        _require_program(client)
        client.subscribe_topic(topic, lambda event: events.put(event[1]))
        futures = {
            client.submit(
                _work, job.as_json(), _plain(limits), program(), batch, topic,
                key=f"{job.name}-{batch}", resources=amounts or None, pure=False,
            ): job
            for job in jobs
        }  # fmt: skip
        if missing := _missing_resources(client, address, amounts):
            yield {"event": "note", "message": missing}
        absence = Absence(emitted=bool(missing))
        threading.Thread(  # a scheduler that hangs does not answer
            target=_watch, args=(client, address, amounts, absence, events, ended), daemon=True
        ).start()
        yield from _follow(client, futures, events, batch, children)
        client.unsubscribe_topic(topic)
    finally:
        ended.set()
        client.close()


def _connect(address: str) -> Client:
    try:
        from distributed import Client
    except ImportError as error:
        raise UsageError(
            "--scheduler needs dask.distributed, which is not installed",
            "install it: pip install distributed",
        ) from error
    # no tracebacks for a lost scheduler, which `_outcome` reports
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
    try:
        return Client(address, timeout=CONNECT, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise UsageError(f"no scheduler answers at {address}: {error}", HINT) from error


def _require_program(client: Client) -> None:
    """Raise UsageError for a worker without gf-usd, which its first task would crash."""
    found: dict[str, Any] = {}

    def ask() -> None:
        with suppress(*CLOSED):
            answers: Any = client.run(importlib.util.find_spec, __name__, on_error="return")
            found.update(answers)

    thread = threading.Thread(target=ask, daemon=True)
    thread.start()
    thread.join(ANSWER)  # a worker that hangs does not answer
    without = [who for who, spec in found.items() if spec is None or isinstance(spec, ImportError)]
    if without:
        raise UsageError(
            f"the Python of worker {without[0]} has no gf-usd",
            "install the same gf-usd in the environment of every worker",
        )


def _missing_resources(client: Client, address: str, amounts: Mapping[str, float]) -> str:
    """Text: the workers or resources that the jobs wait for; "" where there are enough."""
    workers = client.scheduler_info(n_workers=-1)["workers"].values()
    if not workers:
        return f"the cluster at {address} has no worker: the jobs wait for one"
    offers = [row.get("resources") or {} for row in workers]
    if any(all(offer.get(name, 0.0) >= n for name, n in amounts.items()) for offer in offers):
        return ""
    resources = ", ".join(f"{name}={amount:g}" for name, amount in amounts.items())
    return f"no worker at {address} offers {resources}: the jobs wait for one that does"


class Absence:
    """Repeats the note on missing workers after ALONE seconds, once per absence.

    emitted : whether the note was emitted before.
    """

    def __init__(self, *, emitted: bool) -> None:
        self._emitted = emitted
        self._since: float | None = None

    def message(self, missing: str, now: float) -> str:
        """The note to emit at a time `now` [s]; "" for none.  missing : of `_missing_resources`."""
        if not missing:
            self._emitted, self._since = False, None
            return ""
        if self._since is None:
            self._since = now
        if self._emitted or now - self._since < ALONE:
            return ""
        self._emitted = True
        return missing


def _watch(
    client: Client,
    address: str,
    amounts: Mapping[str, float],
    absence: Absence,
    events: queue.Queue[Event],
    ended: threading.Event,
) -> None:
    """Put a note into `events` when the workers have been missing for long; until `ended`."""
    with suppress(*CLOSED):
        while not ended.wait(POLL_WORKERS):
            missing = _missing_resources(client, address, amounts)
            if message := absence.message(missing, time.monotonic()):
                events.put({"event": "note", "message": message})


def _follow(
    client: Client,
    futures: Mapping[Future, Job],
    events: queue.Queue[Event],
    batch: str,
    children: Children,
) -> Iterator[Event | None]:
    """Yield events until every future has ended."""
    left, until, last_poll = dict(futures), float("inf"), 0.0
    while left:
        if children.stopping and until == float("inf"):
            until = time.monotonic() + END
            # a worker that hangs does not answer
            threading.Thread(target=_stop_all, args=(client, futures, batch), daemon=True).start()
        try:
            yield events.get(timeout=POLL_INTERVAL)
        except queue.Empty:
            yield None
        if time.monotonic() < last_poll + POLL_INTERVAL:
            continue
        last_poll = time.monotonic()
        for future in [future for future in left if future.status not in PENDING]:
            outcome = _outcome(future, left[future], client, stopping=children.stopping)
            if outcome is not None:
                del left[future]
                yield finished_event(outcome)
        if time.monotonic() > until or (children.stopping and client.status != "running"):
            for job in left.values():
                yield finished_event(
                    _outcome_without_result(job, "stopped", "interrupted before it ended")
                )
            return


def _stop_all(client: Client, futures: Iterable[Future], batch: str) -> None:
    """End the bakes on the workers, and cancel the tasks that have not started."""
    with suppress(*CLOSED):
        # running bakes first, so that they report how they ended
        client.run(_stop, batch, on_error="ignore")
        taken = {key for keys in client.processing().values() for key in keys}
        time.sleep(
            POLL_INTERVAL
        )  # until the client has received the results of those that ended before
        waiting = [future for future in futures if future.status == "pending"]
        client.cancel([future for future in waiting if future.key not in taken])


def _outcome(future: Future, job: Job, client: Client, *, stopping: bool) -> Outcome | None:
    """The outcome of a job whose future has ended; None where its result has not arrived yet."""
    lost = client.status != "running"
    if future.status == "finished":
        try:
            return Outcome.of(future.result(timeout=RESULT))
        except TimeoutError:
            if not lost:
                return None  # its worker is gone, so the task runs again
        except CLOSED:
            lost = True
    if future.status == "cancelled" and stopping:
        return _outcome_without_result(job, "stopped", "interrupted before it started")
    if lost:
        return _outcome_without_result(
            job, "crashed", "the connection to the scheduler was lost",
            "repeat the batch when the scheduler runs; a worker may have completed the job",
        )  # fmt: skip
    if future.status == "cancelled":
        return _outcome_without_result(job, "crashed", "its task was canceled on the scheduler")
    error: Any = future.exception()
    return unexpected_error_outcome(job, error)


def _outcome_without_result(job: Job, state: str, message: str, hint: str = "") -> Outcome:
    return Outcome(
        job=job.name, state=state, message=message, hint=hint, root=str(job.root),
        command=job.command,
    )  # fmt: skip


def _plain(limits: Limits) -> dict[str, Any]:
    return {name: getattr(limits, name) for name in limits.__dataclass_fields__}


def _amount(word: str) -> tuple[str, float]:
    name, _, text = word.partition("=")
    try:
        amount = float(text)
    except ValueError:
        amount = math.nan
    if not name or not 0.0 < amount < math.inf:
        raise UsageError(
            f"--resource {word}: {text!r} is not a number above 0",
            "give NAME=AMOUNT, e.g. memory=2e9",
        )
    return name, amount


def _work(
    job: Mapping[str, Any],
    limits: Mapping[str, Any],
    caller: Mapping[str, Any],
    batch: str,
    topic: str,
) -> dict[str, Any]:
    """Run a job on a worker."""
    from distributed import get_worker

    worker = get_worker()
    this = Job.of(job)
    if program() != caller:
        differ = [key for key, value in program().items() if value != caller.get(key)]
        return _outcome_without_result(
            this, "failed", f"the gf-usd of worker {worker.address} differs: {', '.join(differ)}",
            "install the same gf-usd and libraries on every worker, and start the workers again",
        ).as_json()  # fmt: skip
    children = _running.setdefault(batch, Children())
    table = _tables.setdefault(batch, InputTable(children))
    outcome = run_job(
        this,
        Limits(**{**limits, "lock_timeout": LOCK_TIMEOUT}),
        commands=Commands(children),
        table=table,
        emit=lambda event: worker.log_event(topic, event),
    )
    return outcome.as_json()


def _stop(batch: str) -> None:
    """End the bakes of a batch on this worker, and start no more."""
    _running.setdefault(batch, Children()).stop()
