"""What a Dask cluster cannot do, without a cluster."""

from __future__ import annotations

import queue
import threading
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from gf_usd.batch import cluster
from gf_usd.batch.cluster import (
    ALONE,
    Absence,
    _amount,
    _missing_resources,
    _outcome,
    _require_program,
)
from gf_usd.batch.job import Job, Outcome
from gf_usd.core.errors import UsageError


class Cluster:
    """Stands for a client; workers : their resources by address."""

    def __init__(self, workers: dict[str, dict[str, float]], **answers: object) -> None:
        self._workers, self._answers = workers, answers

    def scheduler_info(self, n_workers: int) -> dict[str, Any]:
        assert n_workers == -1, "all of them"
        return {"workers": {name: {"resources": has} for name, has in self._workers.items()}}

    def run(self, function: object, name: str, on_error: str) -> dict[str, Any]:
        del function, on_error
        return {worker: ModuleSpec(name, None) for worker in self._workers} | self._answers


class ProcessResult:
    """Stands for a future that has ended; result : its value, or what is raised."""

    status = "finished"

    def __init__(self, result: object) -> None:
        self._result = result

    def result(self, timeout: float) -> object:
        assert timeout
        if isinstance(self._result, Exception):
            raise self._result
        return self._result


def ended(result: object, status: str = "running") -> Outcome | None:
    client = SimpleNamespace(status=status)
    job = Job(name="a", asset=Path("a.usda"), root=Path("b.usda"), options={})
    return _outcome(ProcessResult(result), job, client, stopping=False)  # type: ignore[arg-type]


def test_a_result_that_is_gone_is_waited_for() -> None:
    done = Outcome(job="a", state="done", root="b.usda", command="x")
    assert ended(done.as_json()) == done
    assert ended(TimeoutError()) is None
    for lost in (ended(OSError()), ended(TimeoutError(), "closed")):
        assert lost is not None
        assert lost.message == "the connection to the scheduler was lost"


def wanting(workers: dict[str, dict[str, float]], **amounts: float) -> str:
    return _missing_resources(Cluster(workers), "tcp://here", amounts)  # type: ignore[arg-type]


def test_what_the_jobs_wait_for_is_reported() -> None:
    assert "has no worker" in wanting({})
    assert wanting({"a": {}}) == ""
    assert wanting({"a": {"memory": 1e9}, "b": {"memory": 2e9}}, memory=2e9) == ""
    assert "offers memory=2e+09" in wanting({"a": {"memory": 1e9}}, memory=2e9)
    apart = {"a": {"memory": 2e9}, "b": {"seats": 1.0}}
    assert "no worker" in wanting(apart, memory=1e9, seats=1.0)


def test_workers_that_are_gone_for_long_are_reported_once_each_time() -> None:
    absence = Absence(emitted=True)  # as at the start of a batch
    assert [absence.message("none", now) for now in (0.0, 2.0 * ALONE)] == ["", ""]
    assert absence.message("", 70.0) == ""
    for gone in (100.0, 1000.0):
        times = (gone, gone + 0.9 * ALONE, gone + ALONE, gone + 9.0 * ALONE)
        assert [absence.message("none", now) for now in times] == ["", "", "none", ""]
        assert absence.message("", gone + 10.0 * ALONE) == ""


def test_the_workers_are_looked_at_until_the_batch_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "POLL_WORKERS", 0.01)
    monkeypatch.setattr(cluster, "ALONE", 0.02)
    workers: dict[str, dict[str, float]] = {"a": {}}
    events: queue.Queue[Any] = queue.Queue()
    ended = threading.Event()
    client: Any = Cluster(workers)
    thread = threading.Thread(
        target=cluster._watch,
        args=(client, "tcp://here", {}, Absence(emitted=False), events, ended),
    )
    thread.start()
    workers.clear()
    event = events.get(timeout=60.0)
    assert event["event"] == "note"
    assert event["message"].startswith("the cluster at tcp://here has no worker")
    ended.set()
    thread.join()
    assert events.empty()


def test_a_worker_without_the_program_gets_no_job() -> None:
    _require_program(Cluster({"a": {}, "b": {}}))  # type: ignore[arg-type]
    # one that does not answer, or fails at something else, is left to its tasks
    _require_program(Cluster({}, b=OSError()))  # type: ignore[arg-type]
    for answer in (None, ModuleNotFoundError("No module named 'gf_usd.batch'")):
        with pytest.raises(UsageError, match="worker b has no gf-usd"):
            _require_program(Cluster({"a": {}, "b": {}}, b=answer))  # type: ignore[arg-type]


@pytest.mark.parametrize("word", ["memory", "memory=", "memory=x", "=1", "a=0", "a=-1", "a=nan"])
def test_an_amount_that_is_none_is_refused(word: str) -> None:
    assert _amount("memory=2e9") == ("memory", 2e9)
    with pytest.raises(UsageError, match="--resource"):
        _amount(word)
