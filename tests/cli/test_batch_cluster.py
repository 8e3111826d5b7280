"""The same jobs on a dask.distributed cluster, of which a worker dies."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import suppress
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
from small_bakes import BLOCK

from gf_usd.batch.cluster import run_on_cluster
from gf_usd.batch.job import Job
from gf_usd.batch.task import Limits
from gf_usd.layers.check.run import check_file
from gf_usd.system.processes import Children

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_spec("distributed") is None, reason="distributed is not installed"),
]


@pytest.fixture
def address() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp://127.0.0.1:{probe.getsockname()[1]}"


@pytest.fixture
def workers(address: str, tmp_path: Path) -> Iterator[list[subprocess.Popen[bytes]]]:
    """A scheduler and two workers, each a process; the workers are yielded."""
    with (tmp_path / "dask.log").open("wb") as log:

        def start(module: str, *arguments: str) -> subprocess.Popen[bytes]:
            command = [
                sys.executable,
                "-m",
                f"distributed.cli.{module}",
                "--no-dashboard",
                *arguments,
            ]
            return subprocess.Popen(command, stdout=log, stderr=log)

        host, port = address.removeprefix("tcp://").split(":")
        running = [start("dask_scheduler", "--host", host, "--port", port)]
        common = (address, "--nthreads", "1", "--no-nanny", "--resources", "seats=1")
        for name in "ab":
            running.append(start("dask_worker", *common, "--local-directory", str(tmp_path / name)))
        yield running[1:]
        for process in reversed(running):
            process.kill()
            process.wait()


def batch(folder: Path, address: str, *arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "gf_usd", "batch", *arguments, "--scheduler", address,
               "--resource", "seats=1", "-o", "out", "--json", "-q", "--no-report"]  # fmt: skip
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=folder)


@pytest.mark.acceptance
def test_a_dead_workers_job_is_done_by_another(
    here: Path, block: Path, address: str, workers: list[subprocess.Popen[bytes]]
) -> None:
    from distributed import Client

    block.with_name("cut.usda").write_text(BLOCK[:500], encoding="utf-8")
    arguments = ("-m", "rubber", "--seed", "0,1", "--particles", "300", "--frames", "40")
    events: list[dict[str, Any]] = []
    with Client(address, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
        pids = client.run(os.getpid)
        process = batch(here, address, str(block), str(block.with_name("cut.usda")), *arguments)
        assert process.stdout is not None
        for line in process.stdout:
            events.append(json.loads(line))
            if events[-1]["event"] == "frame" and all(worker.poll() is None for worker in workers):
                baking = [pids[worker] for worker, keys in client.processing().items()
                          if any(key.startswith(events[-1]["job"]) for key in keys)]  # fmt: skip
                for worker in workers:
                    if worker.pid in baking:
                        worker.kill()
                        worker.wait()
        assert process.wait() == 1
    ends = {e["job"]: e for e in events if e["event"] == "finished"}
    assert {name: e["state"] for name, e in ends.items()} == {
        "block.rubber.seed0": "done", "block.rubber.seed1": "done",
        "cut.rubber.seed0": "refused", "cut.rubber.seed1": "refused",
    }  # fmt: skip
    begun = [e["job"] for e in events if e["event"] == "started" and e["job"].startswith("block")]
    assert len(begun) == 3, "one of the two was begun twice"
    for seed in (0, 1):
        assert check_file(here / "out" / f"block.rubber.seed{seed}.usda").ok
    again = batch(here, address, str(block), *arguments)
    out, _ = again.communicate(timeout=120)
    assert again.returncode == 0
    assert out.count('"state": "kept"') == 2


@pytest.mark.acceptance
def test_sigterm_ends_the_bakes_on_the_workers(
    here: Path, block: Path, address: str, workers: list[subprocess.Popen[bytes]]
) -> None:
    process = batch(here, address, str(block), "-m", "rubber", "--seed", "0,1,2",
                    "--particles", "3000", "--frames", "3000")  # fmt: skip
    assert process.stdout is not None
    while '"frame"' not in process.stdout.readline():
        assert process.poll() is None
    process.send_signal(signal.SIGTERM)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 143
    assert out.count('"state": "stopped"') == 3
    assert all(worker.poll() is None for worker in workers), "the cluster is not ours to end"
    assert not [p for p in (here / "out").glob("*.usda") if ".partial" not in p.name]
    assert not _bakes(here / "out")


@pytest.fixture
def cut(block: Path) -> Job:
    """A job that is refused, because its asset ends in the middle."""
    asset = block.with_name("cut.usda")
    asset.write_text(BLOCK[:500], encoding="utf-8")
    return Job(name="cut", asset=asset, root=block.with_name("soft.usda"), options={})


@pytest.mark.acceptance
def test_a_result_lost_with_its_worker_is_computed_again(
    cut: Job, address: str, workers: list[subprocess.Popen[bytes]]
) -> None:
    """The scheduler calls a task lost until another worker has done it."""
    from distributed import Client

    with Client(address, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
        events = run_on_cluster([cut], Limits(), address=address, resources=[], children=Children())
        next(events)
        while not (held := {key: who for key, who in client.who_has().items() if who}):
            time.sleep(0.05)
        [(key, [holder])] = held.items()
        pids = client.run(os.getpid)
        # without a worker the result stays lost for as long as one looks
        for worker in sorted(workers, key=lambda worker: worker.pid == pids[holder]):
            worker.kill()
            worker.wait()
        while client.who_has()[key]:
            time.sleep(0.05)
        assert not [event for event in islice(events, 8) if event and event["event"] == "finished"]
        command = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--no-nanny",
                   "--no-dashboard", "--nthreads", "1"]  # fmt: skip
        with subprocess.Popen(command, stderr=subprocess.DEVNULL) as another:
            ends = [event for event in events if event and event["event"] == "finished"]
            another.kill()
    assert [end["state"] for end in ends] == ["refused"]


def test_a_task_that_is_canceled_is_reported(
    cut: Job, address: str, workers: list[subprocess.Popen[bytes]]
) -> None:
    from distributed import Client, Future

    with Client(address, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
        nowhere = ["licenses=1"]  # of which no worker has any
        events = run_on_cluster(
            [cut], Limits(), address=address, resources=nowhere, children=Children()
        )
        next(events)
        while not (keys := client.run_on_scheduler(lambda dask_scheduler: [*dask_scheduler.tasks])):
            time.sleep(0.05)
        client.cancel([Future(key, client) for key in keys], force=True)
        [end] = [event for event in events if event and event["event"] == "finished"]
    assert (end["state"], end["message"]) == ("crashed", "its task was canceled on the scheduler")


def test_jobs_that_no_worker_can_do_are_reported_and_can_be_stopped(
    cut: Job, address: str, workers: list[subprocess.Popen[bytes]]
) -> None:
    children = Children()
    nowhere = ["licenses=1"]
    events = run_on_cluster([cut], Limits(), address=address, resources=nowhere, children=children)
    assert next(events)["event"] == "note"  # type: ignore[index]
    children.stop()
    [end] = [event for event in events if event]
    assert (end["state"], end["message"]) == ("stopped", "interrupted before it started")


@pytest.mark.acceptance
def test_a_scheduler_that_dies_is_reported(
    cut: Job, address: str, workers: list[subprocess.Popen[bytes]]
) -> None:
    from distributed import Client

    nowhere = ["licenses=1"]
    events = run_on_cluster(
        [cut], Limits(), address=address, resources=nowhere, children=Children()
    )
    next(events)
    with Client(address, set_as_default=False) as client, suppress(OSError, CancelledError):
        client.run_on_scheduler(os._exit, 1)
    [end] = [event for event in events if event]
    assert end["state"] == "crashed"
    assert end["message"] == "the connection to the scheduler was lost"
    assert end["hint"]


def _bakes(folder: Path) -> list[str]:
    """Processes that bake into a folder now."""
    found = []
    for pid in filter(str.isdigit, os.listdir("/proc")):
        try:
            arguments = Path(f"/proc/{pid}/cmdline").read_text().split("\0")
        except OSError:
            continue
        if "bake" in arguments and any(word.startswith(str(folder)) for word in arguments):
            found.append(pid)
    return found
